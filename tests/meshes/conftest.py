"""Where the real anatomical data lie, and a skip with a reason where they do not."""

from pathlib import Path

import pytest

ANATOMY = Path(__file__).resolve().parents[2].parent / "shared" / "anatomy"


@pytest.fixture
def anatomy_data() -> Path:
    """Folder of the real anatomical data, beside the checkout."""
    if not ANATOMY.is_dir():
        pytest.skip("the anatomical data are not in ../shared/anatomy")
    return ANATOMY
