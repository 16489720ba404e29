"""Law of one constant, against the density summed over a grid.

A normal law of its number is far off there.
"""

import numpy as np
import pytest
from planted_logs import LinearForward

from tissue.fitting.posterior import maximum_posterior
from tissue.fitting.problem import MeasuredLoads, Parameter
from tissue.materials.constants import Prior

TIMES_S = 0.01 * np.arange(400)
WIDE = Prior(0.01, 0.0, 0.1)


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(0.02, marks=pytest.mark.slow),
        pytest.param(0.05, marks=pytest.mark.slow),
        0.15,
    ],
)
def posterior(request):
    """An oscillating load of a constant whose range spans decades, below 0.02 hidden by noise."""
    basis = np.sin(9.0 * TIMES_S)[:, None, None]
    forward = LinearForward(
        (Parameter("cutting.bone.k_N_mm", WIDE),), ("force_z_N",), TIMES_S, basis
    )
    noise = 0.3 * np.random.default_rng(5).standard_normal((len(TIMES_S), 1))
    noise -= basis[:, :, 0] * (basis[:, 0, 0] @ noise) / (basis[:, 0, 0] @ basis[:, 0, 0])
    values = request.param * basis[:, :, 0] + noise
    return maximum_posterior(forward, MeasuredLoads(TIMES_S, values, ("force_z_N",)))


@pytest.fixture(scope="module")
def summed(posterior):
    """Return quantiles and spread of the number.

    Offset and bias are summed over by Gauss-Hermite points as well.
    """
    target = posterior.target
    u = posterior.maximum
    places = np.linspace(-5.0, 5.0, 101)
    points, weights = np.polynomial.hermite_e.hermegauss(5)
    offset_spread, bias_spread = np.sqrt(np.diag(posterior.covariance)[1:3])
    logs = np.empty((len(places), 5, 5))
    for i, z in enumerate(places):
        for j, a in enumerate(points):
            for k, b in enumerate(points):
                moved = u + np.concatenate(
                    [[z - u[0], a * offset_spread, b * bias_spread], np.zeros(len(u) - 3)]
                )
                logs[i, j, k] = target.value(moved) + 0.5 * (a * a + b * b)
    density = (np.exp(logs - logs.max()) * np.multiply.outer(weights, weights)).sum(axis=(1, 2))
    density /= density.sum()
    whole = np.cumsum(density) - 0.5 * density
    mean = density @ places
    return np.interp([0.05, 0.5, 0.95], whole, places), np.sqrt(density @ (places - mean) ** 2)


def test_quantiles_and_spread(posterior, summed):
    quantiles, spread = summed
    found = posterior.marginals[0]
    assert found.quantiles == pytest.approx(quantiles, abs=0.03)
    assert found.spread == pytest.approx(spread, rel=0.02)


def test_constants_known_only_by_their_sum():
    """Two constants that are known only by their sum have the right law.

    If the two ranges span decades, it is the product of their laws along the line of the sum.
    """
    priors = (Prior(0.01, 0.0, 0.1), Prior(0.03, 0.005, 0.2))
    total = 0.06
    basis = np.sin(9.0 * TIMES_S)[:, None, None]
    names = [
        Parameter(f"cutting.bone.{name}_N_mm", prior)
        for name, prior in zip("ab", priors, strict=True)
    ]
    forward = LinearForward(tuple(names), ("force_z_N",), TIMES_S, np.repeat(basis, 2, axis=2))
    noise = 2e-4 * np.random.default_rng(3).standard_normal((len(TIMES_S), 1))
    posterior = maximum_posterior(
        forward, MeasuredLoads(TIMES_S, total * basis[:, :, 0] + noise, ("force_z_N",))
    )
    z = np.linspace(-8.0, 8.0, 200_001)
    first = priors[0].x(z)
    z = z[first < total]
    first = first[first < total]
    other = priors[1].z(total - first)
    density = np.exp(-0.5 * (z**2 + other**2)) / priors[1].slope(other)
    whole = np.cumsum(density * np.gradient(z))
    expected = np.interp(np.array([0.05, 0.5, 0.95]) * whole[-1], whole, z)
    assert posterior.marginals[0].quantiles == pytest.approx(expected, abs=0.05)


def test_an_offset_that_leaves_a_jump_between_two_samples_is_not_known_within_them():
    """An offset with a jump between two samples is not known within them.

    Poses are at 1 kHz and loads are read each 20 ms: a load that jumps 8 ms after a sample may jump
    anywhere in those 20 ms.
    """
    times = 1e-3 * np.arange(2000)
    basis = np.where(times > 1.008, 1.0, 0.0)[:, None, None]
    forward = LinearForward(
        (Parameter("cutting.bone.k_N_mm", Prior(5.0, 1.0, 25.0)),), ("force_z_N",), times, basis
    )
    rng = np.random.default_rng(4)
    values = 6.0 * basis[::20, :, 0] + 0.05 * rng.standard_normal((100, 1))
    found = maximum_posterior(forward, MeasuredLoads(times[::20], values, ("force_z_N",)))
    low, high = found.offset_interval_s
    # uniform between -8 and 12 ms, weighed by the prior of 20 ms
    assert (low, high) == pytest.approx((-0.007, 0.011), abs=0.0015)
