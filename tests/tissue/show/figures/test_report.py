"""A run's files and pictures, read back."""

import gzip

import numpy as np
import pytest

from meshes.voxels.volume import VoxelVolume
from tissue import load_scene, simulate
from tissue.show.figures import draw_pictures
from tissue.simulation.bone_files import write_bone
from tissue.simulation.bone_surface import (
    bone_surface,
    cut_faces,
    cut_out,
    depth_map,
    smooth_normals,
    with_depth,
)
from tissue.simulation.builders.parts import reach

pyvista = pytest.importorskip("pyvista")

SPACING_MM = 0.4
PICTURES = ("bone_before_after.png", "force_torque.png")


@pytest.fixture(scope="module")
def run():
    """A coarse, quick ream of the glenoid."""
    scene = {"voxels.spacing_mm": SPACING_MM, "motion.feed_mm_s": 5.0, "duration_s": 0.6}
    return simulate(load_scene("glenoid", scene))


@pytest.fixture(scope="module")
def folder(run, tmp_path_factory):
    """Return a folder in which the bone of the run is written."""
    out = tmp_path_factory.mktemp("run")
    write_bone(run, out)
    return out


def _ball(radius: float, spacing: float) -> VoxelVolume:
    """Return a ball in a box that it does not touch.

    Every voxel has its exact share up to second order.
    """
    n = 2 * int(np.ceil(1.5 * radius / spacing))
    at = spacing * (np.arange(n) + 0.5 - 0.5 * n)
    distance = np.sqrt(sum(c**2 for c in np.meshgrid(at, at, at, indexing="ij"))) - radius
    fraction = np.rint(255 * np.clip(0.5 - distance / spacing, 0.0, 1.0)).astype(np.uint8)
    return VoxelVolume(
        np.full(3, -0.5 * n * spacing),
        spacing,
        fraction,
        np.zeros_like(fraction),
        np.full(fraction.shape, 1800, np.uint16),
        ("bone",),
    )


def test_bone_ends_at_the_faces_of_the_region_but_not_above(run):
    volume = run.parts.volume
    region = reach(run.cutter, run.parts.motion, 1e-3 * run.scene.voxels.margin_mm)
    faces = cut_faces(volume, region)
    assert (2, -1) in faces and (2, 1) not in faces
    surface = bone_surface(volume, volume.fraction)
    low = surface.points[surface.regular_faces][cut_out(surface, volume, region)].reshape(-1, 3)
    assert np.isclose(low[:, 2].min(), 1e3 * volume.bounds_m[0][2], atol=0.25 * SPACING_MM)


def test_voxels_read_back_in_millimetres(run, folder):
    image = pyvista.read(folder / "bone.vti")
    volume = run.parts.volume
    assert image.active_scalars_name == "remaining"
    assert [str(name) for name in image.field_data["layer_names"]] == list(volume.layer_names)
    low, high = volume.bounds_m
    np.testing.assert_allclose(
        np.reshape(image.bounds, (3, 2)), 1e3 * np.stack([low, high], axis=1), atol=1e-9
    )
    for name, array in (
        ("remaining", run.remaining),
        ("start", volume.fraction),
        ("layer", volume.layer),
        ("density_kg_m3", volume.density_kg_m3),
    ):
        assert image.cell_data[name].dtype == array.dtype
        np.testing.assert_array_equal(image.cell_data[name].reshape(volume.shape, order="F"), array)


def test_nrrd_holds_the_voxels_where_the_surface_lies(run, folder):
    header, data = (folder / "bone.nrrd").read_bytes().split(b"\n\n", 1)
    fields = dict(line.split(": ", 1) for line in header.decode().splitlines()[1:])
    assert tuple(map(int, fields["sizes"].split())) == run.parts.volume.shape
    stored = np.frombuffer(gzip.decompress(data), np.uint8).reshape(
        run.parts.volume.shape, order="F"
    )
    np.testing.assert_array_equal(stored, run.remaining)
    origin = np.array(fields["space origin"].strip("()").split(","), dtype=float)
    np.testing.assert_allclose(
        origin, 1e3 * run.parts.volume.origin_m + 0.5 * SPACING_MM, atol=1e-9
    )


@pytest.mark.parametrize("name", ["bone.stl", "bone.vtp"])
def test_surface_is_closed_and_holds_what_remains(run, folder, name):
    surface = pyvista.read(folder / name)
    assert surface.n_cells > 1000
    assert surface.n_open_edges == 0
    # Half full lies within a quarter voxel of the true face, on either side: 1 % of this slab of 10
    # mm at most.
    remaining = run.remaining.sum(dtype=np.int64) / 255 * SPACING_MM**3
    assert surface.volume == pytest.approx(remaining, rel=0.01)


def test_surface_volume_and_outward_normals_of_a_ball():
    # The trapezoid error of a surface between linear samples falls with the square of the spacing:
    # here (0.2/5)^2 / 4.
    surface = bone_surface(_ball(5e-3, 2e-4), _ball(5e-3, 2e-4).fraction)
    assert surface.n_open_edges == 0
    assert surface.volume == pytest.approx(4.0 / 3.0 * np.pi * 5.0**3, rel=2e-3)
    outward = surface.points / np.linalg.norm(surface.points, axis=1, keepdims=True)
    before = np.einsum("ij,ij->i", surface.point_data["Normals"], outward)
    after = np.einsum("ij,ij->i", smooth_normals(surface), outward)
    assert before.min() > 0.9
    assert after.min() > before.min()
    corners = surface.points[surface.regular_faces]
    winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.median(np.einsum("ij,ij->i", winding, corners.mean(axis=1))) > 0.0


def test_removed_depth_adds_up_to_the_removed_volume(run):
    depth = depth_map(run)
    assert (depth.axis, depth.outward, depth.across) == (2, 1, (0, 1))
    removed = sum(run.summary["removed_mm3"].values())
    counted = (run.parts.volume.fraction.astype(int) - run.remaining).sum() / 255 * SPACING_MM**3
    assert depth.depth_mm.sum() * SPACING_MM**2 == pytest.approx(counted, rel=1e-9)
    # The run books finer shares than the 255 steps of the file: half cut voxels may differ by a
    # step each.
    steps = np.count_nonzero((run.remaining > 0) & (run.remaining < run.parts.volume.fraction))
    assert counted == pytest.approx(removed, abs=steps / 255 * SPACING_MM**3)
    assert removed > 100.0


def test_what_is_cut_lies_on_the_cup_of_the_reamer(run):
    """The cup has a radius of 15 mm and its tip at z = -2 mm; the edge of its hole is left out."""
    depth = depth_map(run)
    volume = run.parts.volume
    surface = bone_surface(volume, run.remaining)
    with_depth(surface, volume, run.remaining, depth_mm=depth.depth_mm, axis=depth.axis)
    x, y, z = surface.points.T
    outward = surface.point_data["Normals"][:, 2] > 0.7
    hole = np.hypot(x, y) < 3.1 + 2.0 * SPACING_MM
    cut = (surface.point_data["removed_depth_mm"] > SPACING_MM) & outward & ~hole
    cup = 13.0 - np.sqrt(np.maximum(15.0**2 - x**2 - y**2, 0.0))
    assert cut.sum() > 100
    # a face between two samples of a curved cup is off by a small part of a voxel
    assert np.abs(z - cup)[cut].max() < 0.2 * SPACING_MM


@pytest.mark.slow
def test_pictures_show_something(run, tmp_path):
    from PIL import Image

    notes = draw_pictures(run, tmp_path)
    if notes:
        pytest.skip(notes[0])
    assert all((tmp_path / name).is_file() for name in PICTURES)
    for path in tmp_path.iterdir():
        with Image.open(path) as picture:
            assert picture.width == 1600 and 500 < picture.height < 1800, path.name
            pixels = np.asarray(picture.convert("RGB"), dtype=float)
        assert pixels.std() > 15.0, path.name
        assert len(np.unique(pixels.reshape(-1, 3)[::97], axis=0)) > 50, path.name
