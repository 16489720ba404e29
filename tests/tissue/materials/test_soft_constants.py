"""Constants of soft tissue and of needles: every entry complete, and the published relations between them."""

import tomllib
from importlib.resources import files

import pytest

from tissue import InputError
from tissue.materials.constants import constants

TABLES = {
    table: tomllib.loads(files("tissue.materials").joinpath(f"{table}.toml").read_text("utf-8"))
    for table in ("soft", "needle")
}
MATERIALS = [(table, material) for table, listed in TABLES.items() for material in listed]
UNITS = {
    "poisson_ratio": 1, "modulus_kPa": 1e8, "density_kg_m3": 2e3, "toughness_J_m2": 1e4, "thickness_um": 1e4,
}  # fmt: skip


@pytest.mark.parametrize(("table", "material"), MATERIALS, ids=[f"{t} {m}" for t, m in MATERIALS])
def test_every_constant_lies_in_its_range_and_names_its_source(table, material):
    for name, entry in constants(table, material).items():
        assert entry.low <= entry.value <= entry.high, name
        assert 0.0 <= entry.low < entry.high < UNITS.get(name, 1e6), name
        assert entry.confidence in ("H", "M", "L"), name
        assert len(entry.source) > 3, name
        if entry.source.startswith("memory"):
            assert entry.confidence == "L", f"{name}: no author to look up"


@pytest.mark.parametrize("material", TABLES["soft"])
def test_every_soft_material_can_be_solved(material):
    entries = constants("soft", material)
    assert {"modulus_kPa", "poisson_ratio", "density_kg_m3"} <= set(entries)
    assert entries["poisson_ratio"].high < 0.5
    for number in range(1, 3):
        assert (f"prony_g{number}" in entries) == (f"prony_tau{number}_s" in entries)


def test_liver_keeps_some_stiffness_for_ever():
    liver = constants("soft", "liver")
    assert liver["prony_g1"].high + liver["prony_g2"].high < 1.0
    # Values of reference: 1 - 0.333 - 0.235.
    assert 1.0 - liver["prony_g1"].value - liver["prony_g2"].value == pytest.approx(0.432)
    assert liver["prony_tau1_s"].high <= liver["prony_tau2_s"].value


def test_moduli_are_three_times_the_cited_shear_moduli():
    """An incompressible body has E = 3 G; G of liver 1.8 kPa, of carcinoma 23.4 kPa (PMC6925591 T1)."""
    assert constants("soft", "liver")["modulus_kPa"].value == pytest.approx(3 * 1.8)
    assert constants("soft", "nodule")["modulus_kPa"].value == pytest.approx(3 * 23.4)


@pytest.mark.parametrize("organ", ["liver", "kidney"])
def test_a_capsule_is_far_stiffer_than_its_organ(organ):
    assert constants("soft", f"{organ}_capsule")["modulus_kPa"].low > 60 * constants("soft", organ)["modulus_kPa"].high


def test_silicones_are_in_the_order_of_their_names():
    moduli = [constants("soft", f"silicone_EF10_{part}T")["modulus_kPa"] for part in (100, 75, 50)]
    assert moduli[0].high < moduli[1].low and moduli[1].high < moduli[2].low


def test_an_unlisted_material_is_refused_with_the_list():
    with pytest.raises(InputError, match=r"material must be one of liver, .*skin.*, got spleen: choose a listed one"):
        constants("soft", "spleen")
