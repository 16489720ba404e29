"""Bone from a file: the place of its outputs.

A run does not depend on the position and the layout of the stored file.
"""

import contextlib
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from voxel_surface import voxel_surface

from meshes.base.errors import InputError
from meshes.shapes import sdf
from meshes.shapes.anatomy import Anatomy, cortical_block
from meshes.voxels.voxelise import voxelise
from tissue import load_scene, simulate
from tissue.simulation.builders.parts import require_whole

pyvista = pytest.importorskip("pyvista")

SPACING_MM = 0.5
SITE = {"centre_mm": (4.0, -3.0, 10.0), "normal": (0.0, 0.0, 1.0), "along": (1.0, 0.0, 0.0)}
TURN = trimesh.transformations.rotation_matrix(1.1, (1, -2, 0.7))
MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def lump():
    """Two balls and a block grown together, which no symmetry maps onto itself [mm]."""
    body = sdf.box((40e-3, 30e-3, 20e-3), rounding_m=3e-3)
    body = body | sdf.sphere(9e-3, (12e-3, 8e-3, 6e-3)) | sdf.sphere(7e-3, (-14e-3, -9e-3, -6e-3))
    solid = Anatomy("lump", body, ("bone",), cortical_block().classify)
    vertices, faces = voxel_surface(voxelise(solid, spacing_m=1e-3))
    return trimesh.Trimesh(1e3 * vertices, faces, process=False)


def milled(path, mesh, *, motion=None, unit_mm=1.0, mirrored=False):
    """Mill a mesh [mm] that is moved by a matrix into a file, and return the run.

    The site is moved with the mesh.
    """
    moved, motion = mesh.copy(), np.eye(4) if motion is None else motion
    moved.apply_transform(motion)
    moved.apply_scale(1.0 / unit_mm)
    if path.suffix == ".vtp":
        pyvista.PolyData.from_regular_faces(moved.vertices, moved.faces).save(path)
    else:
        moved.export(path)
    frame = motion[:3, :3]
    site = {
        "anatomy.centre_mm": (frame @ SITE["centre_mm"] + motion[:3, 3]).tolist(),
        "anatomy.normal": (frame @ SITE["normal"]).tolist(),
        "anatomy.along": (frame @ SITE["along"]).tolist(),
    }
    side = -1.0 if mirrored else 1.0  # x is mirrored by `along`, so y is what changes its side
    scene = {
        "anatomy.file": str(path),
        "anatomy.scale_mm": unit_mm,
        **site,
        "voxels.spacing_mm": SPACING_MM,
        "motion.points_mm": [[-3, side * 1.5, 1.0], [-3, side * 1.5, -1.0], [3, side * 2.5, -1.0]],
        "motion.feed_mm_s": 20.0,
        "duration_s": 0.4,
    }
    return simulate(load_scene("milling", scene))


@pytest.fixture(scope="module")
def reference(tmp_path_factory):
    mesh = lump()
    return mesh, milled(tmp_path_factory.mktemp("mm") / "lump.stl", mesh)


def figures(run):
    """Peak force [N] and removed volume [mm3] of a run."""
    summary = run.summary
    return summary["force_N"]["peak"], sum(summary["removed_mm3"].values())


STORED = 2e-3
"""Relative tolerance of figures.

STL holds single precision, 2e-5 mm at 400 mm, 1e-4 of the depth cut; a voxel's share is kept in
1/255.
"""


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("turned.stl", {"motion": TURN}),
        pytest.param("mirrored.stl", {"motion": MIRROR, "mirrored": True}, marks=pytest.mark.slow),
        pytest.param("metres.stl", {"unit_mm": 1000.0}, marks=pytest.mark.slow),
        pytest.param("same.vtp", {}, marks=pytest.mark.slow),
    ],
)
def test_a_run_does_not_depend_on_how_the_file_was_stored(reference, tmp_path, name, options):
    mesh, run = reference
    force_N, removed_mm3 = figures(run)
    assert force_N > 0.5 and removed_mm3 > 5.0
    assert figures(milled(tmp_path / name, mesh, **options)) == pytest.approx(
        figures(run), rel=STORED
    )


@pytest.mark.slow
@pytest.mark.parametrize("unit_mm", [1.0, 1000.0])
def test_outputs_lie_on_the_file_in_its_unit(reference, tmp_path, unit_mm):
    mesh, _ = reference
    move = TURN @ trimesh.transformations.translation_matrix((30, 60, -20))
    run = milled(tmp_path / "lump.stl", mesh, motion=move, unit_mm=unit_mm)
    out = run.save(tmp_path / "run", pictures=False)
    file = pyvista.read(tmp_path / "lump.stl")
    volume, placement = run.volume, run.parts.placement
    inner = [1e3 * corner for corner in volume.bounds_m]
    surface = pyvista.read(out / "bone.vtp")
    scene = placement.to_scene(surface.points)
    kept = (surface["removed_depth_mm"] == 0.0) & (scene > inner[0] + SPACING_MM).all(axis=1)
    kept &= (scene < inner[1] - SPACING_MM).all(axis=1)
    away = unit_mm * np.abs(surface.compute_implicit_distance(file)["implicit_distance"])
    assert kept.sum() > 200 and away[kept].max() < SPACING_MM
    np.testing.assert_allclose(pyvista.read(out / "bone.stl").bounds, surface.bounds, rtol=1e-5)
    image = pyvista.read(out / "bone.vti")
    np.testing.assert_allclose(image.direction_matrix, placement.rotation, atol=1e-9)
    centres = image.cell_centers().points
    bone = image.cell_data["remaining"] == 255
    assert (
        unit_mm
        * pyvista.PolyData(centres[bone]).compute_implicit_distance(file)["implicit_distance"].max()
        < SPACING_MM
    )
    header = (out / "bone.nrrd").read_bytes().split(b"\n\n")[0].decode()
    fields = dict(line.split(": ", 1) for line in header.splitlines()[1:])
    first = np.array(fields["space origin"].strip("()").split(","), dtype=float)
    np.testing.assert_allclose(first, centres[0], rtol=1e-6, atol=1e-6 / unit_mm)
    assert fields["space units"].startswith('"mm"' if unit_mm == 1.0 else '"m"')


@pytest.mark.parametrize(("away_mm", "taken"), [(3.0, False), (30.0, True)])
def test_the_cut_of_a_long_bone_is_refused_within_the_reach_however_small_its_share(
    tmp_path, away_mm, taken
):
    """A shaft of 230 mm: its open end is 2 % of its surface."""
    shaft = trimesh.creation.cylinder(radius=10.0, height=230.0, sections=14)
    trimesh.Trimesh(
        shaft.vertices, shaft.faces[np.ptp(shaft.triangles[:, :, 2], axis=1) > 0]
    ).export(tmp_path / "s.stl")
    scene = {
        "anatomy.file": str(tmp_path / "s.stl"),
        "anatomy.centre_mm": [10.0, 0.0, 115.0 - away_mm],
        "anatomy.normal": [1.0, 0.0, 0.0],
        "anatomy.along": [0.0, 0.0, 1.0],
        "voxels.spacing_mm": 1.0,
        "motion.points_mm": [[-5, 0, 5], [-5, 0, -1], [5, 0, -1]],
        "duration_s": 0.01,
    }
    if taken:
        assert "Closed 2 holes" in simulate(load_scene("milling", scene)).parts.notes["repairs"]
        return
    with pytest.raises(
        InputError,
        match=r"^anatomy\.file must enclose a solid where the tool moves, got s\.stl with a",
    ):
        simulate(load_scene("milling", scene))


def test_the_box_of_an_oblique_cut_may_meet_the_reach_where_the_cut_does_not():
    turn = trimesh.transformations.rotation_matrix(np.pi / 4, (0, 1, 0))[:3, :3]
    cap = np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0], [0, 0, 0.1]]) @ turn.T * 1e-3
    region = np.array([-1e-3] * 3), np.array([1e-3] * 3)
    for away, taken in ((0.0, False), (5e-3, True)):
        bone = replace(cortical_block(), caps_m=(cap + away * turn[:, 2],))
        with contextlib.nullcontext() if taken else pytest.raises(InputError, match="with a hole"):
            require_whole(bone, region, is_image=False)
