"""Files that are known to be bad: each is refused in one sentence, none is read in silence."""

import json
import re

import fuzz_sources
import numpy as np
import pytest
from fuzz_files import read_by

from meshes.base.errors import InputError
from tissue.simulation.run_folder import SavedRun

OBJ = fuzz_sources.obj_text()
MSH = fuzz_sources.msh_text()
POSES = "time_s,tool_x_mm,tool_y_mm,tool_z_mm,tool_qx,tool_qy,tool_qz,tool_qw\n0,0,0,1,0,0,0,1\n1,0,0,0,0,0,0,1\n"
BAD_TEXT = [
    ("surface", "zero.obj", OBJ.replace("f 1 3 2", "f 0 3 2"), "vertex numbers from 1"),
    (
        "surface",
        "beyond.obj",
        OBJ.replace("f 1 3 2", "f 99 3 2"),
        "must refer to the vertices 0 to 7",
    ),
    (
        "surface",
        "back.obj",
        OBJ.replace("f 1 3 2", "f -99 3 2"),
        "refers to vertex -99 after only 8 vertices",
    ),
    (
        "surface",
        "huge.obj",
        OBJ.replace("f 1 3 2", "f 99999999999999999999 3 2"),
        "vertex numbers from 1",
    ),
    ("surface", "two.obj", OBJ.replace("f 1 3 2", "f 1 3"), "three or more vertex numbers"),
    (
        "surface",
        "nan.obj",
        OBJ.replace("v 40.0 0.0 0.0", "v nan 0.0 0.0"),
        "vertices must be finite",
    ),
    (
        "surface",
        "flat.obj",
        OBJ.replace("v 40.0 0.0 0.0", "v 40.0 0.0"),
        "three numbers of a vertex",
    ),
    ("surface", "word.obj", OBJ + "hello\n", "begins with an unknown keyword"),
    (
        "tets",
        "node.msh",
        MSH.replace("1 4 2 1 1 1 2 3 7", "1 4 2 1 1 1 2 3 77"),
        "must refer to nodes of the file, got node 77",
    ),
    ("tets", "short.msh", MSH.replace("1 4 2 1 1 1 2 3 7", "1 4 2 1 1 1 2 3"), "complete sections"),
    (
        "tets",
        "long.msh",
        MSH.replace("1 4 2 1 1 1 2 3 7", "1 4 2 1 1 1 2 3 7 8"),
        "complete sections",
    ),
    ("tets", "twice.msh", MSH.replace("\n2 40.0 0.0 0.0", "\n1 40.0 0.0 0.0"), "complete sections"),
    ("tets", "count.msh", MSH.replace("$Elements\n6", "$Elements\n9"), "complete sections"),
    ("tets", "names.msh", MSH.replace('"nodule"', '"liver"'), "must have different names"),
    ("tets", "binary.msh", MSH.replace("2.2 0 8", "2.2 1 8"), "complete sections|not installed"),
    ("tets", "new.msh", MSH.replace("2.2 0 8", "4.1 0 8"), "complete sections|not installed"),
    ("tets", "text.msh", "a mesh", "text file of version 1 or 2"),
    (
        "scene",
        "newer.toml",
        "format = 99\ntissue = '9.0'\nname = 'x'\n",
        "or older, got format 99 in .*newer.toml, written by tissue 9.0",
    ),
    ("scene", "none.toml", "format = 'x'\nname = 'x'\n", "must state the version"),
    ("scene", "number.toml", "name = 3\n", "name must"),
    ("poses", "text.csv", POSES.replace("1,0,0,0,", "1,0,up,0,"), "only numbers, got 'up'"),
    (
        "poses",
        "short.csv",
        POSES.replace("1,0,0,0,0,0,0,1", "1,0,0"),
        "8 values in each line, got 3",
    ),
    ("poses", "back.csv", POSES.replace("\n1,", "\n-1,"), "increasing values of time_s"),
    ("observer", "list.json", "[]", "must be an observer file"),
    ("observer", "cut.json", '{"format": "tissue obs', "must be an observer file"),
    ("trials", "list.jsonl", "[]\n", "file of trials"),
    ("predictor", "text.npz", "no archive", "must be a complete file"),
]


def refused(reader, path):
    """The sentence of a refusal."""
    with pytest.raises(InputError) as raised:
        read_by(reader, path)
    assert "\n" not in str(raised.value)
    return str(raised.value)


@pytest.mark.parametrize(
    ("reader", "name", "text", "sentence"), BAD_TEXT, ids=[case[1] for case in BAD_TEXT]
)
def test_a_bad_text_file_is_refused(tmp_path, reader, name, text, sentence):
    (tmp_path / name).write_text(text)
    assert re.search(sentence, refused(reader, tmp_path / name))


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """A cube in every format."""
    folder = tmp_path_factory.mktemp("cubes")
    fuzz_sources.write_meshes(folder)
    return folder


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("binary.stl", None, -50),
        ("binary.stl", (12).to_bytes(4, "little"), (13).to_bytes(4, "little")),
        ("text.stl", None, -200),
        ("binary.ply", None, -5),
        ("binary.ply", b"element vertex 8", b"element vertex 9"),
        ("text.ply", b"element face 12", b"element face 11"),
        ("text.ply", b"element face 12", b"element face 99999999999"),
        ("text.ply", b"3 0 2 1", b"3 0 2 8"),
        ("text.ply", b"3 0 2 1", b"3 0 2 -1"),
        ("text.ply", b"40.0", b"nan"),
        ("text.ply", b"40.0", b"1e300"),
    ],
)
def test_a_bad_surface_is_refused(meshes, tmp_path, name, old, new):
    content = (meshes / name).read_bytes()
    assert old is None or old in content
    (tmp_path / name).write_bytes(content[:new] if old is None else content.replace(old, new, 1))
    assert "got " in refused("surface", tmp_path / name)


@pytest.mark.parametrize(
    ("length", "message"),
    [
        (-50, "cut.stl with 11 of the 12 triangles that its header states"),
        (60, "cut.stl without a complete triangle"),
    ],
)
def test_a_binary_stl_that_is_cut_is_refused(meshes, tmp_path, length, message):
    (tmp_path / "cut.stl").write_bytes((meshes / "binary.stl").read_bytes()[:length])
    assert f"got {message}" in refused("surface", tmp_path / "cut.stl")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reader", "name", "old", "new"),
    [
        ("surface", "text.vtk", b"POLYGONS 13 36", b"POLYGONS 13 99999999999"),
        ("surface", "text.vtk", b"POINTS 8", b"POINTS 9"),
        ("surface", "text.vtk", b"POINTS 8", b"POINTS -8"),
        ("surface", "text.vtk", b"\n0 2 1 ", b"\n0 2 8 "),
        ("surface", "text.vtk", b"\n0 2 1 ", b"\n0 2 -1 "),
        ("surface", "cube.vtp", b'NumberOfPolys="12"', b'NumberOfPolys="13"'),
        ("tets", "tets.vtk", b"\n0 1 2 6 ", b"\n0 1 2 9 "),
        ("tets", "cube.vtu", b'NumberOfPoints="8"', b'NumberOfPoints="9"'),
        ("tets", "cube.vtu", b'NumberOfCells="6"', b'NumberOfCells="7"'),
    ],
)
def test_a_bad_file_of_vtk_is_refused(meshes, tmp_path, reader, name, old, new):
    content = (meshes / name).read_bytes()
    assert old in content, content[:600]
    (tmp_path / name).write_bytes(content.replace(old, new, 1))
    assert "got " in refused(reader, tmp_path / name)


SUMMARY = {
    "format": 1,
    "status": "interrupted",
    "scene": "milling",
    "layers": ["bone, hard"],
    "events": [],
}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"format": 99, "tissue": "9.0"},
            "must have format 1 or older, got format 99 in .*, written by tissue 9.0",
        ),
        ({"format": None}, "must state the version of its format"),
        ({"format": True}, "must state the version of its format"),
        ({"status": "fine"}, "must have a valid entry status"),
        ({"status": "complete"}, "must have a valid entry simulated_s"),
        ({"layers": "bone"}, "must have a valid entry layers"),
        ({"layers": ["a", "a"]}, "must have a valid entry layers"),
        ({"layers": [3]}, "must have a valid entry layers"),
        ({"events": {"what": 1}}, "must have a valid entry events"),
        ({"events": [{"what": "x"}]}, "must have a valid entry events"),
        ({"scene": ["milling"]}, "must have a valid entry scene"),
    ],
)
def test_a_bad_summary_is_refused(tmp_path, change, sentence):
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY))
    assert SavedRun(tmp_path).trace is None
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY | change))
    with pytest.raises(InputError, match=sentence):
        SavedRun(tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("0.001,", "up,", "must contain only numbers, got 'up' for time_s in line 3"),
        ("0.001,", "nan,", "must contain only finite numbers"),
        ("0.001,", "-1.0,", "must have increasing time_s"),
        ("0.001,", "0.001,7,", "values in each line"),
        ('"bone, hard"\n', "marrow\n", "must name a layer of the run"),
        ("time_s,", "seconds,", "must have the column time_s"),
        ("tool_y_mm,", "tool_x_mm,", "has two columns named tool_x_mm"),
    ],
)
def test_a_bad_trace_is_refused_and_a_whole_one_read(tmp_path, old, new, sentence):
    """The layer's name holds a comma, so that the column named after it has to be quoted."""
    from tissue.simulation.trace import Table, TraceLayout, TraceWriter

    layers = ("bone, hard",)
    columns = TraceLayout.of(layers).columns
    rows = np.zeros((3, len(columns)))
    rows[:, 0] = 1e-3 * np.arange(3)
    writer = TraceWriter(tmp_path / "trace.csv", Table(columns, rows, layers))
    writer.flush(3, force=True)
    writer.close()
    (tmp_path / "summary.json").write_text(json.dumps(SUMMARY))
    back = SavedRun(tmp_path).trace
    assert back.columns == columns and back["layer"].tolist() == ["bone, hard"] * 3
    np.testing.assert_array_equal(back.rows, rows)
    text = (tmp_path / "trace.csv").read_text()
    assert old in text
    (tmp_path / "trace.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=sentence):
        SavedRun(tmp_path)


@pytest.fixture
def entry(tmp_path, monkeypatch):
    """A cache entry, how often it was made, and a call that asks for it."""
    from meshes.base.cache import cached_arrays

    monkeypatch.setenv("TISSUE_CACHE", str(tmp_path))
    made = []

    def make():
        made.append(1)
        return {"a": np.arange(6.0).reshape(2, 3), "b": np.array([True])}

    def ask():
        arrays = cached_arrays("thing", (1, "x"), make)
        np.testing.assert_array_equal(arrays["a"], np.arange(6.0).reshape(2, 3))
        assert arrays.keys() == {"a", "b"}
        return len(made)

    assert [ask(), ask()] == [1, 1]
    return next(tmp_path.glob("thing-*.npz")), ask


def test_a_cache_entry_that_does_not_fit_is_made_again(entry, monkeypatch):
    path, ask = entry
    whole = path.read_bytes()
    for at in range(0, len(whole), 97):  # one byte wrong anywhere: read as it was or made again
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        ask()
    with np.load(path) as stored:
        held = {name: stored[name] for name in stored.files}
    for change in ({"a": np.array([{}], dtype=object)}, dict.fromkeys(held, np.array("other"))):
        count = ask()
        np.savez(path, **(held | change))
        assert ask() == count + 1
    count = ask()
    monkeypatch.setattr("meshes.base.cache.package_version", lambda: "0.0.0")
    assert ask() == count + 1
