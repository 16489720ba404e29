"""Law of residuals against SciPy's densities.

Its gradient is compared with differences, and gaps restart the chain.
"""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import t as student

from tissue.fitting.target import freedom_information, noise_terms, place_information

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
    assert noise_terms(residuals, SCALE, PHI, FREEDOM).log_density == pytest.approx(
        expected, rel=1e-12
    )


def test_the_gradient_is_that_of_the_density(residuals):
    terms = noise_terms(residuals, SCALE, PHI, FREEDOM)
    step = 1e-6

    def slope(residuals_by=0.0, scale_by=0.0, phi_by=0.0, freedom_by=0.0):
        up, down = (
            noise_terms(
                residuals + h * residuals_by,
                SCALE * np.exp(h * scale_by),
                PHI + h * phi_by,
                FREEDOM + h * freedom_by,
            ).log_density
            for h in (step, -step)
        )
        return (up - down) / (2.0 * step)

    for channel, unit in enumerate(np.eye(2)):
        assert terms.by_log_scale[channel] == pytest.approx(slope(scale_by=unit), rel=1e-6)
        assert terms.by_correlation[channel] == pytest.approx(slope(phi_by=unit), rel=1e-6)
        assert terms.by_freedom[channel] == pytest.approx(slope(freedom_by=unit), rel=1e-6)
    for row, channel in ((0, 1), (1, 0), (7, 0), (11, 1), (15, 1), (39, 0)):
        bump = np.zeros_like(residuals)
        bump[row, channel] = 1.0
        assert terms.by_residuals[row, channel] == pytest.approx(
            slope(residuals_by=bump), rel=1e-6, abs=1e-8
        )
    assert not terms.by_residuals[12:15, 1].any()


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

    by_freedom, by_place, by_scale = np.eye(3)
    of_freedom, crossed = freedom_information(np.array([freedom]))
    assert place_information(np.array([freedom]))[0] == pytest.approx(
        mean(by_place, by_place), rel=1e-4
    )
    assert of_freedom[0] == pytest.approx(mean(by_freedom, by_freedom), rel=1e-3)
    assert crossed[0] == pytest.approx(mean(by_freedom, by_scale), rel=1e-3)
