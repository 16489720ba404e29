"""Jumps of a needle's log: found at the planted moments, and none where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.needle import CHANNEL, NeedleForward, needle_names
from tissue.fitting.needle_moments import moment_densities, moment_of
from tissue.fitting.needle_search import with_jumps
from tissue.fitting.noise import noise_terms
from tissue.fitting.parameter import Parameter
from tissue.fitting.target import Unpacked
from tissue.materials.constants import constants
from tissue.materials.prior import Prior

STEP_S, FEED_M_S, BLOCK = 4e-3, 0.02, 5
NAMES = needle_names()
CITED = {name: constants(*name.split(".")[:2])[name.split(".")[2]] for name in NAMES}


def law(step_s, depth_m=0.035):
    deep = np.arange(-0.004, depth_m, step_s * FEED_M_S)
    out = np.arange(deep[-1], 0.005, -step_s * FEED_M_S)
    travel = np.concatenate([deep, np.full(round(0.2 / step_s), deep[-1]), out])
    parameters = tuple(Parameter(name, Prior.of(entry, name)) for name, entry in CITED.items())
    known = {name: entry.value for name, entry in CITED.items()}
    return NeedleForward(parameters, known, step_s * np.arange(len(travel)), travel)


def log_of(changes, noise_N=0.0, depth_m=0.035):
    """A log at 1 kHz of the law with other constants, in blocks, and the law's own jumps."""
    fine = law(1e-3, depth_m)
    fine = replace(fine, known=fine.known | {f"needle.liver.{name}": value for name, value in changes.items()})
    events = fine.expected_events()
    force = replace(fine, parameters=(), events=tuple(replace(e, seen=False) for e in events)).loads(np.empty(0))[:, 0]
    rng = np.random.default_rng(3)
    force = force + lfilter([1.0], [1.0, -0.9], noise_N * rng.standard_t(4.0, len(force)))
    count = len(force) // BLOCK
    within = 1e-3 * (np.arange(BLOCK) - 0.5 * (BLOCK - 1))
    times = 1e-3 * BLOCK * np.arange(count) - within[0]
    means = force[: count * BLOCK].reshape(count, BLOCK).mean(axis=1)
    return MeasuredLoads(times, means[:, None], (CHANNEL,), tuple(within.tolist())), fine, events


def test_density_of_a_moment_is_that_of_the_mixed_residuals():
    """Against the noise's own density of residuals mixed by hand, up to a constant."""
    rng = np.random.default_rng(0)
    before, after = rng.standard_normal((2, 12))
    before[4] = after[4] = np.nan
    noise = Unpacked(np.empty(0), 0.0, np.zeros(1), np.array([0.7]), np.array([0.6]), np.array([4.0]))
    found = moment_densities(before, after, 3, noise)
    direct = np.empty_like(found)
    for at, part in np.ndindex(found.shape):
        mixed = np.concatenate([before[:at], [part / 3 * before[at] + (1 - part / 3) * after[at]], after[at + 1 :]])
        direct[at, part] = noise_terms(mixed[:, None], noise.scale, noise.correlation, noise.freedom).log_density
    np.testing.assert_allclose(found - found[0, 0], direct - direct[0, 0], rtol=0.0, atol=1e-12)


def test_moment_has_mean_and_spread_of_its_law():
    times = 0.01 * np.arange(50)
    moments = (times[:, None] + np.array([-0.0025, 0.0025]) - 0.0025).ravel()
    found = moment_of(times, (-0.0025, 0.0025), -0.5 * ((moments - 0.2) / 0.02).reshape(50, 2) ** 2)
    assert found.mean_s == pytest.approx(0.2, abs=1e-5)
    assert found.spread_s == pytest.approx(0.02, rel=0.01)


@pytest.mark.slow
def test_log_without_noise_gives_its_moments_to_a_millisecond():
    log, fine, events = log_of({"capsule_puncture_N": 2.7, "linear_N_mm": 0.042, "static_out_N_m": 22.0})
    forward, _ = with_jumps(law(STEP_S), log)
    assert [each.kind for each in forward.events] == [each.kind for each in events] == ["puncture", "slip_out"]
    for found, planted in zip(forward.events, events, strict=True):
        assert found.seen
        assert found.at_s(forward.times_s) == pytest.approx(planted.at_s(fine.times_s), abs=1e-3)


def test_noise_of_heavy_tails_moves_no_jump():
    log, fine, events = log_of({"capsule_puncture_N": 2.7, "static_out_N_m": 22.0}, noise_N=0.008)
    forward, usable = with_jumps(law(STEP_S), log)
    moments = np.array([each.at_s(forward.times_s) for each in forward.events])
    offsets = moments - np.array([each.at_s(fine.times_s) for each in events])
    assert np.abs(offsets).max() < 0.015, "the clocks' offset, found with them, moves both"
    assert np.abs(np.diff(offsets)).max() < 0.005
    assert np.isnan(usable.values[np.abs(usable.times_s - moments[0]) < 0.01]).all()


def test_log_that_ends_before_the_capsule_breaks_has_no_puncture():
    log, _, events = log_of({}, noise_N=0.008, depth_m=0.012)
    assert "puncture" not in [each.kind for each in events]
    forward, _ = with_jumps(law(STEP_S, 0.012), log)
    assert not [each for each in forward.events if each.kind == "puncture"]


def test_capsule_that_breaks_below_the_cutting_force_is_no_jump():
    """The force is then that of cutting from the first touch on: nothing shows when it broke, and nothing misfits."""
    log, _, _ = log_of({"capsule_puncture_N": 1.0}, noise_N=0.008)
    forward, usable = with_jumps(law(STEP_S), log)
    punctures = [each for each in forward.events if each.kind == "puncture"]
    assert len(punctures) == 1
    assert not punctures[0].seen
    assert np.isfinite(usable.values).mean() > 0.7
