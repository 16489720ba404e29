"""Attenuation of tissues against the published tables of compounds."""

import pytest

from meshes.base.errors import InputError
from meshes.ct.attenuation import hounsfield, linear_attenuation, mass_attenuation

PUBLISHED = {
    "cortex": {30.0: 1.331, 40.0: 0.6655, 50.0: 0.4242, 60.0: 0.3148, 80.0: 0.2229, 100.0: 0.1855},
    "muscle": {40.0: 0.2685, 60.0: 0.2048, 80.0: 0.1823},
    "water": {30.0: 0.3756, 60.0: 0.2059, 80.0: 0.1837, 100.0: 0.1707},
    "adipose": {60.0: 0.1974, 80.0: 0.1800, 100.0: 0.1688},
    "air": {60.0: 0.1875, 80.0: 0.1662},
}
"""cm2/g, Table 4 of NIST Standard Reference Database 126; the elements' sum is rounded to its last digit."""


@pytest.mark.parametrize("material", PUBLISHED)
def test_sums_over_elements_are_the_published_compounds(material):
    for energy, value in PUBLISHED[material].items():
        assert 10.0 * mass_attenuation(material, energy) == pytest.approx(value, rel=6e-4)


def test_between_energies_the_curve_is_that_of_finer_tables():
    """Cortical bone at 70 keV by xraydb 4.5.8 (Elam 2002), which has energies between those of the table."""
    assert 10.0 * mass_attenuation("cortex", 70.0) == pytest.approx(0.25705, rel=2e-3)


def test_water_is_zero_and_air_a_thousand_below():
    for energy in (40.0, 72.0, 120.0):
        assert hounsfield(linear_attenuation("water", energy), energy) == 0.0
        assert hounsfield(linear_attenuation("air", energy), energy) == pytest.approx(-999.0, abs=0.2)


def test_an_energy_outside_the_table_is_refused():
    with pytest.raises(InputError, match="energy_keV must be in"):
        mass_attenuation("water", 20.0)
