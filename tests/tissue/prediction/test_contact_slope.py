"""The slope of a contact's force, learnt tick by tick, against the scalar recursion written out."""

import numpy as np
import pytest

from tissue.prediction.look_ahead import ContactSlope

NOISE, DRIFT, UNKNOWN = 1e-6, 50.0, 1.0
"""Documented noise [m], variance for each metre, and variance of an unknown slope."""


@pytest.mark.parametrize("step_m", [1e-7, 1e-6, 1e-5])
def test_the_first_step_counts_by_its_length_over_the_noise(step_m):
    """A step s along x shows s^2 / (s^2 + 1 um^2) of the slope: half of it at a micrometre."""
    slope, stiffness = ContactSlope(), np.array([[0.6, 0.1, 0.0], [0.0, 0.3, 0.0], [0.2, 0.0, 0.4]])
    slope.observe(np.zeros(3), np.array([1e-3, 0.0, 0.0]))
    assert not slope.matrix.any()
    moved = np.array([step_m, 0.0, 0.0])
    slope.observe(moved, np.array([1e-3, 0.0, 0.0]) - stiffness @ moved)
    wanted = np.zeros((3, 3))
    wanted[:, 0] = stiffness[:, 0] * UNKNOWN * step_m**2 / (UNKNOWN * step_m**2 + NOISE**2)
    assert slope.matrix == pytest.approx(wanted, rel=1e-9, abs=1e-12)


def test_steps_along_a_line_are_the_scalar_filter():
    """Steps along a line are the scalar filter.

    Along one direction a scalar is filtered: variance P, gain, and 50 more for each metre, bounded
    in all.
    """
    rng, along = np.random.default_rng(0), np.array([2.0, -1.0, 2.0]) / 3.0
    slope = ContactSlope()
    tip, force = np.zeros(3), np.full(3, 1e-3)
    slope.observe(tip, force)
    variance, across, found = UNKNOWN, UNKNOWN, 0.0
    for step in rng.uniform(-3e-6, 3e-6, 40):
        change = -0.5 * step + rng.normal() * 1e-7
        tip, force = tip + step * along, force + change * along
        slope.observe(tip, force)
        gain = variance * step / (NOISE**2 + variance * step**2)
        found -= (change + found * step) * gain
        variance += DRIFT * abs(step) - gain * step * variance
        across += DRIFT * abs(step)
        share = min(3.0 * UNKNOWN / (variance + 2.0 * across), 1.0)
        variance, across = share * variance, share * across
        assert along @ slope.matrix @ along == pytest.approx(found, rel=1e-9)
    assert found == pytest.approx(0.5, abs=0.05)


def test_what_was_learnt_outlasts_a_pause_and_what_is_between_is_not_taken_in():
    slope, one = ContactSlope(), np.array([1e-5, 0.0, 0.0])
    slope.observe(np.zeros(3), np.full(3, 1e-3))
    slope.observe(one, np.full(3, 1e-3) - 0.5 * one)
    before = slope.matrix.copy()
    slope.observe(5 * one, np.zeros(3))  # no contact
    slope.observe(9 * one, np.full(3, 2e-3))
    np.testing.assert_array_equal(slope.matrix, before)
    slope.observe(10 * one, np.full(3, 2e-3) - 0.2 * one)
    # Nothing is known again but the first guess: 100 / 101 of what it is off is taken in at 10
    # noises.
    assert slope.matrix[0, 0] == pytest.approx(
        before[0, 0] + (0.2 - before[0, 0]) * 100.0 / 101.0, rel=1e-9
    )
