"""Predictor files: what is written comes back bit by bit, and nothing else is accepted."""

import json

import numpy as np
import pytest
from koopman_systems import duffing, record

from tissue import InputError
from tissue.prediction.edmd.dictionary import Delays, GapProducts, Gaussians
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.lifted import LiftedMap
from tissue.prediction.edmd.predictor_file import read_predictor, write_predictor

RNG = np.random.default_rng(0)
EPISODES = record(duffing, RNG.uniform(-1.0, 1.0, (4, 2)), RNG.normal(size=(4, 80)), 0.02)
FREE = Edmd(Delays(2, Gaussians(((0.1, 0.2),), columns=(0, 1))), ridge=1e-8).fit(EPISODES)
CLOSED = Edmd(GapProducts((-1.0,), columns=(1,)), ridge=1e-8).fit(EPISODES)
HEADER = {
    "horizons_ms": [1, 4, 10],
    "gain": [[0.1, 0.0]],
    "error": 1 / 3,
    "columns": ["x_m", "force_N"],
}


def written(folder, **changed):
    given = {"scene": "wall", "header": HEADER, "arrays": {"residual gain": np.eye(3)}} | changed
    return write_predictor(folder / "wall.npz", {"free": FREE, "closed": CLOSED}, **given)


def test_what_is_written_comes_back(tmp_path):
    found = read_predictor(written(tmp_path), scene="wall")
    assert (found.scene, found.header, list(found.operators)) == (
        "wall",
        HEADER,
        ["free", "closed"],
    )
    assert np.array_equal(found.arrays["residual gain"], np.eye(3))
    for name, operator in (("free", FREE), ("closed", CLOSED)):
        read = found.operators[name]
        assert read.dictionary == operator.dictionary and read.step_s == operator.step_s
        for field in LiftedMap.__dataclass_fields__:
            if field not in ("dictionary", "statistics"):
                assert np.array_equal(getattr(read, field), getattr(operator, field)), field
        assert read.statistics.samples == operator.statistics.samples
        assert np.array_equal(read.statistics.residual_rms, operator.statistics.residual_rms)
    predicted = found.operators["free"].predict(EPISODES[0].states[:3], EPISODES[0].inputs[2:8], 6)
    assert np.array_equal(
        predicted, FREE.predict(EPISODES[0].states[:3], EPISODES[0].inputs[2:8], 6)
    )
    assert [each.name for each in tmp_path.iterdir()] == ["wall.npz"]


def test_nothing_is_written_over_silently(tmp_path):
    path = written(tmp_path)
    before = path.read_bytes()
    with pytest.raises(InputError, match="out must not exist yet"):
        written(tmp_path)
    assert path.read_bytes() == before
    assert read_predictor(written(tmp_path, scene="liver", overwrite=True)).scene == "liver"


def test_a_folder_that_is_missing_is_refused(tmp_path):
    with pytest.raises(InputError, match="folder that exists"):
        written(tmp_path / "nowhere")
    assert not list(tmp_path.iterdir())


def again(path, **changed):
    """The file with other entries."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    whole = json.loads(str(arrays["json"]))
    for name, value in changed.items():
        if name in whole:
            whole[name] = value
        else:
            arrays[name.replace("__", ".")] = value
    arrays["json"] = np.array(json.dumps(whole))
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        (
            {"version": 3},
            (
                "predictor file must be of format 2 or older, got 3, written by tissue .*: read "
                "it with that version"
            ),
        ),
        (
            {"scene": "liver"},
            "predictor file must be of scene wall, got liver in .*: train it again",
        ),
        ({"format": "other"}, "predictor file must be one that 'tissue train' wrote"),
        ({"free__A": np.zeros((2, 2))}, "must be whole, got .* instead of"),
        ({"free__A": np.full_like(FREE.A, np.nan)}, "must be whole, got .*not finite"),
        ({"closed__B": np.array([object()])}, "must be whole"),
        ({"operators": {"other": {}}}, "must be whole"),
        ({"operators": 3}, "must be whole"),
    ],
    ids=["version", "scene", "format", "shape", "not finite", "pickled", "missing", "no operators"],
)
def test_another_file_is_refused_with_the_remedy(tmp_path, changed, sentence):
    path = again(written(tmp_path), **changed)
    with pytest.raises(InputError, match=sentence):
        read_predictor(path, scene="wall")


@pytest.mark.parametrize(
    "content", [b"", b"PK\x03\x04 and no more", b"\x80\x04K\x01."], ids=["empty", "cut", "pickle"]
)
def test_a_damaged_file_is_refused(tmp_path, content):
    path = tmp_path / "wall.npz"
    with pytest.raises(
        InputError,
        match=r"predictor file must be an existing file, got .*: train it with 'tissue train'",
    ):
        read_predictor(path)
    path.write_bytes(content)
    with pytest.raises(InputError, match="predictor file must be whole"):
        read_predictor(path)


def test_a_file_cut_anywhere_is_refused(tmp_path):
    path = written(tmp_path)
    whole = path.read_bytes()
    for length in np.linspace(1, len(whole) - 1, 25).astype(int):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match="predictor file must be whole"):
            read_predictor(path)


def test_a_refusal_holds_no_text_of_the_archive_reader(tmp_path):
    path = written(tmp_path)
    content = bytearray(path.read_bytes())
    for at in range(40, len(content), 97):
        content[at] ^= 255
    path.write_bytes(content)
    with pytest.raises(
        InputError, match=r"must be whole, got [^()]* \(it is damaged\): train it again"
    ):
        read_predictor(path)
