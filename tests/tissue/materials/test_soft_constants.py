"""Constants of soft tissue and of needles.

Every entry is complete, and the published relations between them hold. Sources of these tables and
of teeth and perception are publications or assumptions.
"""

import tomllib
from importlib.resources import files

import pytest

from tissue.materials.constants import constants, listed

TABLES = {
    table: tomllib.loads(files("tissue.materials").joinpath(f"{table}.toml").read_text("utf-8"))
    for table in ("soft", "needle")
}
MATERIALS = [(table, material) for table, listed in TABLES.items() for material in listed]
UNITS = {
    "poisson_ratio": 1,
    "modulus_kPa": 1e8,
    "density_kg_m3": 2e3,
    "toughness_J_m2": 1e4,
    "thickness_um": 1e4,
}


@pytest.mark.parametrize(("table", "material"), MATERIALS, ids=[f"{t} {m}" for t, m in MATERIALS])
def test_every_constant_lies_in_its_range_and_names_its_source(table, material):
    for name, entry in constants(table, material).items():
        assert entry.low <= entry.value <= entry.high, name
        assert 0.0 <= entry.low < entry.high < UNITS.get(name, 1e6), name
        assert entry.confidence in ("H", "M", "L"), name
        assert len(entry.source) > 3, name


@pytest.mark.parametrize("table", ["soft", "needle", "tooth", "perception", "observers"])
def test_a_source_is_a_publication_or_an_assumption_of_low_confidence(table):
    for material in listed(table):
        for name, entry in constants(table, material).items():
            assert "memory" not in entry.source, f"{material}.{name}"
            if entry.source.startswith(("assumption", "assumed")):
                assert entry.confidence == "L", f"{material}.{name}"


@pytest.mark.parametrize("material", TABLES["soft"])
def test_every_soft_material_can_be_solved(material):
    entries = constants("soft", material)
    assert {"modulus_kPa", "poisson_ratio", "density_kg_m3"} <= set(entries)
    assert entries["poisson_ratio"].high < 0.5
    for number in range(1, 3):
        assert (f"prony_g{number}" in entries) == (f"prony_tau{number}_s" in entries)
