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
CUBE_CORNERS = (
    (0, 0, 0),
    (1, 0, 0),
    (1, 1, 0),
    (0, 1, 0),
    (0, 0, 1),
    (1, 0, 1),
    (1, 1, 1),
    (0, 1, 1),
)


def write_stl(path, corners, faces):
    """ASCII STL of triangles."""
    lines = ["solid x"]
    for face in faces:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {' '.join(map(str, corners[corner]))}" for corner in face]
        lines += ["endloop", "endfacet"]
    path.write_text("\n".join([*lines, "endsolid x", ""]))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"name =\n", ("scene", "line 1, column 7", "x.toml")),
        (b"name = '\xff'", ("scene", "UTF-8", "x.toml")),
        (b"name = 'x'\n", ("anatomy", "[anatomy]")),
    ],
    ids=["syntax", "bytes", "entry"],
)
def test_a_scene_file_that_cannot_be_read_is_refused(refused, here, content, words):
    (here / "x.toml").write_bytes(content)
    message = refused("run", "x.toml")
    assert message.startswith(words[0]) and all(word in message for word in words)


def test_a_scene_file_that_may_not_be_read_is_refused(refused, here, monkeypatch):
    (here / "x.toml").touch()

    def closed(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", closed)
    message = refused("run", "x.toml")
    assert message.startswith("scene ") and "x.toml (permission denied)" in message


CUBE = np.array(CUBE_CORNERS, dtype=float) * 30.0
MESHES = {
    "missing": (None, (), ("anatomy.file", "missing.stl")),
    "empty": ((), (), ("anatomy.file", "empty file")),
    "flat": (CUBE * (1, 1, 0), CUBE_FACES, ("anatomy.file", "thickness")),
    "tiny": (CUBE * 1e-9, CUBE_FACES, ("anatomy.scale_mm", "4.7e+09")),
    "huge": (CUBE * 1e6, CUBE_FACES, ("anatomy.scale_mm", "4.7e-06")),
}
"""Surfaces that enclose no usable solid, and the words of their messages.

Corners are in file units.
"""


@pytest.mark.parametrize("name", MESHES)
def test_a_surface_that_encloses_no_bone_is_refused(refused, here, name):
    corners, faces, words = MESHES[name]
    path = here / f"{name}.stl"
    if name == "empty":
        path.touch()
    elif corners is not None:
        write_stl(path, corners, faces)
    message = refused("run", "glenoid", "--set", f"anatomy.file={path}")
    assert message.startswith(f"{words[0]} ") and all(
        word in message for word in (*words, path.name)
    )


def test_a_surface_of_absurd_scale_is_refused(refused, here):
    write_stl(here / "bone.stl", CUBE, CUBE_FACES)
    message = refused(
        "run", "glenoid", "--set", "anatomy.file=bone.stl", "--set", "anatomy.scale_mm=1000"
    )
    assert message.startswith("anatomy.scale_mm ") and "bone.stl 30000 mm long" in message


@pytest.mark.parametrize(
    ("file", "words"),
    [("notes.txt", ("anatomy.file", "notes.txt")), ("bone.mhd", ("anatomy.threshold", "bone.mhd"))],
)
def test_an_image_must_be_one_and_have_a_threshold(refused, here, file, words):
    (here / "notes.txt").write_text("a list", "utf-8")
    message = refused("run", "milling", "--set", f"anatomy.file={file}")
    assert message.startswith(f"{words[0]} ") and words[1] in message


POSES = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw\n"


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (None, ("{path}",)),
        ("time_s,tool_x_mm\n0,0\n", ("tool_y_mm, tool_z_mm, tool_qx",)),
        (
            POSES + "0,0,0,1,0,0,0,1\n1,0,nan,0,0,0,0,1\n",
            ("nan in the column tool_y_mm in line 3",),
        ),
        (
            POSES + "0,0,0,1,0,0,0,1\n1,0,up,0,0,0,0,1\n",
            ("'up' in the column tool_y_mm in line 3",),
        ),
        (POSES + "0,0,0,1,0,0,0,1\n1,0\n", ("8 values in each line, got 2", "line 3")),
        (POSES + "0,0,0,1,0,0,0,1\n2,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n", ("time_s", "1 after 2")),
        (POSES + "0,0,0,1,0,0,0,1\n", ("two poses", "got 1")),
        (POSES, ("columns of numbers, got none",)),
        (POSES + "0,0,0,1,0,0,0,1\n4000,0,0,0,0,0,0,1\n", ("3600 s", "4000")),
        (POSES + "0,0,0,1,0,0,0,0\n1,0,0,0,0,0,0,1\n", ("quaternions", "length 0 for pose 1")),
        (b"\xff\xfe\x00", ("CSV",)),
    ],
    ids=[
        "missing",
        "columns",
        "nan",
        "text",
        "gap",
        "order",
        "one",
        "none",
        "long",
        "quaternion",
        "binary",
    ],
)
def test_a_bad_pose_table_is_refused(refused, here, table, words):
    path = here / "poses.csv"
    if table is not None:
        path.write_bytes(table if isinstance(table, bytes) else table.encode())
    message = refused(
        "run", "milling", *COARSE, "--set", "motion.kind=replay", "--set", "motion.file=poses.csv"
    )
    assert message.startswith("motion.file ") and all(
        word.format(path=path) in message for word in words
    )
    assert path.name in message
