"""The procedural molar: its size, layers and lesion against the parameters, and what it refuses."""

import math

import numpy as np
import pytest
from scipy import ndimage

from meshes.tooth.layers import (
    CARIES,
    DENTIN,
    ENAMEL,
    LIGAMENT,
    PULP,
    TOOTH_LAYERS,
    caries_softness,
)
from meshes.tooth.molar import molar
from meshes.voxels.voxelise import voxelise

SPACING = 1e-4
MM = 1e-3


@pytest.fixture(scope="module")
def tooth():
    """The crown and the roots down to the canals' section, 11 mm below the fossa."""
    region = (-7e-3, -7e-3, -11.5e-3), (7e-3, 7e-3, 2.2e-3)
    return voxelise(molar(), spacing_m=SPACING, region_m=region)


def labels(volume):
    """Layer index of the voxels more than half full, -1 elsewhere."""
    return np.where(volume.fraction > 127, volume.layer.astype(int), -1)


def extent(volume, flags, axis):
    """Lowest and highest face of the flagged voxels along an axis [m]."""
    held = np.flatnonzero(flags.any(axis=tuple(k for k in range(3) if k != axis)))
    return volume.origin_m[axis] + volume.spacing_m * np.array([held[0], held[-1] + 1])


def along(volume, x, y):
    """Return the layers on the path down at (x, y) [m], with their tops and bottoms.

    Heights are in m.
    """
    i, j = (int((value - volume.origin_m[k]) / volume.spacing_m) for k, value in enumerate((x, y)))
    column = labels(volume)[i, j]
    met = []
    for k in np.flatnonzero(column >= 0)[::-1]:
        top = volume.origin_m[2] + volume.spacing_m * (k + 1)
        if not met or met[-1][0] != TOOTH_LAYERS[column[k]]:
            met.append([TOOTH_LAYERS[column[k]], top, top])
        met[-1][2] = top - volume.spacing_m
    return met


def within(whole, part):
    """Return the slices of the whole volume that contain the voxels of a part."""
    first = np.rint((part.origin_m - whole.origin_m) / SPACING).astype(int)
    return tuple(slice(a, a + n) for a, n in zip(first, part.shape, strict=True))


def test_size_is_the_size_asked_for():
    """Within two voxels of 0.15 mm: the widest section is flat, and tips and apices are round."""
    width = 10.2
    length = 9.6
    height = 7.0
    root = 12.5
    cusp = 1.4
    anatomy = molar(
        crown_width_mm=width,
        crown_length_mm=length,
        crown_height_mm=height,
        root_length_mm=root,
        cusp_height_mm=cusp,
    )
    volume = voxelise(anatomy, spacing_m=0.15 * MM)
    layer = labels(volume)
    for axis, size in enumerate((width, length)):
        assert np.ptp(extent(volume, layer == ENAMEL, axis)) / MM == pytest.approx(size, abs=0.3)
    top = extent(volume, layer == ENAMEL, 2)[1] / MM
    assert top == pytest.approx(cusp, abs=0.3)
    assert extent(volume, layer == DENTIN, 2)[0] / MM == pytest.approx(
        cusp - height - root, abs=0.3
    )


def test_origin_lies_on_the_enamel(tooth):
    """A thin bur moved down the long axis touches the enamel at z = 0."""
    assert molar().shape.distance(np.zeros((1, 3)))[0] == pytest.approx(0.0, abs=1e-9)
    assert along(tooth, 1e-6, 1e-6)[0][:2] == ["enamel", pytest.approx(0.0, abs=SPACING)]


def test_layers_down_through_the_fossa(tooth):
    """The layers below the fossa have published thicknesses.

    Enamel is 1 to 2 mm in the fossa, over 3 to 5 mm of dentin above the pulp (M, see
    `meshes.tooth.molar`).
    """
    met = along(tooth, 1e-6, 1e-6)
    assert [name for name, _, _ in met] == [
        "enamel",
        "dentin",
        "pulp",
        "dentin",
        "ligament",
        "bone",
    ]
    thickness = {name: (top - bottom) / MM for name, top, bottom in met[:3]}
    assert thickness["enamel"] == pytest.approx(0.62 * 2.2, abs=0.11)
    assert 3.0 < thickness["dentin"] < 5.0 and 1.5 < thickness["pulp"] < 2.5
    assert met[2][1] / MM == pytest.approx(-5.0, abs=0.11)


def test_five_cusps_two_roots_three_canals(tooth):
    layer = labels(tooth)
    top = tooth.bounds_m[1][2] - (layer[:, :, ::-1] == ENAMEL).argmax(axis=2) * SPACING
    top[~(layer == ENAMEL).any(axis=2)] = -1.0
    smooth = ndimage.gaussian_filter(np.maximum(top, 0.0), 2.0)
    peak = (smooth == ndimage.maximum_filter(smooth, size=15)) & (smooth > 0.5 * 1.8 * MM)
    assert ndimage.label(peak, np.ones((3, 3)))[1] == 5
    section = layer[:, :, int((-11.0 * MM - tooth.origin_m[2]) / SPACING)]
    assert ndimage.label((section == DENTIN) | (section == PULP))[1] == 2
    assert ndimage.label(section == PULP)[1] == 3


def test_ligament_has_its_thickness():
    """Distances from dentin to bone through the ligament, on voxels of a sixth of it."""
    thickness, spacing = 0.30 * MM, 0.05 * MM
    anatomy = molar(ligament_thickness_mm=0.30)
    volume = voxelise(
        anatomy, spacing_m=spacing, region_m=((-7e-3, -6e-3, -13e-3), (0.0, 6e-3, -12e-3))
    )
    layer = labels(volume)
    outward = ndimage.distance_transform_edt((layer != DENTIN) & (layer != PULP)) * spacing
    bone = layer == TOOTH_LAYERS.index("bone")
    neighbours = bone & ndimage.binary_dilation(layer == LIGAMENT)
    assert np.median(outward[neighbours]) - 0.5 * spacing == pytest.approx(
        thickness, abs=0.5 * spacing
    )
    assert outward[layer == LIGAMENT].max() < thickness + 2.5 * spacing


@pytest.mark.parametrize(
    ("width", "length", "height", "cusp"),
    [(11, 10.5, 7.5, 1.8), (13, 12.5, 6, 0.8), (13, 12.5, 6.5, 2.5), (9, 8.5, 9.5, 2.5)],
)
def test_distance_is_a_bound(width, length, height, cusp):
    """No steeper than 1 for the extreme crowns either: sampling by blocks rests on it."""
    shape = molar(
        crown_width_mm=width,
        crown_length_mm=length,
        crown_height_mm=height,
        cusp_height_mm=cusp,
        pulp_roof_mm=4.5,
    ).shape
    random = np.random.default_rng(3)
    p = random.uniform((-9e-3, -9e-3, -25e-3), (9e-3, 9e-3, 5e-3), (200_000, 3))
    q = p + random.normal(size=p.shape) * 1e-4
    rise = np.abs(shape.distance(p) - shape.distance(q)) / np.linalg.norm(p - q, axis=1)
    assert rise.max() <= 1.0 + 1e-9


def test_lesion_has_its_size_and_softens_toward_its_middle(tooth):
    depth, diameter = 3.5 * MM, 3.0 * MM
    volume = voxelise(
        molar(caries_depth_mm=3.5),
        spacing_m=SPACING,
        region_m=((-3e-3, -3e-3, -5e-3), (3e-3, 3e-3, 1e-3)),
    )
    carious = labels(volume) == CARIES
    assert extent(volume, carious, 2)[0] == pytest.approx(-depth, abs=1.1 * SPACING)
    assert np.ptp(extent(volume, carious, 0)) == pytest.approx(diameter, abs=2.1 * SPACING)
    assert volume.volume_m3("caries") == pytest.approx(
        math.pi / 6.0 * diameter**2 * depth, rel=0.01
    )
    index = np.argwhere(carious)
    x, y, z = (volume.centres_m(k)[index[:, k]] for k in range(3))
    radius_squared = (x**2 + y**2) / (0.5 * diameter) ** 2 + (
        (z + 0.5 * depth) / (0.5 * depth)
    ) ** 2
    softness = caries_softness(volume.density_kg_m3[carious])
    # density in whole kg/m3 of 800
    assert np.abs(softness - np.maximum(1.0 - radius_squared, 0.0) ** 2).max() < 1e-3
    assert int(volume.density_kg_m3[carious].min()) == pytest.approx(1300, abs=10)
    assert volume.density_kg_m3[carious].max() <= 2100
    window = within(tooth, volume)
    assert np.array_equal(tooth.fraction[window], volume.fraction)
    elsewhere = volume.layer != CARIES
    assert np.array_equal(tooth.layer[window][elsewhere], volume.layer[elsewhere])
