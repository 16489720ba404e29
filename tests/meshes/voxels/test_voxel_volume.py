"""The voxel container: its checks, its books, and a closed surface of it."""

import subprocess
import sys

import numpy as np
import pytest

import meshes
from meshes.voxels.volume import VoxelVolume


def arrays(shape=(2, 3, 4)):
    return {
        "fraction": np.full(shape, 255, np.uint8),
        "layer": np.zeros(shape, np.uint8),
        "density_kg_m3": np.full(shape, 1800, np.uint16),
    }


def volume(**changes):
    return VoxelVolume(
        **{
            "origin_m": np.zeros(3),
            "spacing_m": 1e-3,
            "layer_names": ("a", "b"),
            **arrays(),
            **changes,
        }
    )


def test_books():
    layer = np.zeros((2, 3, 4), np.uint8)
    layer[0] = 1
    fraction = np.full((2, 3, 4), 255, np.uint8)
    fraction[0, 0, 0] = 51
    one = volume(layer=layer, fraction=fraction)
    assert one.shape == (2, 3, 4) and one.voxel_volume_m3 == pytest.approx(1e-9)
    assert one.volume_m3("a") == pytest.approx(12e-9) and one.volume_m3("b") == pytest.approx(
        11.2e-9
    )
    assert one.volume_m3() == pytest.approx(23.2e-9)
    assert one.centres_m(2) == pytest.approx([5e-4, 1.5e-3, 2.5e-3, 3.5e-3])


def test_box_around_the_bone():
    fraction = np.zeros((5, 6, 7), np.uint8)
    fraction[1, 2, 6] = 1
    fraction[3, 4, 3] = 255
    one = volume(origin_m=np.array([0.1, 0.0, 0.0]), **{**arrays((5, 6, 7)), "fraction": fraction})
    low, high = one.bone_bounds_m
    assert low == pytest.approx([0.101, 2e-3, 3e-3])
    assert high == pytest.approx([0.104, 5e-3, 7e-3])


def test_import_is_light_and_names_are_public():
    code = (
        "import sys, meshes; heavy = {'pyvista', 'vtk', 'trimesh', 'skimage', 'warp', "
        "'scipy.ndimage'} "
        "& set(sys.modules); print(sorted(heavy))"
    )
    out = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={"PYTHONPATH": meshes.__path__[0] + "/..", "SYSTEMROOT": ""},
    )
    assert out.stdout.strip() == "[]"
    assert all(hasattr(meshes, name) for name in meshes.__all__)
