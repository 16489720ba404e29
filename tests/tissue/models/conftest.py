"""A soft slab, made once for the tests of a module."""

import pytest
from contact_slab import Slab


@pytest.fixture(scope="module")
def slab():
    return Slab()
