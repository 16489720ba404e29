"""What all tests share: real anatomy where it is there."""

from pathlib import Path

import pytest

ANATOMY = Path(__file__).resolve().parents[2] / "shared" / "anatomy"


@pytest.fixture(scope="session")
def anatomy() -> Path:
    """Folder of real anatomical data beside the checkout; tests skip where it is absent."""
    if not ANATOMY.is_dir():
        pytest.skip("real anatomy is not there: ../shared/anatomy beside the checkout")
    return ANATOMY
