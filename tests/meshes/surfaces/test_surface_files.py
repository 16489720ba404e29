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


def flat_sheet():
    return trimesh.Trimesh([[0, 0, 0], [50, 0, 0], [50, 50, 0], [0, 50, 0]], [[0, 1, 2], [0, 2, 3]])


def open_box():
    box = trimesh.creation.box((50, 50, 50))
    return trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 2] < 0.5], process=False)


def fins():
    edge = [[0, 0, 0], [0, 0, 50]]
    points = np.array([*edge, [50, 0, 20], [-30, 40, 20], [-30, -40, 20]])
    return trimesh.Trimesh(points, [[0, 1, 2], [0, 1, 3], [0, 1, 4]], process=False)


@pytest.mark.parametrize(
    ("mesh", "options", "argument", "got"),
    [
        (flat_sheet(), {}, "surface", "a flat one in bone.stl"),
        (open_box(), {}, "surface", "4 open and 0 non-manifold edges in bone.stl"),
        (fins(), {}, "surface", "6 open and 1 non-manifold edges in bone.stl"),
        (bone((2.8, 2.3, 1.2)), {}, "anatomy.scale_mm", "bone.stl, whose longest side 2.8 is"),
        (
            bone((3e6, 2e6, 1e6)),
            {"scale_mm": 1},
            "anatomy.scale_mm",
            "1, which makes bone.stl 3e+06 mm",
        ),
        (bone((3, 2, 1)), {"scale_mm": 1e-3}, "anatomy.scale_mm", "bone.stl 0.003 mm long"),
        (bone(), {"scale_mm": float("nan")}, "anatomy.scale_mm", "nan"),
    ],
)
def test_refused_surfaces(write, mesh, options, argument, got):
    with pytest.raises(InputError) as refusal:
        read_surface(write(mesh), **options)
    assert refusal.value.argument == argument and got in str(refusal.value.value)


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".vtk", ".vtp"])
@pytest.mark.parametrize(
    "content", [None, b"", b"not a mesh at all\n" * 20, b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"]
)
def test_refused_files(tmp_path, suffix, content):
    file = tmp_path / f"bone{suffix}"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InputError) as refusal:
        read_surface(file)
    assert refusal.value.argument == "file" and file.name in str(refusal.value.value)


def test_vertices_that_are_not_numbers():
    vertices, faces = parts(bone())
    vertices[3, 1] = np.nan
    with pytest.raises(InputError) as refusal:
        surface_from_triangles(vertices, faces, source="bone.ply")
    assert refusal.value.argument == "vertices" and "1 of 642" in str(refusal.value.value)


def test_real_liver_is_turned_and_cleaned(anatomy):
    report = read_surface(anatomy / "liver" / "liver.vtk").report
    assert report.repairs == (
        "Dropped 3 loose pieces, the largest 0.059 mm long.",
        "Turned the surface outward: it was wound inward.",
    )
    assert report.volume_mm3 == pytest.approx(1.4772e6, rel=1e-4)  # the data's README


def test_real_scapulae(anatomy):
    open_one = read_surface(anatomy / "scapula" / "myosim_scapula.stl").report
    assert open_one.scale_mm == 1000 and open_one.repairs[-1].startswith("Closed 7 holes along ")
    scaled = read_surface(anatomy / "scapula" / "openforge_scapula_left.stl", scale_mm=50).report
    assert scaled.volume_mm3 == pytest.approx(0.4155 * 50**3, rel=1e-3)
    with pytest.raises(InputError, match=r"^anatomy\.scale_mm must be given .* for example 50$"):
        read_surface(anatomy / "scapula" / "openforge_scapula_left.stl")
