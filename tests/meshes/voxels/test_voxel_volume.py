"""The voxel container: its checks, its books, and a closed surface of it."""

import math
import subprocess
import sys

import numpy as np
import pytest

import meshes
from meshes.base.errors import InputError
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


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: volume(origin_m=np.array([0, math.nan, 0])),
            "origin_m must be three finite numbers, got [ 0. nan  0.]: use for example (0, 0, 1)",
        ),
        (
            lambda: volume(spacing_m=-1),
            "spacing_m must be positive and finite, got -1: use about 1e-4 (0.1 mm)",
        ),
        (
            lambda: volume(layer=np.zeros((2, 3, 5), np.uint8)),
            "layer must have the shape (nx, ny, nz) of fraction with no zero, got (2, 3, 5): "
            "give all three arrays the same "
            "shape",
        ),
        (
            lambda: volume(density_kg_m3=np.zeros((2, 3, 4))),
            "density_kg_m3 must be a C-contiguous uint16 array, got float64: "
            "use numpy.ascontiguousarray(array, dtype='uint16')",
        ),
        (
            lambda: volume(layer=np.full((2, 3, 4), 2, np.uint8)),
            "layer must index layer_names, got 2 with 2 names: name every layer",
        ),
        (
            lambda: volume().volume_m3("c"),
            "layer must be one of a, b, got c: use one of these names",
        ),
    ],
)
def test_refusals(make, message):
    with pytest.raises(InputError) as refusal:
        make()
    assert str(refusal.value) == message


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
