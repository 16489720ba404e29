"""Calibration by a CT's own tissues: exact where they are those of the tables, covering where they are not."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.ct.attenuation import hounsfield, linear_attenuation
from meshes.ct.calibration import fit_regions
from meshes.ct.tissue_regions import Region

ALL = ("air", "adipose", "muscle", "blood", "cortex")


def regions_of(means, error_HU=1.0):
    return {tissue: Region(tissue, mean, error_HU, 5000.0, "value") for tissue, mean in means.items()}


def tables(energy, tissues=ALL):
    return {tissue: hounsfield(linear_attenuation(tissue, energy), energy) for tissue in tissues}


@pytest.mark.parametrize("energy", [50.0, 60.0, 70.0, 85.0])
def test_tissues_of_the_tables_give_their_energy_and_the_density_of_dense_bone(energy):
    """The prior of the energy, 72 +- 15 keV, draws it by a seventh of how far off it is."""
    found = fit_regions(regions_of(tables(energy)), source="exact")
    assert found.energy_keV == pytest.approx(energy, abs=abs(energy - 72.0) / 7.0 + 0.1)
    assert max(map(abs, found.misfits.values())) < 40.0
    dense = np.array([tables(energy)["cortex"]])
    assert abs(found.law(dense) - 1920.0) < 0.6 * found.law.sd(dense)


def test_the_k2hpo4_line_is_that_of_two_components():
    energy = 72.0
    found = fit_regions(regions_of(tables(energy)), source="exact")
    slope, offset = found.k2hpo4
    salt, fat = (hounsfield(linear_attenuation(each, energy), energy) for each in ("K2HPO4", "triglyceride"))
    assert slope * salt + offset == pytest.approx(2440.0, rel=2e-3)
    assert slope * fat + offset == pytest.approx(0.0, abs=2.0)


def test_what_is_missing_widens_the_band():
    at = np.array([600.0])
    widths = {}
    for tissues in (ALL, ("air", "muscle", "cortex"), ("muscle", "cortex"), ("air", "adipose", "muscle")):
        found = fit_regions(regions_of(tables(68.0, tissues)), source="part")
        low, high = found.law.band(at)
        widths[tissues] = float(high[0] - low[0])
        assert low[0] < fit_regions(regions_of(tables(68.0)), source="all").law(at)[0] < high[0]
        assert ("no air" in " ".join(found.notes)) == ("air" not in tissues)
    assert list(widths.values()) == sorted(widths.values())
    assert widths["air", "adipose", "muscle"] > 2.0 * widths[ALL]


@pytest.mark.parametrize("tissues", [(), ("air",), ("air", "cortex"), ("adipose",)])
def test_too_few_tissues_are_refused(tissues):
    with pytest.raises(
        InputError, match=r"internal calibration must find fat or muscle and a second tissue, got .* in few"
    ):
        fit_regions(regions_of(tables(70.0, tissues)), source="few")


def test_what_fits_no_energy_is_refused():
    with pytest.raises(InputError, match="grey values must be Hounsfield units"):
        fit_regions(regions_of({"air": -400.0, "muscle": 90.0, "cortex": 3000.0}), source="grey")


@pytest.mark.slow
def test_the_band_covers_tissues_that_differ_between_persons():
    """400 persons drawn from the priors at 60 to 100 keV: 90 % are held, standard error 1.5 %."""
    rng = np.random.default_rng(5)
    held = []
    for _ in range(400):
        energy = rng.uniform(60.0, 100.0)
        drawn = dict(zip(ALL, rng.normal(size=5), strict=True))
        spread = {"air": 0.0, "adipose": 0.02, "muscle": 0.01, "blood": 0.01, "cortex": 0.04}
        scale, water = 1.0 + 0.01 * rng.normal(), 4.0 * rng.normal()
        read = lambda mu: scale * hounsfield(mu, energy) + water + rng.normal()  # noqa: B023, E731
        means = {t: read(linear_attenuation(t, energy) * (1.0 + spread[t] * drawn[t])) for t in ALL if t != "blood"}
        law = fit_regions(regions_of(means), source="person").law
        fat = np.clip(rng.normal(0.6, 0.25), 0.0, 1.0)
        marrow = fat * linear_attenuation("adipose", energy) + (1.0 - fat) * linear_attenuation("muscle", energy)
        for density in (300.0, 800.0, 1400.0):
            part = density * (1.0 + 0.03 * rng.normal()) / 1920.0
            low, high = law.band(np.array([read(part * linear_attenuation("cortex", energy) + (1.0 - part) * marrow)]))
            held.append(low[0] < density < high[0])
    share = np.reshape(held, (-1, 3)).mean(axis=0)
    print("held at 300, 800, 1400 kg/m3:", share)
    assert np.all((share > 0.86) & (share < 0.95))
