"""Predictors in the loop: laws of all of them, exact signals, what ends trust, and files."""

from dataclasses import replace

import numpy as np
import pytest

from tissue import InputError, load_scene
from tissue.builders.prediction import predictor, trained_predictor
from tissue.evaluation.training import fitting
from tissue.evaluation.training.evaluation import forecast_errors
from tissue.evaluation.training.fitting import fit
from tissue.evaluation.training.recording import Recording
from tissue.prediction.baselines import Kalman, Linear, LinearControl, kalman_gains
from tissue.prediction.edmd.dictionary import Identity
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.overlaps import Overlaps
from tissue.prediction.edmd.predictor_file import from_plain, to_plain
from tissue.prediction.koopman import WIDTH, Koopman
from tissue.prediction.trained import Trained
from tissue.scene.registry import PREDICTORS

STIFFNESS_N_M = 400.0
ENCODER_M = 5.5e-5
LIMIT_N = 3.3


def spring_run(seed, ticks=1200, stiffness=STIFFNESS_N_M):
    """A device that swings through the face z = 0 of a spring, read by an encoder: F = k max(0, -z)."""
    rng = np.random.default_rng(seed)
    time = 1e-3 * np.arange(ticks)
    waves = [(2.0 + 4.0 * rng.random(), 2e-3 * rng.random() + 1e-3, 6.3 * rng.random()) for _ in range(3)]
    z = sum(size * np.sin(2.0 * np.pi * hertz * time + phase) for hertz, size, phase in waves)
    aside = 1e-3 * np.column_stack([np.sin(5.0 * time + seed), np.cos(7.0 * time + seed)])
    position = ENCODER_M * np.round(np.column_stack([aside, z]) / ENCODER_M)
    velocity = np.diff(position, axis=0, prepend=position[:1]) / 1e-3
    force = np.zeros_like(position)
    force[:, 2] = stiffness * np.maximum(0.0, -position[:, 2])
    return Recording(position, velocity, force, "expert", seed)


@pytest.fixture(scope="module")
def trained():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitting, "LAGS", (10,))  # fewer dictionaries to choose from
        return fit("spring", [spring_run(seed) for seed in range(6)], rng=np.random.default_rng(0))


def made(kind, trained):
    return trained_predictor(kind, trained, force_limit_N=LIMIT_N)


def feed(predictor, forces, positions=None):
    """Give a predictor forces along z, a tick each."""
    for index, force in enumerate(forces):
        position = np.zeros(3) if positions is None else positions[index]
        predictor.observe(position, np.zeros(3), np.array([0.0, 0.0, force]))
    return predictor


@pytest.mark.parametrize("kind", PREDICTORS)
def test_a_zero_horizon_is_the_present_force(kind, trained):
    predictor, run = made(kind, trained), spring_run(50)
    for row in range(300):
        predictor.observe(run.position_m[row], run.velocity_m_s[row], run.force_N[row])
        np.testing.assert_allclose(predictor.predict(0), run.force_N[row], atol=1e-12)


@pytest.mark.parametrize("kind", PREDICTORS)
def test_asking_changes_nothing(kind, trained):
    asked, quiet, run = made(kind, trained), made(kind, trained), spring_run(51)
    for row in range(200):
        for each in (asked, quiet):
            each.observe(run.position_m[row], run.velocity_m_s[row], run.force_N[row])
        for ticks in (4, 7, 1, 3):
            asked.predict(ticks)
        np.testing.assert_array_equal(asked.predict(4), quiet.predict(4))


@pytest.mark.parametrize("kind", ["hold", "linear", "kalman"])
def test_a_constant_force_stays(kind, trained):
    predicted = feed(made(kind, trained), [1.3] * 300).predict(6)
    np.testing.assert_allclose(
        predicted, [0.0, 0.0, 1.3], atol=1e-9
    )  # a filter of 1e-3 has forgotten its start by then


@pytest.mark.parametrize("kind", ["linear", "kalman"])
def test_a_ramp_goes_on(kind, trained):
    predicted = feed(made(kind, trained), 2e-3 * np.arange(400)).predict(8)
    assert predicted[2] == pytest.approx(2e-3 * 407, abs=1e-9)


def test_a_parabola_goes_on_in_the_filter_alone():
    times = np.arange(400.0)
    predicted = feed(Kalman(), 1e-6 * times**2).predict(8)[2]
    assert predicted == pytest.approx(1e-6 * 407.0**2, abs=1e-9)
    assert abs(feed(Linear(), 1e-6 * times**2).predict(8)[2] - predicted) > 1e-5


def test_kalman_gains_are_those_that_the_recursion_settles_to():
    for ticks in (1, 10):
        onward = np.array([[1, ticks, ticks**2 / 2], [0, 1, ticks], [0, 0, 1.0]])
        noise = np.array([ticks**3 / 6, ticks**2 / 2, ticks])
        spread = np.eye(3)
        for _ in range(5000):
            spread = onward @ spread @ onward.T + 1e-3 * np.outer(noise, noise) / ticks
            gain = spread[:, 0] / (spread[0, 0] + 1.0)
            spread -= np.outer(gain, spread[0])
        np.testing.assert_allclose(kalman_gains(ticks, 1e-3), gain, rtol=1e-6)


def test_a_linear_model_with_control_is_exact_on_a_linear_model():
    """F+ = A F + B (x, v) with a device at constant speed: fitted on noise, predicted to rounding."""
    rng = np.random.default_rng(3)
    A, B = np.diag([0.9, 0.8, 0.7]), rng.standard_normal((3, 6)) * np.array([3.0] * 3 + [0.1] * 3)
    inputs, states = rng.standard_normal((400, 6)), np.zeros((400, 3))
    for row in range(399):
        states[row + 1] = A @ states[row] + B @ inputs[row]
    predictor = LinearControl(Edmd(Identity()).fit([(states, inputs, 1e-3)]))
    position, velocity, force = rng.standard_normal(3), rng.standard_normal(3), rng.standard_normal(3)
    predictor.observe(position, velocity, force)
    for step in range(6):
        np.testing.assert_allclose(predictor.predict(step), force, atol=1e-9)
        force = A @ force + B @ np.concatenate([position + 1e-3 * step * velocity, velocity])


@pytest.mark.parametrize("kind", PREDICTORS.names[1:])
def test_predictions_are_finite_whatever_comes(kind, trained):
    """NaN, infinity, jumps of metres and of 1e200; hold alone is not guarded: it repeats what it was given."""
    rng = np.random.default_rng(4)
    predictor = made(kind, trained)
    wild = (np.nan, np.inf, -np.inf, 1e200, 1e30, 3.0, 0.0)
    for _ in range(600):
        position, velocity, force = (
            np.array([rng.choice(wild) if rng.random() < 0.1 else rng.standard_normal() for _ in range(3)])
            for _ in range(3)
        )
        predictor.observe(position, velocity, force if rng.random() < 0.8 else None)
        if rng.random() < 0.05:
            predictor.pause()
        for ticks in (0, 1, 10, 40):
            assert np.isfinite(predictor.predict(ticks)).all()


@pytest.mark.parametrize("kind", PREDICTORS)
def test_after_a_pause_rates_begin_anew(kind, trained):
    predictor = feed(made(kind, trained), 1e-3 * np.arange(200))
    predictor.pause()
    predictor.observe(np.zeros(3), np.zeros(3), np.array([0.0, 0.0, 0.5]))
    # What is left is the filter's share of the jump; a line or window across the pause would predict 0.5 + 10 * 0.03.
    assert abs(predictor.predict(1)[2] - 0.5) < 0.2


def test_the_loop_predicts_as_the_operator_does(trained):
    """C A^h phi by one matrix is h steps of the operator; the last one-step error is added by its gain."""
    terms = replace(trained.terms, quiet_N=0.0)
    loop, run, lags = Koopman(trained.operator, terms), spring_run(60), trained.operator.dictionary.lags
    for row in range(200):
        loop.observe(run.position_m[row], run.velocity_m_s[row], run.force_N[row])
    states = np.hstack((run.position_m, run.force_N))[200 - lags - 2 : 200]
    missed = states[-1, 3:] - trained.operator.predict(states[:-1], None, 1)[0, 3:]
    missed *= min(1.0, terms.correction_N / np.linalg.norm(missed))
    wanted = trained.operator.predict(states[1:], None, 9)[:, 3:]
    for ticks in (1, 4, 9):
        expected = wanted[ticks - 1] + terms.gains[ticks - 1] * missed
        np.testing.assert_allclose(loop.predict(ticks), expected, rtol=1e-9, atol=1e-10)


def test_contact_is_foreseen_where_lines_cannot(trained):
    """On an unseen swing into the spring the lifted predictor beats every baseline at 4 and 8 ms."""
    runs = [spring_run(seed) for seed in range(80, 84)]
    errors = {
        kind: forecast_errors(lambda k=kind: made(k, trained), runs, horizons=(4, 8)).mean(axis=0)
        for kind in PREDICTORS
    }
    for kind in ("hold", "linear", "kalman", "dmdc"):
        assert (errors["koopman"] < errors[kind]).all(), kind
    assert errors["koopman"][0] < 0.3 * errors["hold"][0]


def test_a_slow_model_is_bridged(trained):
    """The force is seen every tenth tick, the device in every one: far closer than holding what was seen."""
    runs = [spring_run(seed) for seed in (90, 91)]
    error = {
        kind: forecast_errors(lambda k=kind: made(k, trained), runs, horizons=(0,), model_ticks=10).mean()
        for kind in ("hold", "linear", "koopman")
    }
    assert error["koopman"] < 0.5 * error["hold"]
    assert error["koopman"] < error["linear"]


@pytest.mark.parametrize("why", ["range", "residual", "growth", "short"])
def test_each_reason_ends_trust(why, trained):
    run, terms = spring_run(61), trained.terms
    if why == "growth":
        terms = replace(terms, growth=1e-3)
    loop = Koopman(trained.operator, terms)
    for row in range(200):
        loop.observe(run.position_m[row], run.velocity_m_s[row], run.force_N[row])
    if why == "growth":
        assert not loop.trusted
        return
    assert loop.trusted
    if why == "range":
        loop.observe(np.array([0.0, 0.0, 1.0]), np.zeros(3), run.force_N[200])
    elif why == "residual":
        for row in range(200, 210):
            loop.observe(run.position_m[row], run.velocity_m_s[row], run.force_N[row] * (1.0 + 0.5 * (row % 2)) + 0.2)
    else:
        loop.pause()
        loop.observe(run.position_m[200], run.velocity_m_s[200], run.force_N[200])
    assert not loop.trusted


def test_no_force_is_predicted_for_a_free_device(trained):
    loop = made("koopman", trained)
    above = np.array([0.0, 0.0, 4e-3])
    for _ in range(100):
        loop.observe(above, np.zeros(3), np.zeros(3))
    assert not loop.predict(4).any()


def test_overlaps_are_those_of_a_steady_speed():
    """z = 3 mm falling 0.5 mm a step: gaps 3, 2, -1 mm after 0, 2 and 8 steps; rates by differences; plain and back."""
    seen = Overlaps((0.0, 0.0, 1.0), 0.0, (0.0, 2.0, 8.0), 4, WIDTH)
    window = np.zeros((5, WIDTH))
    window[:, 2] = 3e-3 + 0.5e-3 * np.arange(5)
    np.testing.assert_allclose(seen.extra(window.ravel()), [0.0, 0.0, 1e-3], atol=1e-15)
    rng = np.random.default_rng(5)
    states, rates = rng.standard_normal((50, 5 * WIDTH)), rng.standard_normal((50, 5 * WIDTH))
    difference = (seen.extra(states + 1e-7 * rates) - seen.extra(states - 1e-7 * rates)) / 2e-7
    np.testing.assert_allclose(seen.extra_rates(states, rates), difference, atol=1e-6)
    assert from_plain(to_plain(seen)) == seen


def test_a_file_gives_the_same_predictor(trained, tmp_path):
    path = trained.write(tmp_path / "spring.npz")
    again, run = Trained.read(path, scene="spring"), spring_run(70)
    first, second = made("koopman", trained), made("koopman", again)
    for row in range(300):
        for each in (first, second):
            each.observe(run.position_m[row], run.velocity_m_s[row], run.force_N[row])
    # Matrices are kept in single precision: 1e-7 of states whose weights cancel to a hundredth.
    np.testing.assert_allclose(second.predict(6), first.predict(6), atol=1e-4)
    assert again.facts == trained.facts
    with pytest.raises(InputError, match=r"out must not exist yet, got .*spring.npz: pass --overwrite"):
        trained.write(path)
    trained.write(path, overwrite=True)


def test_what_cannot_be_used_is_refused(trained, tmp_path):
    path = str(trained.write(tmp_path / "spring.npz"))
    options = {"force_limit_N": LIMIT_N, "tick_s": 1e-3}
    with pytest.raises(
        InputError, match=r"must be of scene wall, got spring in .*: train it again with 'tissue train wa"
    ):
        predictor("koopman", scene_name="wall", file=path, **options)
    with pytest.raises(InputError, match=r"must be an existing file, got nowhere.npz: train it with"):
        predictor("dmdc", scene_name="wall", file="nowhere.npz", **options)
    with pytest.raises(InputError, match=r"prediction must be one of hold, linear, .*, got arima: choose"):
        predictor("arima", scene_name="wall", file="", **options)
    with pytest.raises(InputError, match="trained must be given for dmdc, got nothing: pass"):
        trained_predictor("dmdc", None, force_limit_N=LIMIT_N)
    with pytest.raises(
        InputError, match=r"coupling.predictor_file must be given for a scene other than caries, .*wall"
    ):
        predictor("koopman", scene_name="mine", file="", **options)
    with pytest.raises(InputError, match="device must have a tick of 1 ms for a trained predictor, got 2"):
        predictor("koopman", scene_name="wall", file="", force_limit_N=LIMIT_N, tick_s=2e-3)
    with pytest.raises(InputError, match="prediction must be left out without a device, got koopman"):
        load_scene("palpation", {"prediction": "koopman"})
    still = [
        Recording(run.position_m, run.velocity_m_s, 0.0 * run.force_N, "expert", run.seed) for run in [spring_run(1)]
    ]
    with pytest.raises(InputError, match="trials must leave at least 3 to learn from, got 1"):
        fit("spring", still, rng=np.random.default_rng(0))
    with pytest.raises(InputError, match="scene must have a tool that touches, got no force in any trial"):
        fit("spring", still * 3, rng=np.random.default_rng(0))
