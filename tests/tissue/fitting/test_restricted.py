"""Information that noise is found with, and the offset of clocks where a load jumps between two samples."""

import numpy as np
import pytest
from planted_logs import planted as plant
from planted_logs import slot

from tissue.fitting.forward import LinearForward
from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.parameter import Parameter
from tissue.fitting.posterior import maximum_posterior
from tissue.fitting.restricted import Restricted
from tissue.fitting.target import OFFSET_S, Target
from tissue.materials.prior import Prior


def test_gradient_by_differences():
    rng = np.random.default_rng(1)
    log, _ = plant(slot(), rng)
    log.values[100:120, 1] = np.nan
    target = Target(slot(), log)
    restricted = Restricted(target, target.start(0.0))
    u = 0.3 * rng.standard_normal(target.size)
    gradient = restricted.value_and_gradient(u)[1]
    for at in range(target.constants + 1, target.size):
        moved = np.zeros(target.size)
        moved[at] = 1e-6
        high, low = (restricted.value_and_gradient(u + sign * moved)[0] for sign in (1, -1))
        assert gradient[at] == pytest.approx((high - low) / 2e-6, rel=1e-4, abs=1e-6 * np.abs(gradient).max())


def test_information_is_that_of_the_whitened_sensitivities():
    log, _ = plant(slot(), np.random.default_rng(2))
    log.values[50:60] = np.nan
    target = Target(slot(), log)
    u = target.start(0.01)
    columns = target.whitened(target.linearised(u)[1], target.unpacked(u))
    expected = np.linalg.slogdet(columns.T @ columns + np.eye(columns.shape[1]))[1]
    restricted = Restricted(target, u)
    assert 2.0 * (target.value(u) - restricted.value_and_gradient(u)[0]) == pytest.approx(expected, rel=1e-9)


def test_an_offset_that_leaves_a_jump_between_two_samples_is_not_known_within_them():
    """Poses at 1 kHz, loads read each 20 ms: a load that jumps 8 ms after a sample jumps anywhere in those 20 ms."""
    times = 1e-3 * np.arange(2000)
    basis = np.where(times > 1.008, 1.0, 0.0)[:, None, None]
    forward = LinearForward((Parameter("cutting.bone.k_N_mm", Prior(5.0, 1.0, 25.0)),), ("force_z_N",), times, basis)
    rng = np.random.default_rng(4)
    values = 6.0 * basis[::20, :, 0] + 0.05 * rng.standard_normal((100, 1))
    found = maximum_posterior(forward, MeasuredLoads(times[::20], values, ("force_z_N",)))
    low, high = found.offset_interval_s
    # uniform between -8 and 12 ms, weighed by the prior of 20 ms
    assert (low, high) == pytest.approx((-0.007, 0.011), abs=0.0015)
    assert OFFSET_S * np.sqrt(found.covariance[1, 1]) > 0.0
