"""Averages of logs over blocks: of logs slower than a block as well."""

import numpy as np
import pytest

from tissue.fitting.problem import block_averages, block_ticks, shift_operators


@pytest.mark.parametrize(
    ("rate_Hz", "ticks"), [(1000.0, 5), (200.0, 5), (150.0, 7), (100.0, 10), (30.0, 34)]
)
def test_no_block_of_a_slow_log_is_empty(rate_Hz, ticks):
    times = 3.0 + np.arange(round(4.0 * rate_Hz)) / rate_Hz
    assert block_ticks(float(times[-1] - times[0]), 1.0 / rate_Hz) == ticks
    log = block_averages(times, 2.0 * times[:, None], ("force_x_N",), ticks)
    assert np.isfinite(log.values[:-1]).all()
    assert log.values[:-1, 0] == pytest.approx(2.0 * log.times_s[:-1], abs=2.0 / rate_Hz)


def test_means_over_blocks_keep_the_mean_and_fold_no_tone():
    times_s = np.arange(0.0, 2.0, 1e-3)
    tone = 3.0 + np.cos(2.0 * np.pi * 400.0 * times_s)  # two periods a block of 5 ms
    found = block_averages(times_s, tone[:, None], ("force_x_N",), 5)
    assert found.values[:, 0] == pytest.approx(3.0, abs=1e-12)


@pytest.mark.parametrize(
    "stamps_s",
    [
        lambda times_s: times_s + 1_772_359_200.0,
        lambda times_s: np.round(times_s + 0.1234565, 6),
    ],
)
def test_rounded_times_give_the_blocks_of_exact_times(stamps_s):
    """Times since 1970 in double precision, and times with six decimals."""
    times_s = np.arange(2000) * 1e-3
    noise = np.random.default_rng(0).normal(size=(2000, 1))
    exact = block_averages(times_s, noise, ("force_x_N",), 5)
    rounded = block_averages(stamps_s(times_s), noise, ("force_x_N",), 5)
    assert rounded.values == pytest.approx(exact.values, abs=1e-12)


def test_a_long_log_has_two_thousand_samples():
    times = np.arange(0.0, 60.0, 1e-3)
    log = block_averages(times, times[:, None], ("force_x_N",), block_ticks(60.0, 1e-3))
    assert len(log.times_s) == 2000
    assert log.values[:, 0] == pytest.approx(log.times_s)


def test_a_curve_is_met_between_its_samples_to_third_order():
    errors = []
    for count in (51, 101):
        times = np.linspace(0.0, 1.0, count)
        wanted = np.linspace(0.1, 0.9, 777)
        values, rates = shift_operators(times, wanted, 0.013)
        errors.append(
            (
                np.abs(values @ np.sin(9.0 * times) - np.sin(9.0 * (wanted - 0.013))).max(),
                np.abs(rates @ np.sin(9.0 * times) + 9.0 * np.cos(9.0 * (wanted - 0.013))).max(),
            )
        )
    orders = np.log2(np.array(errors[0]) / errors[1])
    assert orders[0] > 2.7 and orders[1] > 1.7
    assert errors[1][0] < 1e-3


def test_a_line_is_exact_on_uneven_times_and_constant_outside():
    times = np.cumsum(np.random.default_rng(2).uniform(0.001, 0.02, 60))
    wanted = np.array([-1.0, times[0] + 0.003, times[30] - 1e-4, times[30], times[-1] - 1e-3, 9.0])
    values, rates = shift_operators(times, wanted, 0.0)
    line = 2.0 * times + 1.0
    np.testing.assert_allclose(
        values @ line, 2.0 * np.clip(wanted, times[0], times[-1]) + 1.0, rtol=1e-12
    )
    np.testing.assert_allclose(rates @ line, [0.0, -2.0, -2.0, -2.0, -2.0, 0.0], atol=1e-9)
