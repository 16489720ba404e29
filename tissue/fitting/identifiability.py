"""What a log determines: constants narrowed below their priors, and combinations of those that it cannot separate."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.fitting.posterior import Posterior

__all__ = ["AT_PRIOR", "DETERMINED", "Combination", "Identified", "identified"]

AT_PRIOR = 0.9
"""A constant whose standard deviation is above this share of its prior's stays at its prior."""
DETERMINED = 0.5
"""One below this share is determined by the log."""
LEAST_POWER = 0.1
"""Powers below this share of the greatest are left out of a combination where that changes its interval by less than
`LEAST_CHANGE`."""
LEAST_CHANGE = 0.05


@dataclass(frozen=True)
class Combination:
    """A product of powers of constants that is known better than any of them.

    Attributes
    ----------
    powers
        Power of each constant by its name; the greatest is 1.
    value, low, high
        Of the product, over its value at the prior's medians: median, 5 and 95 %.
    contraction
        Its standard deviation over that of the prior.
    """

    powers: dict[str, float]
    value: float
    low: float
    high: float
    contraction: float

    @property
    def formula(self) -> str:
        """Such as ``a^1 * b^-0.5``."""
        return " * ".join(name if power == 1.0 else f"{name}^{power:.2g}" for name, power in self.powers.items())


@dataclass(frozen=True)
class Identified:
    """What a log determines of each constant.

    Attributes
    ----------
    contraction
        Standard deviation of each constant's z after the log, 1 before it, shape (p,).
    eigenvalues
        Of the information of the log, that of the prior being 1, shape (p,), greatest first.
    combinations
        Of constants that are not determined one by one.
    """

    names: tuple[str, ...]
    contraction: Array
    eigenvalues: Array
    combinations: tuple[Combination, ...]

    @property
    def determined(self) -> tuple[str, ...]:
        """Constants that the log determines by themselves."""
        return tuple(name for name, share in zip(self.names, self.contraction, strict=True) if share < DETERMINED)

    @property
    def at_prior(self) -> tuple[str, ...]:
        """Constants that the log does not narrow by themselves."""
        return tuple(name for name, share in zip(self.names, self.contraction, strict=True) if share > AT_PRIOR)

    @property
    def is_empty(self) -> bool:
        """Whether the log determines nothing at all."""
        return not self.determined and not self.combinations


def identified(posterior: Posterior) -> Identified:
    """What the log determines: eigenvectors of its information in units of the prior, the nuisances left free."""
    covariance = posterior.covariance_z
    contraction = np.asarray(np.sqrt(np.diag(covariance)), dtype=np.float64)
    eigenvalues = np.asarray(1.0 / np.linalg.eigvalsh(covariance) - 1.0, dtype=np.float64)
    left: Ints = np.flatnonzero(contraction >= DETERMINED).astype(np.int64)
    combinations = []
    if len(left) > 1:
        values, vectors = np.linalg.eigh(covariance[np.ix_(left, left)])
        for value, vector in zip(values, vectors.T, strict=True):
            if value < DETERMINED**2:
                combinations.append(_combination(posterior, left, vector))
    return Identified(posterior.names, contraction, eigenvalues, tuple(combinations))


def _combination(posterior: Posterior, places: Ints, direction: Array) -> Combination:
    """The product of powers whose logarithm moves along a direction of z, shape (k,)."""
    z, covariance = posterior.mean_z[places], posterior.covariance_z[np.ix_(places, places)]
    priors = [posterior.priors[at] for at in places]
    x = np.array([float(prior.x(each)) for prior, each in zip(priors, z, strict=True)])
    slope = np.array([float(prior.slope(each)) for prior, each in zip(priors, z, strict=True)]) / x
    powers = direction / slope
    powers /= powers[np.argmax(np.abs(powers))]

    def spread(chosen: Array) -> float:
        return float(np.sqrt((chosen * slope) @ covariance @ (chosen * slope)))

    whole = spread(powers)
    for at in np.argsort(np.abs(powers)):
        fewer = powers.copy()
        fewer[at] = 0.0
        if abs(powers[at]) < LEAST_POWER and abs(spread(fewer) - whole) < LEAST_CHANGE * whole:
            powers = fewer
    at_prior = np.array([np.log(x[k] / float(prior.x(0.0))) for k, prior in enumerate(priors)])
    middle, half = float(powers @ at_prior), 1.6448536 * spread(powers)
    before = float(np.linalg.norm(powers * slope))
    order = np.argsort(-np.abs(powers))
    names = {posterior.names[places[k]]: float(powers[k]) for k in order if powers[k] != 0.0}
    low, value, high = np.exp(middle + half * np.array([-1.0, 0.0, 1.0])).tolist()
    return Combination(names, value, low, high, spread(powers) / before)
