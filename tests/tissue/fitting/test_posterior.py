"""Planted constants come back with right intervals; what a log cannot determine is named."""

import numpy as np
import pytest
from planted_logs import NAMES, PRIORS, LinearForward, slot
from planted_logs import planted as plant

from tissue.fitting.identifiability import expected_information, identified
from tissue.fitting.posterior import maximum_posterior
from tissue.fitting.problem import MeasuredLoads
from tissue.fitting.target import Target, innovations


def spoilt_target():
    """A target with gaps in its log, and random numbers."""
    rng = np.random.default_rng(1)
    log, _ = plant(slot(), rng)
    log.values[100:120, 1] = np.nan
    log.values[50:60] = np.nan
    target = Target(slot(), log)
    return target, 0.3 * rng.standard_normal(target.size)


def test_gradient_by_differences():
    target, u = spoilt_target()
    gradient = target.reweighted(u)[1]
    tolerance = 1e-3 * np.abs(gradient).max()
    for at in range(target.places):
        moved = np.zeros(target.size)
        moved[at] = 1e-6
        high, low = (target.value(u + sign * moved) for sign in (1, -1))
        assert gradient[at] == pytest.approx((high - low) / 2e-6, rel=1e-4, abs=tolerance)


def test_restricted_likelihood_is_that_of_the_whitened_sensitivities():
    """No other noise has a higher density, times the volume of the other numbers."""
    target, u = spoilt_target()

    def restricted(u):
        return target.value(u) - 0.5 * np.linalg.slogdet(target.information(u))[1]

    value, best = target.with_noise(u)
    assert value == pytest.approx(restricted(best), rel=1e-9)
    assert best[: target.places].tolist() == u[: target.places].tolist()
    for step in 0.05 * np.eye(target.size)[target.places :]:
        assert value > restricted(best + step) and value > restricted(best - step)


def test_planted_constants_bias_and_offset_come_back():
    """Each within 4.5 of its own standard deviations: 1e-5 of being further by chance."""
    rng = np.random.default_rng(2)
    log, z = plant(slot(), rng, offset_s=0.013, bias=np.array([0.4, -0.2, 0.1]))
    found = maximum_posterior(slot(), log)
    assert found.converged
    assert np.all(np.abs(found.mean_z - z) < 4.5 * np.sqrt(np.diag(found.covariance_z)))
    low, high = found.offset_interval_s
    assert high - low < 0.001 and np.abs(found.nuisances.offset_s - 0.013) < 2.0 * (high - low)
    assert found.nuisances.bias == pytest.approx([0.4, -0.2, 0.1], abs=0.15)
    assert found.nuisances.scale == pytest.approx([0.1] * 3, rel=0.1)
    assert found.nuisances.correlation == pytest.approx([0.6] * 3, abs=0.1)
    residuals = log.values - found.simulated
    fresh = innovations(residuals, found.nuisances.correlation)[1:]
    assert np.abs(np.mean(fresh[1:] * fresh[:-1])) < 0.1 * np.mean(fresh**2)


def test_outliers_do_not_move_the_estimate():
    rng = np.random.default_rng(4)
    log, _ = plant(slot(), rng)
    spoilt = log.values.copy()
    hit = rng.random(spoilt.shape) < 0.01
    spoilt[hit] += 50 * 0.14 * rng.choice([-1.0, 1.0], hit.sum())
    before, after = (
        maximum_posterior(slot(), MeasuredLoads(log.times_s, each, log.channels))
        for each in (log.values, spoilt)
    )
    assert np.all(
        np.abs(after.mean_z - before.mean_z) < 1.6 * np.sqrt(np.diag(before.covariance_z))
    )


def test_one_feed_gives_combinations_and_no_single_constant():
    log, z = plant(slot(feeds=(1.0,)), np.random.default_rng(5))
    found = maximum_posterior(slot(feeds=(1.0,)), log)
    result = identified(found)
    assert result.determined == ()
    assert [set(each.weights) for each in result.combinations] == [
        set(NAMES[0::2]),
        set(NAMES[1::2]),
    ]
    x = [float(prior.x(each)) for prior, each in zip(PRIORS, z, strict=True)]
    whole = 0.02 * x[0] + 0.5 * x[2]
    estimate = [found.priors[k].x(found.mean_z[k]) for k in range(4)]
    assert 0.02 * estimate[0] + 0.5 * estimate[2] == pytest.approx(whole, rel=0.03)
    for each in result.combinations:
        weights = np.array(list(each.weights.values()))
        assert weights == pytest.approx([w / sum(weights) for w in weights])
        assert each.low < each.exact_value(np.array(x)) < each.high
    gains = expected_information(found, {"the same": slot(feeds=(1.0,)), "three feeds": slot()})
    assert gains[0].label == "three feeds" and gains[0].shrinks_to < 0.1
    assert gains[1].shrinks_to > 0.99


def test_a_log_without_load_determines_nothing():
    forward = slot()
    still = LinearForward(
        forward.parameters, forward.channels, forward.times_s, 0.0 * forward.basis
    )
    log, _ = plant(still, np.random.default_rng(7))
    result = identified(maximum_posterior(still, log))
    assert result.is_empty and result.at_prior == NAMES
