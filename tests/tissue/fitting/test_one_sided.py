"""Constants whose cited value is an end of their range.

They are compared with integrals over the prior that is cut off there.
"""

import numpy as np
import pytest
from planted_logs import LinearForward
from scipy.special import gammaln
from scipy.stats import multivariate_normal, norm

from tissue.fitting.marginal import log_factor
from tissue.fitting.posterior import maximum_posterior
from tissue.fitting.problem import MeasuredLoads, Parameter
from tissue.materials.constants import Prior

CITED = Prior(0.0, 0.0, 6.0)
"""Of an axial coefficient."""


def test_the_cited_value_is_the_median_and_the_range_holds_nine_tenths():
    parameter = Parameter.of("cutting.bone.axial_chip_N_mm2", CITED)
    z = np.random.default_rng(0).standard_normal(200_000)
    x = np.maximum(parameter.prior.x(z), 0.0)
    assert parameter.side == 1.0 and parameter.cited == CITED
    assert np.quantile(x, [0.05, 0.5]).tolist() == [0.0, 0.0]
    assert np.quantile(x, 0.95) == pytest.approx(6.0, rel=0.02)
    inside = Parameter.of("cutting.bone.radial_chip_N_mm2", Prior(60.0, 15.0, 180.0))
    assert inside.side == 0.0 and inside.cited is None and inside.prior.low == 15.0


@pytest.mark.parametrize("mean", [[0.4], [-2.0], [0.5, -0.7], [1.2, 0.1]])
def test_the_factor_is_the_integral_over_the_cut_off_prior(mean):
    """The factor is the integral over the cut-off prior.

    The trapezoid rule covers each number below and above 0: its likelihood below 0 is the one at 0.
    """
    k = len(mean)
    covariance = np.array([[0.5, -0.3], [-0.3, 0.4]])[:k, :k]
    axis = np.linspace(-8.0, 8.0, 321)
    grid = np.stack(np.meshgrid(*[axis] * k, indexing="ij"), axis=-1)
    at = np.maximum(grid, 0.0)
    likelihood = multivariate_normal(mean, covariance).pdf(at).reshape(grid.shape[:-1]) / np.prod(
        norm.pdf(at), axis=-1
    )
    value = likelihood * np.prod(norm.pdf(grid), axis=-1)
    for _ in range(k):
        value = np.trapezoid(value, axis, axis=0)
    assert log_factor(np.array(mean), covariance) == pytest.approx(float(np.log(value)), abs=0.01)


TIMES_S = np.arange(0.0, 1.2, 0.01)


def confounded(planted, seed):
    """Return a radial and an axial constant with nearly equal loads, and their log.

    The log has two channels.
    """
    wave = np.sin(2.0 * np.pi * TIMES_S / 0.6)
    basis = np.zeros((len(TIMES_S), 2, 2))
    basis[:, 0, 0] = wave
    basis[:, 0, 1] = 0.9 * wave
    basis[:, 1, 0] = 0.2 * wave
    parameters = (
        Parameter("cutting.bone.radial", Prior(10.0, 4.0, 25.0)),
        Parameter.of("cutting.bone.axial", CITED),
    )
    forward = LinearForward(parameters, ("force_x_N", "force_y_N"), TIMES_S, basis)
    noise = 0.8 * np.random.default_rng(seed).standard_normal((len(TIMES_S), 2))
    return forward, MeasuredLoads(TIMES_S, basis @ np.array(planted) + noise, forward.channels)


def student(residuals, noise):
    """Return the log density of residuals, shape (..., m, c), for the noise of a fit.

    It is written out independently.
    """
    nu = noise.freedom
    scale = noise.scale
    phi = noise.correlation
    first = np.sqrt(1.0 - phi**2) * residuals[..., :1, :]
    e = np.concatenate([first, residuals[..., 1:, :] - phi * residuals[..., :-1, :]], axis=-2)
    constant = (
        gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi) - np.log(scale)
    )
    return (constant - 0.5 * (nu + 1.0) * np.log1p(e**2 / (nu * scale**2))).sum(axis=(-1, -2))


@pytest.mark.parametrize(("planted", "seed"), [((14.0, 0.0), 1), ((7.0, 4.0), 2)])
def test_intervals_of_confounded_constants_are_those_of_a_sum_over_a_grid(planted, seed):
    forward, log = confounded(planted, seed)
    posterior = maximum_posterior(forward, log)
    noise = posterior.nuisances
    z = np.linspace(-1.6, 1.6, 121)
    radial = forward.parameters[0].prior.x(z)
    axial = np.linspace(0.0, 10.0, 101)
    # Bias and offset are known well and do not move the loads' shape: they are kept at the maximum.
    shifted = np.stack(
        [np.interp(TIMES_S - noise.offset_s, TIMES_S, each) for each in forward.basis[:, 0].T],
        axis=-1,
    )
    basis = np.stack([shifted, 0.2 * shifted * [1.0, 0.0]], axis=1)
    loads = np.einsum(
        "tcp,rap->ratc", basis, np.stack(np.meshgrid(radial, axial, indexing="ij"), axis=-1)
    )
    likelihood = student(log.values - loads - noise.bias, noise)
    density = np.exp(likelihood - likelihood.max()) * norm.pdf(z)[:, None]
    spread = 6.0 / 1.6448536
    beyond = density * norm.pdf(axial / spread) / spread
    weights = np.full(len(axial), axial[1])
    weights[[0, -1]] *= 0.5
    mass = beyond * weights
    of_radial = 0.5 * density[:, 0] + mass.sum(axis=1)
    summed = np.cumsum(of_radial) - 0.5 * of_radial
    low, middle, high = np.interp(np.array([0.05, 0.5, 0.95]) * of_radial.sum(), summed, radial)
    assert posterior.interval(0) == pytest.approx((low, middle, high), rel=0.03)
    end = 0.5 * density[:, 0].sum()
    of_axial = mass.sum(axis=0)
    summed = end + np.cumsum(of_axial) - 0.5 * of_axial
    wanted = np.interp(np.array([0.05, 0.5, 0.95]) * (end + of_axial.sum()), summed, axial)
    assert posterior.interval(1) == pytest.approx(wanted.tolist(), abs=0.15)
    assert (posterior.interval(1)[0] == 0.0) == (planted[1] == 0.0)
