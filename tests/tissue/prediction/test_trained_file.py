"""Predictor files: what is written comes back, and nothing else is accepted."""

import json

import numpy as np
import pytest

from tissue import InputError
from tissue.prediction.delays import (
    COORDINATES,
    DELAYS,
    HORIZON,
    DelayOperator,
    Moments,
    coordinates,
)
from tissue.prediction.trained import (
    FINE_STEP_M,
    SHIPPED,
    Trained,
    general_operator,
    shipped_file,
)

RNG = np.random.default_rng(0)
ROWS = RNG.normal(size=(200, COORDINATES))
TRAINED = Trained(
    "wall",
    DelayOperator(Moments(ROWS.T @ ROWS, RNG.normal(size=(COORDINATES, 2 * HORIZON))), 1 / 3),
    5.5e-5,
    DelayOperator(
        Moments(ROWS[:90].T @ ROWS[:90], RNG.normal(size=(COORDINATES, 2 * HORIZON))), 2 / 3
    ),
    facts={"horizons_ms": [1, 4, 10], "columns": ["x_m", "force_N"]},
)


def written(folder):
    return TRAINED.write(folder / "wall.npz")


def test_what_is_written_comes_back(tmp_path):
    found = Trained.read(written(tmp_path), scene="wall")
    assert (found.fallback, found.facts) == ("hold", TRAINED.facts)
    assert (found.operator.growth, found.step_m, found.fine.growth) == (1 / 3, 5.5e-5, 2 / 3)
    for which in ("operator", "fine"):
        for key in ("coordinates", "targets"):
            ours, theirs = (getattr(each, which).moments for each in (found, TRAINED))
            assert np.array_equal(getattr(ours, key), getattr(theirs, key)), (which, key)
    assert [each.name for each in tmp_path.iterdir()] == ["wall.npz"]


@pytest.mark.parametrize("scene", sorted(each.stem for each in SHIPPED.glob("*.npz")))
def test_the_shipped_predictors_are_read(scene):
    found = Trained.read(shipped_file(scene), scene=scene)
    assert found.facts["command"].startswith(f"tissue train {scene} --trials ")
    assert len(found.facts["seeds"]) >= 5


def test_an_operator_follows_the_encoder_steps_of_a_device():
    """Moments of a motion that is read in steps, interpolated between two steps."""
    times = np.arange(4000)
    # slow motions of some millimetres with periods that have no common factor
    true = sum(np.outer(np.sin(times / p), (1e-3, 7e-4, 2e-3)) for p in (97.3, 211.7, 402.9))
    ticks = times[DELAYS[-1] :, None] - np.array(DELAYS)

    def read_at(step_m):
        position = step_m * np.round(true / step_m)
        seen = coordinates(position[ticks].swapaxes(0, 1), -position[ticks].swapaxes(0, 1))
        rows = seen.transpose(1, 2, 0).reshape(-1, COORDINATES)
        after = np.repeat(rows[:, :1], 2 * HORIZON, axis=1)
        return DelayOperator(Moments(rows.T @ rows, rows.T @ after), 1.0)

    trained = Trained("wall", read_at(5.5e-5), 5.5e-5, read_at(FINE_STEP_M))
    assert trained.at_step(5.5e-5) is trained
    assert trained.at_step(1e-4) is trained
    for step_m in (FINE_STEP_M, 0.0):
        found = trained.at_step(step_m)
        assert found.step_m == FINE_STEP_M
        moments = found.operator.moments
        assert np.array_equal(moments.coordinates, trained.fine.moments.coordinates)
    found, direct = (
        np.diag(each.moments.coordinates)[: len(DELAYS) - 1]
        for each in (trained.at_step(3e-5).operator, read_at(3e-5))
    )
    # Displacements of more than a step depend on its square, so that the line is 11 % too high.
    np.testing.assert_allclose(found, direct, rtol=0.12)
    nearest = np.diag(trained.operator.moments.coordinates)[: len(DELAYS) - 1]
    assert nearest[0] > 1.5 * direct[0]


def test_the_general_operator_is_the_fit_to_the_data_of_all_scenes():
    """Scaled to one mean square of the displacements, the moments of all files add up."""
    files = [Trained.read(shipped_file(each.stem)) for each in SHIPPED.glob("*.npz")]
    shares = [each.operator.moments.power_m2 for each in files]
    found = general_operator().moments
    for key in ("coordinates", "targets"):
        summed = sum(
            getattr(each.operator.moments, key) / share
            for each, share in zip(files, shares, strict=True)
        )
        scaled = getattr(found, key) / found.power_m2
        np.testing.assert_allclose(scaled, summed / len(files), rtol=1e-9, atol=1e-18)
    other = general_operator(without="wall").moments
    assert other.power_m2 != pytest.approx(found.power_m2, rel=1e-3)


def again(path, **changed):
    """The file with other entries."""
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    whole = json.loads(str(arrays["json"]))
    for name, value in changed.items():
        if name in whole:
            whole[name] = value
        else:
            arrays[name] = value
    arrays["json"] = np.array(json.dumps(whole))
    np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"version": 6}, "must have format 5 or older, got format 6 in"),
        ({"version": 4}, "must be of version 5, got version 4 in"),
        ({"scene": "liver"}, "must be trained for the scene wall, got a predictor for liver"),
        ({"format": "other"}, "must be a file that 'tissue train' wrote"),
        ({"coordinates": np.zeros((2, 2))}, "must be complete, got .* shape"),
        (
            {"targets": np.full((COORDINATES, 2 * HORIZON), np.nan)},
            "must be complete, .*not finite",
        ),
        ({"targets": np.array([object()])}, "must be complete"),
        ({"delays": [0, 1]}, "must have the delays of this version"),
        ({"header": {}}, "must be complete"),
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
        with pytest.raises(InputError, match="predictor file must be a complete file"):
            Trained.read(path)
    content = bytearray(whole)
    for at in range(40, len(content), 97):
        content[at] ^= 255
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"must be complete, got [^()]* \(it is damaged\)"):
        Trained.read(path)
