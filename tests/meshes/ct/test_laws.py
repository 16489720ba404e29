"""Laws by name, of a phantom's line and rods, and what `--density` refuses."""

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.ct.attenuation import hounsfield, linear_attenuation
from meshes.ct.density import ASH_SHARE, CT_DENSITY
from meshes.ct.laws import DENSITY_LAWS, density_law, phantom_law, rods_law
from meshes.images.frame import Image

ANY = Image(np.zeros((4, 4, 4), np.int16), (1.0, 1.0, 1.0), "any.nii.gz", ())
HU = np.array([0.0, 250.0, 1000.0])


@pytest.mark.parametrize("name", DENSITY_LAWS)
def test_a_law_has_its_name_source_and_a_band_of_other_scanners(name):
    law = density_law(name.upper(), ANY)
    assert law is DENSITY_LAWS[name]
    assert "Schileo 2008" in law.source
    low, high = law.band(HU)
    assert np.all((high - low)[1:] > 0.3 * law(HU)[1:])


@pytest.mark.parametrize("name", DENSITY_LAWS)
@pytest.mark.parametrize("energy", [62.0, 70.0, 80.0])
def test_the_band_of_a_scanner_law_holds_bone_of_other_scanners(name, energy):
    """Dense bone of ICRU 44 in marrow that is 60 % fat."""
    parts = {
        tissue: hounsfield(linear_attenuation(tissue, energy), energy) for tissue in ("cortex", "adipose", "muscle")
    }
    marrow = 0.6 * parts["adipose"] + 0.4 * parts["muscle"]
    for density in (300.0, 600.0, 1000.0, 1500.0):
        share = density / 1920.0
        low, high = DENSITY_LAWS[name].band(np.array([share * parts["cortex"] + (1.0 - share) * marrow]))
        assert low[0] < density < high[0]


def test_a_line_is_of_apparent_density_or_of_what_it_names():
    assert density_law("line:1.2, -15", ANY)(HU) == pytest.approx(np.maximum(1.2 * HU - 15.0, 50.0))
    ash = density_law("line:0.887,63.3,ash", ANY)
    assert ash(HU) == pytest.approx(CT_DENSITY(HU))
    salt = density_law("line:0.8,-5,K2HPO4", ANY)
    assert salt(HU)[1:] == pytest.approx((1.06 * (0.8 * HU[1:] - 5.0) + 38.9) / ASH_SHARE)
    mineral = density_law("line:0.8,-5,ha", ANY)
    assert mineral(HU)[1:] == pytest.approx((0.877 * (0.8 * HU[1:] - 5.0) + 79.0) / ASH_SHARE)
    assert mineral.name == "line:0.8,-5,HA"


@pytest.mark.parametrize(
    "text", ["", "phantom", "line", "line:", "line:1", "line:a,b", "line:1,2,3,4", "line:nan,0", "1,2"]
)
def test_other_text_is_refused_in_one_sentence(text):
    with pytest.raises(InputError, match=r"^density must be internal, ct, dragomir-daescu, or line:SLOPE,OFFSET"):
        density_law(text, ANY)


def test_an_unlikely_line_is_refused():
    with pytest.raises(InputError, match="slope must be in"):
        density_law("line:-1,0", ANY)
    with pytest.raises(InputError, match="equivalent must be one of apparent, ash, HA, K2HPO4"):
        density_law("line:1,0,lead", ANY)


def test_rods_give_back_their_line_and_its_error():
    """Known rods read with known errors: 90 % of the bands hold the true line (4000 fits, standard error 0.5 %)."""
    rng = np.random.default_rng(1)
    density = np.array([0.0, 100.0, 200.0, 400.0, 800.0])
    exact = rods_law(density, density / 0.8 + 5.0, equivalent="apparent")
    assert (exact.slope_kg_m3, exact.offset_kg_m3) == pytest.approx((0.8, -4.0))
    assert exact.sd(HU) == pytest.approx(0.0, abs=1e-3)
    held = 0
    for _ in range(400):
        law = rods_law(density, density / 0.8 + 5.0 + rng.normal(0.0, 4.0, 5), equivalent="apparent")
        low, high = law.band(np.array([400.0]))
        held += bool(low[0] < 316.0 < high[0])
    assert held / 400 > 0.86


def test_rods_are_weighted_by_their_errors():
    density, hu = np.array([0.0, 200.0, 400.0, 800.0]), np.array([0.0, 250.0, 500.0, 1200.0])
    law = rods_law(density, hu, equivalent="apparent", sd_HU=[1.0, 1.0, 1.0, 1000.0])
    assert law.slope_kg_m3 == pytest.approx(0.8, rel=1e-4)


def test_too_few_or_equal_rods_are_refused():
    with pytest.raises(InputError, match="rods must be three at least"):
        rods_law([0.0, 1.0], [0.0, 1.0], equivalent="HA")
    with pytest.raises(InputError, match="means that differ"):
        rods_law([0.0, 1.0, 2.0], [5.0, 5.0, 5.0], equivalent="HA")


def test_a_phantom_keeps_the_uncertainty_of_its_line():
    law = phantom_law(0.8, 0.0, equivalent="ash", covariance=(1e-4, 0.0, 25.0), residual_sd_mg_cm3=3.0)
    assert law.covariance == pytest.approx((1e-4 / ASH_SHARE**2, 0.0, 25.0 / ASH_SHARE**2))
    assert law.residual_sd_kg_m3 == pytest.approx(3.0 / ASH_SHARE)
