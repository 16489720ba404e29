"""Files that a scene names and that cannot be used: one sentence and exit code 2."""

import errno
from pathlib import Path

import numpy as np
import pytest
from coarse_run import COARSE

CUBE_FACES = (
    (0, 2, 1),
    (0, 3, 2),
    (4, 5, 6),
    (4, 6, 7),
    (0, 1, 5),
    (0, 5, 4),
    (1, 2, 6),
    (1, 6, 5),
    (2, 3, 7),
    (2, 7, 6),
    (3, 0, 4),
    (3, 4, 7),
)
CUBE_CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))


def write_stl(path, corners, faces):
    """ASCII STL of triangles."""
    lines = ["solid x"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {' '.join(map(str, corners[corner]))}" for corner in face]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid x", ""]))


def test_a_scene_file_that_cannot_be_read_is_refused(refused, here, monkeypatch):
    (here / "x.toml").write_text("name =\n")
    assert refused("run", "x.toml") == (
        "scene must be valid TOML, got invalid value (at line 1, column 7) in x.toml: mend it there"
    )
    (here / "x.toml").write_bytes(b"name = '\xff'")
    assert refused("run", "x.toml") == "scene must be TOML in UTF-8, got other bytes in x.toml: save it as text"
    (here / "x.toml").write_text("name = 'x'\n")
    assert refused("run", "x.toml") == (
        "anatomy must be given, got nothing: add [anatomy] with its entries, see `tissue scenes NAME`"
    )

    def closed(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "read_text", closed)
    assert refused("run", "x.toml") == (
        "scene must be readable, got permission denied at x.toml: check who may read it"
    )


def mesh_cases():
    """Corners [file unit] and faces of surfaces that enclose no usable solid, and the messages."""
    cube = np.array(CUBE_CORNERS, dtype=float) * 30.0
    third = np.array([[15.0, 0, 0], [15.0, 30, 0], [15.0, 15, 30]])
    yield (
        "missing",
        None,
        None,
        ("anatomy.file must exist, got {path}: check the path, which is taken from the working directory"),
    )
    yield "empty", (), (), "anatomy.file must hold a surface, got the empty file empty.stl: export it again"
    yield (
        "flat",
        cube * (1, 1, 0),
        CUBE_FACES,
        ("anatomy.file must have thickness, got a flat one in flat.stl: use a closed surface"),
    )
    yield (
        "open",
        cube,
        CUBE_FACES[2:],
        ("anatomy.file must show a glenoid of about 28 x 37 mm, got a face of "),
    )
    yield (
        "fin",
        np.vstack([cube, third]),
        (*CUBE_FACES, (0, 1, 10)),
        ("anatomy.file must show a glenoid of about 28 x 37 mm, got a face of "),
    )
    yield (
        "tiny",
        cube * 1e-9,
        CUBE_FACES,
        (
            "anatomy.scale_mm must be given where the unit is not plain, got none for tiny.stl, whose longest side "
            "3e-08 would be 3e-05 µm in millimetres and 0.03 µm in metres: use millimetres per unit, for example "
            "4.7e+09"
        ),
    )
    yield (
        "huge",
        cube * 1e6,
        CUBE_FACES,
        (
            "anatomy.scale_mm must be given where the unit is not plain, got none for huge.stl, whose longest side "
            "3e+07 would be 30 km in millimetres and 3e+04 km in metres: use millimetres per unit, for example 4.7e-06"
        ),
    )


MESHES = list(mesh_cases())


@pytest.mark.parametrize(("name", "corners", "faces", "sentence"), MESHES, ids=[case[0] for case in MESHES])
def test_a_surface_that_encloses_no_bone_is_refused(refused, here, name, corners, faces, sentence):
    path = here / f"{name}.stl"
    if name == "empty":
        path.touch()
    elif corners is not None:
        write_stl(path, corners, faces)
    message = refused("run", "glenoid", "--set", f"anatomy.file={path}")
    assert message.startswith(sentence.format(path=path))


def test_a_surface_of_absurd_scale_is_refused(refused, here):
    write_stl(here / "bone.stl", np.array(CUBE_CORNERS) * 30.0, CUBE_FACES)
    assert refused("run", "glenoid", "--set", "anatomy.file=bone.stl", "--set", "anatomy.scale_mm=1000") == (
        "anatomy.scale_mm must make the longest side 1 mm to 1 m, got 1000, which makes bone.stl 30 m long: use about 1"
    )


def test_what_is_no_image_is_not_asked_for_a_threshold(refused, here):
    (here / "notes.txt").write_text("a list", "utf-8")
    assert refused("run", "milling", "--set", "anatomy.file=notes.txt").startswith(
        "anatomy.file must be an image volume of a known format, got notes.txt: use a .nii.gz"
    )


def test_an_image_needs_a_threshold(refused, here):
    assert refused("run", "milling", "--set", "anatomy.file=bone.mhd") == (
        f"anatomy.threshold must be given for an image, got nothing for {here / 'bone.mhd'}: set the grey value above "
        "which a voxel is bone"
    )


POSES = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw\n"


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        (None, "motion.file must be an existing file of poses, got {path}: give a CSV such as a run's trace.csv"),
        (
            "time_s,tool_x_mm\n0,0\n",
            "motion.file must have the columns tool_y_mm, tool_z_mm, tool_qx, tool_qy, "
            "tool_qz, "
            "tool_qw, got {path} without them: add them",
        ),
        (
            POSES + "0,0,0,1,0,0,0,1\n1,0,nan,0,0,0,0,1\n",
            "motion.file must hold finite numbers, got nan for tool_y_mm in line 3 of {path}: mend that line",
        ),
        (
            POSES + "0,0,0,1,0,0,0,1\n1,0,up,0,0,0,0,1\n",
            "motion.file must hold finite numbers, got up for tool_y_mm in line 3 of {path}: mend that line",
        ),
        (
            POSES + "0,0,0,1,0,0,0,1\n1,0\n",
            "motion.file must hold finite numbers, got nothing for tool_y_mm in line 3 of {path}: mend that line",
        ),
        (
            POSES + "0,0,0,1,0,0,0,1\n2,0,0,0,0,0,0,1\n2,0,0,0,0,0,0,1\n",
            "motion.file must have increasing time_s, got 2 after 2 in {path}: sort its rows",
        ),
        (POSES + "0,0,0,1,0,0,0,1\n", "motion.file must hold at least two poses, got 1 in {path}: record more"),
        (POSES, "motion.file must hold at least two poses, got 0 in {path}: record more"),
        (
            POSES + "0,0,0,1,0,0,0,1\n4000,0,0,0,0,0,0,1\n",
            "motion.file must last at most 3600 s, got 4000 in {path}: cut it",
        ),
        (
            POSES + "0,0,0,1,0,0,0,0\n1,0,0,0,0,0,0,1\n",
            "motion.file must hold unit quaternions, got one of length 0 at 0 s in {path}: give tool_qx, tool_qy, tool_qz and "
            "tool_qw of a rotation, and 0, 0, 0, 1 for none",
        ),
        (b"\xff\xfe\x00", "motion.file must be a CSV table, got other data in {path}: export it as text"),
    ],
    ids=["missing", "columns", "nan", "text", "gap", "order", "one", "none", "long", "quaternion", "binary"],
)
def test_a_bad_pose_table_is_refused(refused, here, table, sentence):
    path = here / "poses.csv"
    if table is not None:
        path.write_bytes(table if isinstance(table, bytes) else table.encode())
    message = refused("run", "milling", *COARSE, "--set", "motion.kind=replay", "--set", "motion.file=poses.csv")
    assert message == sentence.format(path=path)


def test_a_thrust_that_starts_below_its_end_is_refused(refused, here):
    thrust = ("--set", "motion.kind=thrust", "--set", "motion.thrust_N=40", "--set", "motion.start_mm=[0,0,-3]")
    assert refused("run", "milling", *COARSE, *thrust) == (
        "motion.depth_mm must be greater than the depth of motion.start_mm along the feed (3), got 2: start "
        "higher or go "
        "deeper"
    )
