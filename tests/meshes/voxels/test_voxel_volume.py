"""The voxel container: its checks, its books, and a closed surface of it."""

import math
import subprocess
import sys

import numpy as np
import pytest
from voxel_surface import voxel_surface

import meshes
from meshes.base.errors import InputError
from meshes.shapes import sdf
from meshes.shapes.anatomy import Anatomy, cortical_block
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise


@pytest.fixture(scope="module")
def ball():
    shape = sdf.sphere(3e-3, (1e-3, 0, 0))
    return voxelise(Anatomy("ball", shape, ("cortical",), cortical_block().classify), spacing_m=2e-4)


def arrays(shape=(2, 3, 4)):
    return {
        "fraction": np.full(shape, 255, np.uint8),
        "layer": np.zeros(shape, np.uint8),
        "density_kg_m3": np.full(shape, 1800, np.uint16),
    }


def volume(**changes):
    return VoxelVolume(**{"origin_m": np.zeros(3), "spacing_m": 1e-3, "layer_names": ("a", "b"), **arrays(), **changes})


def test_books():
    layer = np.zeros((2, 3, 4), np.uint8)
    layer[0] = 1
    fraction = np.full((2, 3, 4), 255, np.uint8)
    fraction[0, 0, 0] = 51
    one = volume(layer=layer, fraction=fraction)
    assert one.shape == (2, 3, 4) and one.voxel_volume_m3 == pytest.approx(1e-9)
    assert one.volume_m3("a") == pytest.approx(12e-9) and one.volume_m3("b") == pytest.approx(11.2e-9)
    assert one.volume_m3() == pytest.approx(23.2e-9)
    assert one.centres_m(2) == pytest.approx([5e-4, 1.5e-3, 2.5e-3, 3.5e-3])


def test_surface_is_closed_outward_and_of_the_right_size(ball):
    import trimesh

    vertices, faces = voxel_surface(ball)
    mesh = trimesh.Trimesh(vertices, faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(4 / 3 * math.pi * 27e-9, rel=0.01)  # marching cubes on 0.2 mm, radius 3 mm
    assert np.linalg.norm(vertices - [1e-3, 0, 0], axis=1) == pytest.approx(3e-3, abs=5e-5)


def test_surface_closes_where_bone_meets_the_edge():
    import trimesh

    mesh = trimesh.Trimesh(*voxel_surface(volume()))
    assert mesh.is_watertight and mesh.volume == pytest.approx(24e-9, rel=0.2)  # corners cut by half a voxel


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: volume(origin_m=np.array([0, math.nan, 0])),
            "origin_m must be three finite numbers, got [ 0. nan  0.]: use for example (0, 0, 1)",
        ),
        (lambda: volume(spacing_m=-1), "spacing_m must be positive and finite, got -1: use about 1e-4 (0.1 mm)"),
        (
            lambda: volume(layer=np.zeros((2, 3, 5), np.uint8)),
            "layer must have the shape (nx, ny, nz) of fraction with no zero, got (2, 3, 5): give all three arrays the same "
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
        (lambda: volume().volume_m3("c"), "layer must be one of a, b, got c: use one of these names"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(InputError) as refusal:
        make()
    assert str(refusal.value) == message


def test_import_is_light_and_names_are_public():
    code = (
        "import sys, meshes; heavy = {'pyvista', 'vtk', 'trimesh', 'skimage', 'warp', 'scipy.ndimage'} "
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
