"""Loads between the times of the poses, and their derivative by the offset."""

import numpy as np

from tissue.fitting.measured import shift_operators

TIMES = np.linspace(0.0, 1.0, 101)


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
    np.testing.assert_allclose(values @ line, 2.0 * np.clip(wanted, times[0], times[-1]) + 1.0, rtol=1e-12)
    np.testing.assert_allclose(rates @ line, [0.0, -2.0, -2.0, -2.0, -2.0, 0.0], atol=1e-9)


def test_at_the_times_themselves_nothing_is_interpolated():
    curve = np.random.default_rng(3).normal(size=len(TIMES))
    values, _ = shift_operators(TIMES, TIMES, 0.0)
    np.testing.assert_allclose(values @ curve, curve, rtol=1e-12)
