"""Information that noise is found with, and the offset of clocks where a load jumps between two samples."""

import numpy as np
import pytest
from planted_logs import planted as plant
from planted_logs import slot

from tissue.fitting.target import Restricted, Target


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
