"""Predictor files: what is written comes back, and nothing else is accepted."""

import json

import numpy as np
import pytest
from koopman_systems import duffing, record

from tissue import InputError
from tissue.prediction.edmd import Edmd
from tissue.prediction.operator import Delays, GapProducts
from tissue.prediction.trained import SHIPPED, Trained, shipped_file

RNG = np.random.default_rng(0)
EPISODES = record(duffing, RNG.uniform(-1.0, 1.0, (4, 2)), RNG.normal(size=(4, 80)), 0.02)
TRAINED = Trained(
    "wall",
    Edmd(Delays(2, GapProducts((-1.0,), columns=(1,))), ridge=1e-8).fit(EPISODES),
    Edmd(GapProducts((-1.0,), columns=(1,)), ridge=1e-8).fit(EPISODES),
    growth=1 / 3,
    facts={"horizons_ms": [1, 4, 10], "columns": ["x_m", "force_N"]},
)


def written(folder):
    return TRAINED.write(folder / "wall.npz")


def test_what_is_written_comes_back(tmp_path):
    found = Trained.read(written(tmp_path), scene="wall")
    assert (found.growth, found.fallback, found.facts) == (1 / 3, "hold", TRAINED.facts)
    for name in ("operator", "control"):
        read, operator = getattr(found, name), getattr(TRAINED, name)
        assert read.dictionary == operator.dictionary and read.step_s == operator.step_s
        for key in ("offset", "middle", "scale"):
            assert np.array_equal(getattr(read, key), getattr(operator, key)), key
        for key in ("A", "B"):
            assert getattr(read, key) == pytest.approx(getattr(operator, key), rel=1e-7), key
    assert [each.name for each in tmp_path.iterdir()] == ["wall.npz"]


@pytest.mark.parametrize("scene", sorted(each.stem for each in SHIPPED.glob("*.npz")))
def test_the_shipped_predictors_are_read(scene):
    assert Trained.read(shipped_file(scene), scene=scene).operator.state_size == 2


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
        ({"version": 4}, "must be of format 3 or older, got 4"),
        ({"scene": "liver"}, "must be of scene wall, got liver"),
        ({"format": "other"}, "must be one that 'tissue train' wrote"),
        ({"lifted__A": np.zeros((2, 2))}, "must be whole, got .* shape"),
        ({"lifted__A": np.full_like(TRAINED.operator.A, np.nan)}, "must be whole, .*not finite"),
        ({"control__B": np.array([object()])}, "must be whole"),
        ({"operators": {"other": {}}}, "must be whole"),
        ({"operators": 3}, "must be whole"),
        ({"header": {}}, "must be whole"),
    ],
)
def test_another_file_is_refused(tmp_path, changed, sentence):
    path = again(written(tmp_path), **changed)
    with pytest.raises(InputError, match=f"predictor file {sentence}"):
        Trained.read(path, scene="wall")


def test_a_file_cut_or_changed_anywhere_is_refused(tmp_path):
    path = written(tmp_path)
    whole = path.read_bytes()
    for length in np.linspace(1, len(whole) - 1, 25).astype(int):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match="predictor file must be whole"):
            Trained.read(path)
    content = bytearray(whole)
    for at in range(40, len(content), 97):
        content[at] ^= 255
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"must be whole, got [^()]* \(it is damaged\)"):
        Trained.read(path)
