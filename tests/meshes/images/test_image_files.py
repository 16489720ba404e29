"""Volumes from images: TIFF slices, VTK images, DICOM; thresholds, resampling, and refusals."""

import math

import numpy as np
import pytest

from meshes.ct.density import DensityLaw
from meshes.images.bone_image import image_volume
from meshes.images.reading import Image, read_image


def image(values, spacing=(0.1, 0.1, 0.1)):
    return Image(np.asarray(values), spacing, "test", ())


@pytest.fixture
def slices(tmp_path):
    from skimage.io import imsave

    values = np.random.default_rng(1).integers(0, 255, (7, 5, 4), dtype=np.uint8)  # x, y, z
    for k in range(4):
        imsave(tmp_path / f"s_{k:02d}.tif", values[:, :, k].T, check_contrast=False)
    return tmp_path, values


def test_threshold():
    values = np.array([0, 50, 75, 100, 125, 150, 300], dtype=np.uint16).reshape(7, 1, 1)
    hard = image_volume(image(values), threshold=100)
    assert hard.fraction.ravel().tolist() == [0, 0, 0, 0, 255, 255, 255]


@pytest.mark.parametrize("ratio", [2.0, 2.5, 3.0])
def test_coarser_voxels_keep_bone_and_mass(ratio):
    values = np.random.default_rng(3).integers(0, 255, (30, 30, 30))
    fine = image_volume(image(values), threshold=128, density_kg_m3=DensityLaw(5.0, 300.0))
    coarse = image_volume(
        image(values), threshold=128, density_kg_m3=DensityLaw(5.0, 300.0), resample_mm=0.1 * ratio
    )
    assert coarse.shape == (int(30 / ratio),) * 3
    # fractions rounded to 1/255
    assert coarse.volume_m3() == pytest.approx(fine.volume_m3(), rel=2e-3)
    masses = [
        (v.fraction.astype(float) * v.density_kg_m3).sum() * v.voxel_volume_m3
        for v in (fine, coarse)
    ]
    assert masses[1] == pytest.approx(masses[0], rel=2e-3)
    assert coarse.density_kg_m3.max() <= 1575


def test_finer_voxels_interpolate_grey_and_make_cubes():
    x = np.linspace(-1, 1, 21)
    ball = 100 * (
        0.8 - np.sqrt(x[:, None, None] ** 2 + x[None, :, None] ** 2 + x[None, None, ::2] ** 2)
    )
    remarks = []
    volume = image_volume(image(ball, (0.1, 0.1, 0.2)), threshold=0, remark=remarks.append)
    assert volume.spacing_m == pytest.approx(1e-4) and volume.shape == (21, 21, 22)
    assert remarks == ["The voxels of test are not cubes; resampled to 0.1 mm."]
    assert volume.volume_m3() == pytest.approx(4 / 3 * math.pi * 0.8e-3**3, rel=0.02)


@pytest.mark.parametrize("resample_mm", [0.05, 0.3])
def test_placement_leads_back_to_the_image(resample_mm):
    """Placement leads back to the image.

    A ball of bone lies where its image has it, resampled or not, and the block's top at z = 0.
    """
    x, y, z = np.meshgrid(*[np.arange(n) for n in (30, 34, 38)], indexing="ij")
    centre, first = np.array([12.0, 17.0, 21.0]), np.array([-40.0, 7.0, 90.0])
    ball = 100.0 * (8.0 - np.linalg.norm(np.stack([x, y, z], axis=-1) - centre, axis=-1))
    whole = Image(ball, (0.1, 0.1, 0.1), "ball", (), tuple(first))
    volume = image_volume(whole, threshold=0.0, resample_mm=resample_mm)
    filled = np.argwhere(volume.fraction > 0)
    weights = volume.fraction[tuple(filled.T)].astype(float)
    middle_m = volume.origin_m + volume.spacing_m * (
        np.average(filled, axis=0, weights=weights) + 0.5
    )
    assert volume.placement.to_file(1e3 * middle_m[None])[0] == pytest.approx(
        first + 0.1 * centre, abs=2e-3
    )
    assert np.array_equal(volume.placement.rotation, np.eye(3))
    assert volume.bounds_m[1][2] == pytest.approx(0.0, abs=1e-15)


def test_microct_block(anatomy):
    image = read_image(anatomy / "bone" / "microct", spacing_mm=0.0195)
    volume = image_volume(image, threshold=63)
    assert volume.shape == (200, 200, 200)
    assert volume.fraction.mean() / 255 == pytest.approx(0.2278, abs=1e-4)  # the data's README
