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


@pytest.mark.usefixtures("parsed_here")
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
    with pytest.raises(InputError, match=r"^anatomy\.scale_mm must be given .* for example 50;"):
        read_surface(anatomy / "scapula" / "openforge_scapula_left.stl")


BOX = trimesh.creation.box((30.0, 20.0, 10.0))


def text_stl(meshes, form="{:.6e}"):
    """STL in text with a solid for each mesh."""
    lines = []
    for mesh in meshes:
        lines.append("solid part")
        for triangle in mesh.triangles:
            corners = [" ".join(form.format(x) for x in corner) for corner in triangle]
            lines += [" facet normal 0 0 0", "  outer loop"]
            lines += [f"   vertex {corner}" for corner in corners]
            lines += ["  endloop", " endfacet"]
        lines.append("endsolid part")
    return "\n".join(lines) + "\n"


def binary_stl(count=None, head=b"exported", further=b""):
    """Binary STL of the box whose header states a number of triangles."""
    record = np.zeros(12, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("a", "<u2")])
    record["corners"] = BOX.triangles
    stated = 12 if count is None else count
    return head.ljust(80) + stated.to_bytes(4, "little") + record.tobytes() + further


def ply(kind, further=b"", comma=False):
    """PLY of the box."""
    content = BOX.export(file_type="ply", encoding=kind)
    if comma:
        head, _, body = content.partition(b"end_header\n")
        content = head + b"end_header\n" + body.replace(b".", b",")
    return content + further


def mixed_ply():
    """Binary PLY of the box with five quadrilaterals and two triangles."""
    quads = ([4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3])
    polygons = ([0, 1, 3], [0, 3, 2], *quads)
    head = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(BOX.vertices)}",
        *(f"property double {axis}" for axis in "xyz"),
        f"element face {len(polygons)}",
        "property list uchar int vertex_indices",
        "end_header\n",
    ]
    faces = [bytes([len(each)]) + np.array(each, "<i4").tobytes() for each in polygons]
    return "\n".join(head).encode() + BOX.vertices.astype("<f8").tobytes() + b"".join(faces)


def obj():
    return BOX.export(file_type="obj", include_normals=False).replace("v ", "v  ")


MOVED = BOX.copy().apply_translation((50.0, 0.0, 0.0))


@pytest.mark.usefixtures("parsed_here")
@pytest.mark.parametrize(
    ("name", "content", "volume", "note"),
    [
        ("a.stl", text_stl([BOX, MOVED]), 12000.0, ""),
        ("a.stl", text_stl([BOX]).upper().replace(" ", "\t"), 6000.0, ""),
        ("a.stl", text_stl([BOX]).replace("\n", "\r"), 6000.0, ""),
        ("a.stl", text_stl([BOX]).encode("utf-16"), 6000.0, ""),
        ("a.stl", text_stl([BOX]) + "\nexported by hand\n", 6000.0, ""),
        ("a.stl", binary_stl(head=b"solid bone"), 6000.0, ""),
        ("a.stl", binary_stl(head=b"solid", further=b"end"), 6000.0, "Left out 3 bytes"),
        ("a.stl", binary_stl(0), 6000.0, "Read 12 triangles of a.stl, whose header states 0"),
        ("a.stl", binary_stl(5), 6000.0, "Read 12 triangles of a.stl, whose header states 5"),
        ("a.ply", ply("binary", b"\0\0"), 6000.0, "trimesh does not read a.ply"),
        ("a.ply", mixed_ply(), 6000.0, "trimesh does not read a.ply"),
        (
            "a.ply",
            ply("ascii", b"exported by hand\n"),
            6000.0,
            "not have the length that its header states",
        ),
        ("a.obj", obj().replace(" ", "\t"), 6000.0, ""),
        ("a.obj", obj().upper().encode("utf-8-sig"), 6000.0, ""),
        ("a.obj", obj().encode("utf-16"), 6000.0, ""),
    ],
)
def test_files_of_careless_programs_are_read(tmp_path, name, content, volume, note):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    report = read_surface(path).report
    assert report.volume_mm3 == pytest.approx(volume, rel=1e-6)
    notes = [each for each in report.repairs if not each.startswith("Merged")]
    assert len(notes) == (1 if note else 0)
    assert not note or note in notes[0]


@pytest.mark.usefixtures("parsed_here")
def test_an_error_of_trimesh_without_a_message_is_named(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise IndexError

    monkeypatch.setattr(trimesh, "load", fail)
    path = tmp_path / "a.ply"
    path.write_bytes(ply("binary"))
    assert "trimesh does not read a.ply: IndexError. VTK" in str(read_surface(path).report.repairs)


@pytest.mark.parametrize(
    ("name", "content", "expected"),
    [
        ("a.stl", text_stl([BOX]).replace(".", ","), "has decimal commas, such as"),
        ("a.obj", obj().replace(".", ","), "has decimal commas, such as"),
        ("a.ply", ply("ascii", comma=True), "has decimal commas, such as"),
        ("a.stl", text_stl([BOX])[:-300], "and no endsolid"),
        ("a.stl", "solid Empty\nendsolid Empty", "must contain triangles, got 0 vertices"),
        ("a.stl", binary_stl(13), "with 12 of the 13 triangles that its header states"),
        ("a.ply", ply("binary")[:-20], "be a readable PLY surface"),
        (
            "a.ply",
            ply("ascii").replace(b"vertex 8", b"vertex " + 5000 * b"8"),
            "must contain triangles",
        ),
    ],
)
def test_files_that_cannot_be_read_are_refused_with_the_reason(tmp_path, name, content, expected):
    path = tmp_path / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    with pytest.raises(InputError, match=expected):
        read_surface(path)


def test_a_texture_that_is_not_there_is_no_matter(tmp_path, capfd, caplog):
    head, _, rest = ply("ascii").partition(b"\n")
    path = tmp_path / "a.ply"
    path.write_bytes(head + b"\ncomment TextureFile gone.jpg\n" + rest)
    assert read_surface(path).report.volume_mm3 == pytest.approx(6000.0)
    assert capfd.readouterr() == ("", "") and not caplog.records


def test_single_precision_far_from_the_origin_is_noted(write):
    """Vertices at 2.5 km are rounded to 0.25 mm in an STL file; an OBJ file keeps their digits."""
    far = bone().apply_translation((1e6, 2.5e6, 3e5))
    single, digits = (read_surface(write(far, name)).report for name in ("a.stl", "a.obj"))
    assert "single precision rounds to 0.25 mm" in single.repairs[0]
    assert single.volume_mm3 == pytest.approx(bone().volume, rel=2e-3)
    assert digits.volume_mm3 == pytest.approx(bone().volume, rel=1e-5)
    assert not any("single precision" in each for each in digits.repairs)


def test_inches_are_suggested_for_a_femur_of_sixteen_units(write):
    guess = read_surface(write(bone((15.7, 7.9, 7.9)))).report.unit_guess
    assert "in inches it would be 399 mm, scale_mm = 25.4" in guess
    with pytest.raises(InputError, match=r"; in inches it would be 76.2 mm, scale_mm = 25.4"):
        read_surface(write(bone((3.0, 2.0, 2.0))))
