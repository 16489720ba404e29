"""Law of residuals against SciPy's densities; gaps restart the chain."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import t as student

from tissue.fitting.target import Unpacked, likelihood, place_information

SCALE = np.array([0.3, 2.0])
PHI = np.array([0.0, 0.8])
FREEDOM = np.array([4.0, 9.0])


@pytest.fixture
def residuals():
    values = np.random.default_rng(4).normal(size=(40, 2))
    values[7, 0] = 30.0
    values[12:15, 1] = np.nan
    values[0, 0] = np.nan
    return values


def test_a_chain_is_a_product_of_conditional_densities_that_starts_anew_after_a_gap(residuals):
    expected = 0.0
    for channel, (scale, phi, freedom) in enumerate(zip(SCALE, PHI, FREEDOM, strict=True)):
        last = np.nan
        for value in residuals[:, channel]:
            if np.isfinite(value):
                started = np.isfinite(last)
                centre, width = (
                    (phi * last, scale) if started else (0.0, scale / np.sqrt(1.0 - phi**2))
                )
                expected += student.logpdf(value, freedom, centre, width)
            last = value
    noise = Unpacked(np.zeros(0), 0.0, np.zeros(2), SCALE, PHI, FREEDOM)
    log_density, e, weights = likelihood(residuals, noise)
    assert log_density == pytest.approx(expected, rel=1e-12)
    gaps = np.isnan(residuals)
    assert not e[gaps].any() and not weights[gaps].any() and (weights[~gaps] > 0.0).all()


@pytest.mark.parametrize("freedom", [2.5, 4.0, 30.0])
def test_information_is_the_mean_of_products_of_scores(freedom):
    """Each score by differences of SciPy's density, their products integrated over it."""

    def score(e, by):
        h = 1e-4
        up, down = (
            student.logpdf(e, *(np.array([freedom, 0.0, 1.0]) + sign * h * by))
            for sign in (1.0, -1.0)
        )
        return (up - down) / (2.0 * h)

    def mean(left, right):
        whole = quad(
            lambda e: student.pdf(e, freedom) * score(e, left) * score(e, right),
            -np.inf,
            np.inf,
            limit=200,
        )
        return whole[0]

    place = np.array([0.0, 1.0, 0.0])
    assert place_information(np.array([freedom]))[0] == pytest.approx(mean(place, place), rel=1e-4)
