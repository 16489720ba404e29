"""Tables of parts as they were before a test."""

import pytest

from tissue.materials import constants
from tissue.scene.registry import CUTTING_MATERIALS, ORGAN_MATERIALS, TABLES


@pytest.fixture(autouse=True)
def tables_as_they_were():
    """Forget what a test has registered."""
    tables = list({id(table): table for each in TABLES.values() for table in each}.values())
    before = {id(table): table.known for table in tables}
    yield
    for table in tables:
        for name in set(table.known) - set(before[id(table)]):
            if table in (CUTTING_MATERIALS, ORGAN_MATERIALS):
                constants.remove_material(*table[name])
            table.remove(name)
