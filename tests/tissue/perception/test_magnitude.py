"""Posterior of a person's reports of intensity against SciPy's distributions and its own sums."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import invgamma, multivariate_t, norm

from tissue.perception.adaptive import (
    PRIOR_MEAN,
    PRIOR_SCALE,
    PRIOR_SHAPE,
    PRIOR_WEIGHT,
    fit_magnitudes,
)

FORCES_N = np.array([0.3, 0.6, 1.0, 1.7, 2.4, 3.0])
NUMBERS = np.array([0.2, 0.5, 0.8, 2.9, 3.7, 7.0])


def test_moments_of_ln_sigma_are_those_of_an_inverse_gamma_variance():
    posterior = fit_magnitudes(FORCES_N, NUMBERS)
    law = invgamma(posterior.shape, scale=posterior.scale)
    mean = quad(lambda share: 0.5 * np.log(law.ppf(share)), 0.0, 1.0, epsabs=1e-10)[0]
    square = quad(lambda share: (0.5 * np.log(law.ppf(share)) - mean) ** 2, 0.0, 1.0, epsabs=1e-10)[
        0
    ]
    assert posterior.log_sigma() == pytest.approx((mean, square), rel=1e-5)


def test_the_posterior_is_prior_times_likelihood():
    """The posterior is prior times likelihood.

    Ratios of the posterior's density at several laws equal those of prior times likelihood, written
    out.
    """
    posterior = fit_magnitudes(FORCES_N, NUMBERS)
    rng, logs = np.random.default_rng(0), []
    for _ in range(20):
        law, variance = rng.normal([0.0, 1.6], [0.4, 0.4]), rng.uniform(0.02, 0.5)
        sigma = np.sqrt(variance)
        off = np.log(NUMBERS) - law[0] - law[1] * np.log(FORCES_N)
        wanted = norm.logpdf(off, scale=sigma).sum()
        wanted += norm.logpdf(law, PRIOR_MEAN, sigma / np.sqrt(PRIOR_WEIGHT)).sum()
        wanted += invgamma.logpdf(variance, PRIOR_SHAPE, scale=PRIOR_SCALE)
        away = law - posterior.mean
        found = -0.5 * away @ posterior.precision @ away / variance - np.log(variance)
        found += invgamma.logpdf(variance, posterior.shape, scale=posterior.scale)
        logs.append(found - wanted)
    assert np.ptp(logs) < 1e-9


def test_covariance_and_quantiles_are_those_of_the_marginal_t():
    posterior = fit_magnitudes(FORCES_N, NUMBERS)
    spread = posterior.scale / posterior.shape * np.linalg.inv(posterior.precision)
    law = multivariate_t(posterior.mean, spread, df=2.0 * posterior.shape)
    drawn = law.rvs(400_000, random_state=1)
    # 1 %, three standard errors
    assert posterior.covariance == pytest.approx(np.cov(drawn.T), rel=0.02, abs=2e-4)
    found = posterior.exponent_at([0.05, 0.5, 0.95])
    assert found == pytest.approx(np.quantile(drawn[:, 1], [0.05, 0.5, 0.95]), abs=0.003)
