"""Information of a log and of a planned log.

They are compared with the noise's covariance as one dense matrix.
"""

import numpy as np
import pytest
from planted_logs import LinearForward

from tissue.fitting.identifiability import expected_information, identified
from tissue.fitting.posterior import Posterior
from tissue.fitting.problem import MeasuredLoads, Parameter
from tissue.fitting.target import (
    BIAS_SHARE,
    CORRELATION_SPREAD,
    FREEDOM,
    MOST_CORRELATED,
    OFFSET_S,
    Target,
)
from tissue.materials.constants import Prior

TIMES_S = np.arange(0.0, 2.0, 0.01)
PRIORS = (Prior(5.0, 2.0, 12.0), Prior(3.0, 1.0, 6.0))
PHI = 0.7


def cut(frequency):
    """Return two constants: an oscillating load that begins and ends smoothly, and its square."""
    envelope = np.sin(np.pi * TIMES_S / TIMES_S[-1]) ** 2
    wave = envelope * np.sin(2.0 * np.pi * frequency * TIMES_S)
    parameters = tuple(Parameter(f"cutting.bone.k{at}_N", prior) for at, prior in enumerate(PRIORS))
    return LinearForward(
        parameters, ("force_z_N",), TIMES_S, np.stack([wave, wave**2], axis=1)[:, None]
    )


@pytest.fixture
def posterior():
    """At z = (0.3, -0.2) with a correlation of 0.7, whose normal law is any covariance."""
    rng = np.random.default_rng(0)
    forward = cut(1.0)
    log = MeasuredLoads(
        TIMES_S, forward.loads(np.array([6.0, 3.0])) + rng.standard_normal((200, 1)), ("force_z_N",)
    )
    target = Target(forward, log)
    u = np.zeros(target.size)
    u[:2] = (0.3, -0.2)
    u[5] = np.arctanh(PHI / MOST_CORRELATED) / CORRELATION_SPREAD
    root = 0.3 * rng.standard_normal((target.places, target.places))
    return Posterior(target, u, root @ root.T, converged=True)


def dense(posterior, columns):
    """Information of derivatives (200, k), the noise's covariance inverted as it stands."""
    scale = float(posterior.nuisances.scale[0])
    lags = np.abs(np.subtract.outer(np.arange(200), np.arange(200)))
    covariance = scale**2 / (1.0 - PHI**2) * PHI**lags
    place = (FREEDOM + 3.0) / (FREEDOM + 5.0)  # of freedom 2 + FREEDOM, the median
    return place * columns.T @ np.linalg.solve(covariance, columns)


def by_z(posterior, forward):
    slopes = [float(prior.slope(z)) for prior, z in zip(PRIORS, posterior.mean_z, strict=True)]
    bias = np.full((200, 1), BIAS_SHARE * posterior.target.log.sizes()[0])
    x = posterior.target.x(posterior.mean_z)
    by_offset = -OFFSET_S * np.gradient(forward.loads(x)[:, 0], TIMES_S)
    return np.concatenate([forward.basis[:, 0] * slopes, bias, by_offset[:, None]], axis=1)


def left(whole):
    """Of two constants, the rest with standard normal priors left free."""
    rest = whole[2:, 2:] + np.eye(len(whole) - 2)
    return whole[:2, :2] - whole[:2, 2:] @ np.linalg.solve(rest, whole[2:, :2])


def test_expected_information_of_a_candidate(posterior):
    matrix = left(dense(posterior, by_z(posterior, cut(3.0))))
    now = posterior.covariance_z
    after = np.linalg.inv(np.linalg.inv(now) + matrix)
    widest = int(np.argmax(np.diag(now)))
    (gain,) = expected_information(posterior, {"faster": cut(3.0)})
    assert gain.nats == pytest.approx(
        0.5 * np.log(np.linalg.det(now) / np.linalg.det(after)), rel=1e-6
    )
    assert gain.widest == posterior.names[widest]
    assert gain.shrinks_to == pytest.approx(
        np.sqrt(after[widest, widest] / now[widest, widest]), rel=1e-6
    )


def test_a_combination_that_is_known_for_certain_gains_nothing(posterior):
    """A combination that is known for certain gains nothing.

    In a log without noise, with a variance that rounding makes negative, one number remains.
    """
    known = np.array([3.0, -4.0]) / 5.0
    free = np.array([4.0, 3.0]) / 5.0
    covariance = np.eye(posterior.target.places)
    covariance[:2, :2] = 0.5 * np.outer(free, free) - 1e-16 * np.outer(known, known)
    matrix = left(dense(posterior, by_z(posterior, cut(3.0))))
    certain = Posterior(posterior.target, posterior.maximum, covariance, converged=False)
    (gain,) = expected_information(certain, {"faster": cut(3.0)})
    shrinks = 1.0 + 0.5 * free @ matrix @ free
    assert gain.nats == pytest.approx(0.5 * np.log(shrinks), rel=1e-6)
    assert gain.shrinks_to == pytest.approx(shrinks**-0.5, rel=1e-6)


def test_information_of_the_log(posterior):
    """The information of the log is exact with offset and bias free.

    The slope of the load by the offset comes from differences, 1e-3 of it.
    """
    expected = np.linalg.eigvalsh(
        left(dense(posterior, by_z(posterior, posterior.target.forward)))
    )[::-1]
    assert identified(posterior).eigenvalues == pytest.approx(expected, rel=1e-3)
