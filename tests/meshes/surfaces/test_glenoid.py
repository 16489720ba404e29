"""Procedural glenoid against its own parameters and published ranges, measured on the voxels."""

import math

import numpy as np
import pytest

from meshes.base.errors import InputError
from meshes.surfaces.glenoid import glenoid
from meshes.voxels.voxelise import voxelise

SPACING = 2e-4
LAYERS = {"subchondral": 0, "cortical": 1, "trabecular": 2}


def face_of(**sizes):
    region = (-17e-3, -21e-3, -8e-3), (17e-3, 21e-3, 7e-3)
    return voxelise(glenoid(**sizes), spacing_m=SPACING, region_m=region)


@pytest.fixture(scope="module")
def face():
    return face_of()


def extent(volume, axis):
    filled = (volume.fraction > 127).any(axis=tuple(k for k in range(3) if k != axis))
    return np.ptp(np.flatnonzero(filled)) * volume.spacing_m + volume.spacing_m


def test_width_and_height_are_the_parameters(face):
    smaller = face_of(width_mm=23.6, height_mm=32.6)
    for volume, width, height in ((face, 27.8, 37.5), (smaller, 23.6, 32.6)):
        assert extent(volume, 0) == pytest.approx(width * 1e-3, abs=2 * SPACING)
        assert extent(volume, 1) == pytest.approx(height * 1e-3, abs=2 * SPACING)


def test_upper_half_is_narrower(face):
    outline = (face.fraction > 127).any(axis=2)
    y = face.centres_m(1)
    width = outline.sum(axis=0) * SPACING
    upper = width[np.argmin(np.abs(y - 37.5e-3 / 4))]
    assert upper / width.max() == pytest.approx(0.8, abs=0.02)


def test_face_is_the_sphere_through_the_origin(face):
    height = face.bounds_m[1][2] - (face.fraction[:, :, ::-1] > 127).argmax(axis=2) * SPACING
    x, y = np.meshgrid(face.centres_m(0), face.centres_m(1), indexing="ij")
    near = np.hypot(x, y) < 10e-3
    expected = 35e-3 - np.sqrt(35e-3**2 - x[near] ** 2 - y[near] ** 2)
    assert np.abs(height[near] - expected).max() < 1.1 * SPACING
    assert height[near].min() > -SPACING


def test_plate_thickness_stays_in_the_measured_range(face):
    x, y = np.meshgrid(face.centres_m(0), face.centres_m(1), indexing="ij")
    plate = ((face.layer == 0) & (face.fraction > 127)).sum(axis=2) * SPACING
    slant = np.sqrt(1 - (x**2 + y**2) / 35e-3**2)
    inner = (np.abs(x) < 8e-3) & (np.abs(y) < 11e-3)
    thickness = (plate * slant)[inner]
    assert thickness.min() > 1.2e-3 - SPACING and thickness.max() < 2.9e-3 + SPACING
    assert thickness.mean() == pytest.approx(1.9e-3, abs=0.1e-3)
    assert np.ptp(thickness) > 0.3e-3


def test_layers_and_densities(face):
    present = face.fraction > 0
    assert face.layer_names == tuple(LAYERS)
    for name, value in LAYERS.items():
        density = face.density_kg_m3[present & (face.layer == value)]
        low, high = {
            "subchondral": (1100, 1500),
            "cortical": (1800, 1800),
            "trabecular": (250, 500),
        }[name]
        assert len(density) and low <= density.min() and density.max() <= high
    middle = (face.shape[0] // 2, face.shape[1] // 2)
    column = np.where(face.layer[middle] == 2, face.density_kg_m3[middle], 0)[
        face.fraction[middle] == 255
    ]
    column = column[column > 0]
    # densest below the plate
    assert (np.diff(column.astype(int)) >= 0).all() and column[-1] > column[0] + 50


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"width_mm": 50}, ("width_mm", "50")),
        ({"height_mm": math.inf}, ("height_mm", "inf")),
        ({"curvature_radius_mm": math.nan}, ("curvature_radius_mm", "nan")),
        (
            {"curvature_radius_mm": 22, "height_mm": 45},
            ("curvature_radius_mm", "22"),
        ),
        ({"subchondral_thickness_mm": 3.5}, ("subchondral_thickness_mm", "3.5")),
        (
            {"width_mm": 30, "height_mm": 30},
            ("height_mm", "30"),
        ),
        (
            {"vault_taper_deg": 25, "vault_depth_mm": 40},
            ("vault_taper_deg", "25 over a depth of 40 mm"),
        ),
        ({"trabecular_density_kg_m3": "light"}, ("trabecular_density_kg_m3", "'light'")),
        ({"rim_blend_mm": True}, ("rim_blend_mm", "True")),
    ],
)
def test_refusals(options, message):
    with pytest.raises(InputError) as refusal:
        glenoid(**options)
    assert (refusal.value.argument, str(refusal.value.value)) == message
