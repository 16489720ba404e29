"""Tooth from surfaces.

The tests cover exact volumes of nested bodies, overlaps and gaps, its place, and the real molar.
"""

import math

import numpy as np
import pytest
import trimesh

from meshes.base.errors import InputError
from meshes.surfaces.surface import surface_from_triangles
from meshes.tooth.layer_contact import inside_lattice
from meshes.tooth.layered_surfaces import layered_anatomy, layered_surfaces
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.voxels.mesh_sampling import inside_scattered
from meshes.voxels.voxelise import voxelise

SPACING = 1e-4
MOLAR_MM3 = {"enamel": 221.82, "dentin": 647.50, "pulp": 33.61, "ligament": 351.09}


def surface(*bodies):
    """One surface of several bodies; sizes in mm."""
    mesh = trimesh.util.concatenate(list(bodies))
    return surface_from_triangles(np.array(mesh.vertices), np.array(mesh.faces), scale_mm=1)


def ball(radius, centre=(0.0, 0.0, 0.0), hollow=False):
    """An icosphere with the volume of the ball."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    mesh.apply_scale((ball_mm3(radius) / mesh.volume) ** (1.0 / 3.0))
    mesh.apply_translation(centre)
    if hollow:
        mesh.invert()
    return mesh


def block(size, bottom, hollow=False, aside=0.0):
    """A box whose lowest face is centred at (aside, 0, bottom)."""
    mesh = trimesh.creation.box(size)
    mesh.apply_translation((aside, 0.0, bottom + 0.5 * size[2]))
    if hollow:
        mesh.invert()
    return mesh


def ball_mm3(radius):
    return 4.0 / 3.0 * math.pi * radius**3


def lens_mm3(one, other, apart):
    """Volume that two balls share (Weisstein, "Sphere-sphere intersection")."""
    return (
        math.pi
        * (one + other - apart) ** 2
        * (apart**2 + 2 * apart * (one + other) - 3 * (one - other) ** 2)
        / (12 * apart)
    )


def blocks(gap=0.0, lift=0.0):
    """Return dentin 8 x 6 x 12 mm, hollow for a pulp of 2 x 2 x 6, under an enamel of 8 x 6 x 3.

    The enamel stands off by `gap`.
    """
    return {
        "enamel": surface(block((8, 6, 3), 12 + gap + lift)),
        "dentin": surface(block((8, 6, 12), 0.0), block((2, 2, 6), 4.0, hollow=True)),
        "pulp": surface(block((2, 2, 6), 4.0)),
    }


def volumes_mm3(volume):
    return {name: 1e9 * volume.volume_m3(name) for name in TOOTH_LAYERS}


@pytest.mark.slow
@pytest.mark.parametrize("hollow", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_balls_have_their_volumes_and_the_overlap_goes_by_priority(hollow):
    """0.2 %: facets of the icospheres, and nine lines a voxel."""
    lens = lens_mm3(5.0, 3.0, 7.0)
    dentin = [ball(5.0), ball(2.0, hollow=True)] if hollow else [ball(5.0)]
    surfaces = {
        "dentin": surface(*dentin),
        "pulp": surface(ball(2.0)),
        "enamel": surface(ball(3.0, (0, 0, 7.0))),
    }
    anatomy = layered_anatomy(surfaces)
    found = volumes_mm3(voxelise(anatomy, spacing_m=SPACING))
    expected = {
        "enamel": ball_mm3(3.0),
        "dentin": ball_mm3(5.0) - ball_mm3(2.0),
        "pulp": ball_mm3(2.0),
    }
    expected["dentin"] -= lens
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=2e-3), name
    overlaps = dict(part.rsplit(" ", 2)[:2] for part in anatomy.notes["overlaps"].split(", "))
    assert float(overlaps["enamel and dentin"]) == pytest.approx(lens, rel=0.02)  # points of 0.1 mm
    assert ("pulp and dentin" in overlaps) == (not hollow)
    assert (
        anatomy.notes["gaps"] == "none"
        and anatomy.notes["order of layers"] == "pulp > enamel > dentin"
    )


def test_a_layer_too_small_for_a_tooth_asks_for_its_file_instead_of_a_scale(tmp_path):
    """The suggested scale of a bone would give a tooth of 140 mm."""
    files = {}
    for name, radius in (("enamel", 6.0), ("dentin", 5.0), ("pulp", 0.4)):
        files[name] = tmp_path / f"{name}.stl"
        ball(radius).export(files[name])
    with pytest.raises(InputError, match=r"The file or its unit may be wrong: use .* the pulp in"):
        layered_surfaces(files)
    # 10 mm in millimetres is plausible
    with pytest.raises(InputError, match=r"Use about 1$"):
        layered_surfaces(files, scale_mm=1000.0)


def test_gap_is_reported_and_filled():
    anatomy = layered_anatomy(blocks(gap=0.2))
    volume = voxelise(anatomy, spacing_m=2.0 * SPACING)
    assert anatomy.notes["gaps"].startswith("enamel and dentin ")
    assert float(anatomy.notes["gaps"].split()[-2]) == pytest.approx(8 * 6 * 0.2, rel=0.03)
    assert 1e9 * volume.volume_m3() == pytest.approx(8 * 6 * 15.2, rel=3e-3)
    # enamel comes before dentin
    assert volumes_mm3(volume)["enamel"] == pytest.approx(8 * 6 * 3.2, rel=0.01)


def test_tooth_is_placed_wherever_it_lay():
    """Crown up, origin on the enamel, whatever the frame of the file."""
    turn = trimesh.transformations.rotation_matrix(2.3, (1.0, -2.0, 0.5), point=(40.0, 10.0, -7.0))
    turned = {}
    for name, part in blocks().items():
        points = trimesh.transform_points(part.vertices_m * 1e3, turn)
        turned[name] = surface_from_triangles(points, part.faces, scale_mm=1)
    volume = voxelise(layered_anatomy(turned), spacing_m=2e-4)
    filled = np.argwhere(volume.fraction)
    low, high = (
        volume.origin_m + 2e-4 * corner for corner in (filled.min(axis=0), filled.max(axis=0) + 1)
    )
    assert high[2] == pytest.approx(0.0, abs=2.1e-4)
    assert low[2] == pytest.approx(-15e-3, abs=3e-4)
    assert np.abs(high[:2] - [4e-3, 3e-3]).max() < 3e-4
    column = volume.shape[0] // 2, volume.shape[1] // 2
    middle = volume.layer[column][volume.fraction[column] > 0]
    met = [TOOTH_LAYERS[k] for k in middle[::-1]]
    assert list(dict.fromkeys(met)) == ["enamel", "dentin", "pulp"]


def test_scattered_points_are_sorted_as_those_of_a_lattice():
    """Scattered points are sorted like the points of a lattice.

    The lattice's lines and the columns of single points cross the same triangles, lines on edges
    and corners too.
    """
    sphere = surface(ball(5.0))
    axis = 1e-3 * np.linspace(-5.5, 5.5, 23)  # lines through vertices of the ball among them
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    order = np.random.default_rng(6).permutation(len(points))
    lattice = inside_lattice(sphere.vertices_m, sphere.faces, (axis, axis, axis)).ravel()
    assert 0.2 < lattice.mean() < 0.6
    assert (
        inside_scattered(sphere.vertices_m, sphere.faces, points[order]) == lattice[order]
    ).all()
    opened = sphere.faces[1:]  # the line through a hole has no inside
    assert not (inside_scattered(sphere.vertices_m, opened, points) & ~lattice).any()
    assert not inside_scattered(sphere.vertices_m, sphere.faces, points[:0]).any()
    assert not inside_scattered(sphere.vertices_m, sphere.faces, points + 1.0).any()


@pytest.fixture
def real(anatomy):
    files = {"enamel": "Enamel", "dentin": "Dentin", "pulp": "Pulp", "ligament": "PDL"}
    return {name: anatomy / "tooth" / f"openmandible_L6_{part}.stl" for name, part in files.items()}


@pytest.mark.slow
def test_real_molar_keeps_the_volume_of_every_layer(real):
    anatomy = layered_surfaces(real)
    volume = voxelise(anatomy, spacing_m=SPACING)
    for name, value in MOLAR_MM3.items():
        # 1 % was asked for
        assert 1e9 * volume.volume_m3(name) == pytest.approx(value, rel=2e-3), name
    assert anatomy.notes["overlaps"] == "none"
    assert volume.bounds_m[1][2] < 3.5e-3 and volume.bounds_m[0][2] == pytest.approx(
        -20e-3, abs=1e-3
    )
    top = volume.fraction[int(-volume.origin_m[0] / SPACING), int(-volume.origin_m[1] / SPACING)]
    assert volume.origin_m[2] + SPACING * (np.flatnonzero(top)[-1] + 1) == pytest.approx(
        0.0, abs=1.1 * SPACING
    )
