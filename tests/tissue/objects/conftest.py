"""Tables of parts as before a test, and two short runs.

One run is of a block and one of a wall, both simulated and read back.
"""

import pytest

import tissue
from tissue.materials import constants
from tissue.scene.registry import CUTTING_MATERIALS, ORGAN_MATERIALS, TABLES

COARSE = {"voxels.spacing_mm": 0.4, "duration_s": 0.3}


@pytest.fixture(autouse=True)
def tables_as_they_were():
    """Forget what a test has registered."""
    tables = list({id(table): table for each in TABLES.values() for table in each}.values())
    before = {id(table): table.known for table in tables}
    yield
    for table in tables:
        for name in set(table.known) - set(before[id(table)]):
            if table in (CUTTING_MATERIALS, ORGAN_MATERIALS):
                material_table, material = table[name]
                del constants._table(material_table)[material]
                constants.constants.cache_clear()
            table.remove(name)


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """A block that a burr mills, saved."""
    made = tissue.simulate(tissue.load_scene("milling", COARSE))
    made.save(tmp_path_factory.mktemp("runs") / "milling", pictures=False)
    return made


@pytest.fixture(scope="session")
def back(run):
    """Return the run as read back from disk."""
    return tissue.open_run(run.path)


@pytest.fixture(scope="session")
def wall():
    """A wall that a hand presses; it is not saved."""
    return tissue.simulate(tissue.load_scene("wall", {"duration_s": 0.2}))
