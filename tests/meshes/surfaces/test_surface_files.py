"""Surfaces from files: formats, units, each repair, and each refusal."""

import numpy as np
import pytest
import trimesh

from meshes.base.errors import InputError
from meshes.surfaces.surface import read_surface, surface_from_triangles


def bone(size=(40.0, 30.0, 20.0)):
    mesh = trimesh.creation.icosphere(subdivisions=3)
    mesh.apply_scale(0.5 * np.array(size))
    return mesh


def parts(mesh):
    return np.array(mesh.vertices), np.array(mesh.faces)


@pytest.fixture
def write(tmp_path):
    def write_file(mesh, name="bone.stl"):
        import pyvista

        path = tmp_path / name
        if path.suffix in (".vtk", ".vtp"):
            pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces).save(path)
        else:
            mesh.export(path)
        return path

    return write_file


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".ply", ".vtk", ".vtp"])
def test_formats(write, suffix):
    surface = read_surface(write(bone(), "bone" + suffix))
    assert surface.report.volume_mm3 == pytest.approx(bone().volume, rel=1e-5)
    assert surface.report.size_mm == pytest.approx((40, 30, 20), rel=1e-5)
    assert surface.faces.shape == (1280, 3) and surface.vertices_m.shape == (642, 3)
    assert np.abs(surface.vertices_m).max() == pytest.approx(0.02, rel=1e-6)


@pytest.mark.parametrize(
    ("size", "given_mm", "scale_mm", "guess"),
    [
        ((140, 100, 60), None, 1.0, "longest side 140 would be 140 mm"),
        ((0.14, 0.1, 0.06), None, 1000.0, "longest side 0.14 would be 140 mm"),
        ((12, 10, 9), None, 1.0, "in centimetres it would be 120 mm"),
        ((2.8, 1.2, 2.3), 50, 50.0, "the longest side is 140 mm"),
    ],
)
def test_units_are_guessed_or_given(write, size, given_mm, scale_mm, guess):
    report = read_surface(write(bone(size)), scale_mm=given_mm).report
    assert report.scale_mm == scale_mm and guess in report.unit_guess
    assert report.size_mm[0] == pytest.approx(scale_mm * size[0], rel=1e-5)


def test_inward_winding_is_turned():
    vertices, faces = parts(bone())
    surface = surface_from_triangles(vertices, faces[:, ::-1])
    assert surface.report.repairs == ("Turned the surface outward: it was wound inward.",)
    assert trimesh.Trimesh(surface.vertices_m, surface.faces).volume * 1e9 == pytest.approx(
        bone().volume, rel=1e-9
    )


def test_mixed_winding_is_made_one():
    vertices, faces = parts(bone())
    faces[::7] = faces[::7, ::-1]
    surface = surface_from_triangles(vertices, faces)
    assert str(len(faces[::7])) in surface.report.repairs[0]
    assert surface.report.volume_mm3 == pytest.approx(bone().volume, rel=1e-9)


def test_debris_is_dropped():
    specks = [
        trimesh.creation.icosphere(subdivisions=1, radius=r).apply_translation((30, 0, k))
        for k, r in enumerate((0.1, 0.25))
    ]
    surface = surface_from_triangles(*parts(trimesh.util.concatenate([bone(), *specks])))
    assert surface.report.repairs[-1] == "Dropped 2 loose pieces, the largest 0.5 mm long."
    assert surface.report.volume_mm3 == pytest.approx(bone().volume, rel=1e-9)


def test_two_bodies_stay_and_a_cavity_stays_a_cavity():
    cavity = bone((10, 10, 10))
    cavity.invert()
    other = bone((20, 20, 20)).apply_translation((60, 0, 0))
    other.invert()
    surface = surface_from_triangles(*parts(trimesh.util.concatenate([bone(), cavity, other])))
    expected = bone().volume - bone((10, 10, 10)).volume + bone((20, 20, 20)).volume
    assert surface.report.volume_mm3 == pytest.approx(expected, rel=1e-9)


def test_small_holes_are_closed():
    vertices, faces = parts(bone())
    surface = surface_from_triangles(vertices, np.delete(faces, [5, 600, 601], axis=0))
    assert surface.report.repairs[-1].startswith(
        "Closed 3 holes along 9 open and 0 non-manifold edges, "
    )
    assert surface.report.volume_mm3 == pytest.approx(bone().volume, rel=2e-3)
    edges = np.sort(trimesh.Trimesh(surface.vertices_m, surface.faces, process=False).edges, axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    one = surface_from_triangles(vertices, np.delete(faces, 5, axis=0)).report
    assert one.repairs[-1].startswith("Closed 1 hole along 3 open and 0 non-manifold edges, ")


def test_real_scapulae(anatomy):
    open_one = read_surface(anatomy / "scapula" / "myosim_scapula.stl").report
    assert open_one.scale_mm == 1000 and open_one.repairs[-1].startswith("Closed 7 holes along ")
    scaled = read_surface(anatomy / "scapula" / "openforge_scapula_left.stl", scale_mm=50).report
    assert scaled.volume_mm3 == pytest.approx(0.4155 * 50**3, rel=1e-3)
    with pytest.raises(InputError, match=r"^anatomy\.scale_mm must be given .* for example 50$"):
        read_surface(anatomy / "scapula" / "openforge_scapula_left.stl")
