"""Averages of logs over blocks: of logs slower than a block as well."""

import numpy as np
import pytest

from tissue.fitting.measured import block_averages, block_ticks


@pytest.mark.parametrize(("rate_Hz", "ticks"), [(1000.0, 5), (200.0, 5), (150.0, 7), (100.0, 10), (30.0, 34)])
def test_no_block_of_a_slow_log_is_empty(rate_Hz, ticks):
    times = 3.0 + np.arange(round(4.0 * rate_Hz)) / rate_Hz
    assert block_ticks(float(times[-1] - times[0]), 1.0 / rate_Hz) == ticks
    log = block_averages(times, 2.0 * times[:, None], ("force_x_N",), ticks)
    assert np.isfinite(log.values[:-1]).all()
    assert log.values[:-1, 0] == pytest.approx(2.0 * log.times_s[:-1], abs=2.0 / rate_Hz)


def test_a_long_log_has_two_thousand_samples():
    times = np.arange(0.0, 60.0, 1e-3)
    log = block_averages(times, times[:, None], ("force_x_N",), block_ticks(60.0, 1e-3))
    assert len(log.times_s) == 2000
    assert log.values[:, 0] == pytest.approx(log.times_s)
