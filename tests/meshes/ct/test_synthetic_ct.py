"""Values of the synthetic CT: equal to its materials, in every format, axis order and tilt."""

import numpy as np
import pytest
from synthetic_ct import (
    ORIENTATIONS,
    ct_phantom,
    reoriented,
    write_stored,
)

from meshes.base.errors import InputError
from meshes.ct.calibration import find_regions, fit_regions
from meshes.images.frame import Image
from meshes.images.reading import read_image

COARSE = (1.2, 1.2, 2.4)


@pytest.fixture(scope="module")
def phantom():
    return ct_phantom(np.random.default_rng(3), energy_keV=66.0, spacing_mm=COARSE)


def holds_rods(law, phantom):
    """Return True for each rod whose density lies in the band of a law."""
    bands = [
        (density, *law.band(np.array([mean]))) for density, mean in phantom.rod_means().items()
    ]
    return [bool(low[0] < density < high[0]) for density, low, high in bands]


def calibrate(image):
    return fit_regions(find_regions(image), source=image.source)


def test_a_calibration_finds_its_energy_and_its_band_holds_every_rod(phantom):
    found = calibrate(phantom.image())
    assert abs(found.energy_keV - 66.0) < 2.0 * found.energy_sd_keV
    assert all(holds_rods(found.law, phantom))
    for density, mean in phantom.rod_means().items():
        low, high = found.law.band(np.array([mean]))
        assert high[0] - low[0] < 0.35 * density + 120.0


@pytest.mark.parametrize(
    ("name", "axes"),
    list(zip(("ct.nii.gz", "ct.nrrd", "ct.mha", "ct"), ORIENTATIONS, strict=True)),
)
def test_every_format_and_order_of_axes_gives_the_same_image(phantom, tmp_path, name, axes):
    found = read_image(write_stored(tmp_path / name, reoriented(phantom.stored, axes)))
    whole = phantom.image()
    assert np.array_equal(found.values, whole.values)
    assert found.spacing_mm == pytest.approx(whole.spacing_mm, rel=1e-6)
    assert found.origin_mm == pytest.approx(whole.origin_mm, abs=1e-3)


def test_a_crop_without_air_is_calibrated_and_one_without_soft_tissue_refused(phantom):
    whole = phantom.image()
    x = whole.origin_mm[0] + whole.spacing_mm[0] * np.arange(whole.values.shape[0])
    y = whole.origin_mm[1] + whole.spacing_mm[1] * np.arange(whole.values.shape[1])
    limb = whole.values[np.ix_((x > 10.0) & (x < 70.0), (y > -40.0) & (y < 25.0))]
    found = calibrate(Image(limb, whole.spacing_mm, "part", ()))
    assert "air" not in found.law.source and all(holds_rods(found.law, phantom))
    with pytest.raises(
        InputError, match=r"internal calibration must find two tissues, one of them fat or muscle"
    ):
        calibrate(Image(whole.values[115:128, 55:68, 25:33], whole.spacing_mm, "head alone", ()))
    scaled = Image((whole.values.astype(np.float32) + 1024.0) / 16.0, whole.spacing_mm, "8 bit", ())
    with pytest.raises(InputError, match=r"must find|must be Hounsfield units"):
        calibrate(scaled)
