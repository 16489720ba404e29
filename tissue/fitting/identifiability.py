"""What a log determines: constants narrowed below their priors, and combinations of those that it cannot separate."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.fitting.posterior import Posterior

__all__ = ["AT_PRIOR", "DETERMINED", "Combination", "Identified", "identified"]

AT_PRIOR = 0.9
"""A constant whose standard deviation is above this share of its prior's stays at its prior."""
DETERMINED = 0.5
"""One below this share is determined by the log."""
LEAST_SHARE = 0.1
"""Constants with less than this share of a direction are left out of a combination where that changes its interval by
less than `LEAST_CHANGE`."""
LEAST_CHANGE = 0.05
DENSITY, EXPONENT = "density.", ".density_exponent"
"""What names of constants begin or end with that scale loads by a power."""


@dataclass(frozen=True)
class Combination:
    """A weighted sum of constants, times powers of densities, that is known better than any of them.

    Loads are such sums: a chip and an edge coefficient at one feed, times the density to the power of its exponent.

    Attributes
    ----------
    weights
        Of each constant over the median of its prior, by its name; the sizes of all weights sum to 1.
    powers
        Of each density factor or exponent, over the median of its prior.
    value, low, high
        Median, 5 and 95 %.
    contraction
        Its standard deviation over that of the prior.
    """

    weights: dict[str, float]
    powers: dict[str, float]
    value: float
    low: float
    high: float
    contraction: float

    @property
    def names(self) -> tuple[str, ...]:
        """All constants in it."""
        return (*self.weights, *self.powers)

    def of(self, relative: Mapping[str, float]) -> float:
        """Its value for constants over the medians of their priors, by their names."""
        total = sum(weight * relative[name] for name, weight in self.weights.items()) if self.weights else 1.0
        return float(total * np.prod([relative[name] ** power for name, power in self.powers.items()]))


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
    """The sum, times powers, that grows along a direction of z at the maximum, shape (k,)."""
    z, covariance = posterior.mean_z[places], posterior.covariance_z[np.ix_(places, places)]
    priors, names = [posterior.priors[at] for at in places], [posterior.names[at] for at in places]
    median = np.array([float(prior.x(0.0)) for prior in priors])
    relative = np.array([float(prior.x(each)) for prior, each in zip(priors, z, strict=True)]) / median
    slope = np.array([float(prior.slope(each)) for prior, each in zip(priors, z, strict=True)]) / median
    scales = np.array([name.startswith(DENSITY) or name.endswith(EXPONENT) for name in names])

    def spread(chosen: Array) -> float:
        return float(np.sqrt(chosen @ covariance @ chosen))

    whole, chosen = spread(direction), direction.copy()
    for at in np.argsort(np.abs(direction)):
        fewer = np.where(np.arange(len(places)) == at, 0.0, chosen)
        if abs(direction[at]) < LEAST_SHARE and abs(spread(fewer) - whole) < LEAST_CHANGE * whole:
            chosen = fewer
    weights = np.where(scales, 0.0, chosen / slope)
    size = float(np.abs(weights).sum())
    if size > 0.0:
        chosen, weights = chosen / size, weights / size
    total = float(weights @ relative) if size > 0.0 else 1.0
    if total < 0.0:
        chosen, weights, total = -chosen, -weights, -total
    powers = np.where(scales, chosen * relative / (slope * total), 0.0)
    kept = [at for at in np.argsort(-np.abs(chosen)) if chosen[at] != 0.0]
    combined = Combination(
        {names[at]: float(weights[at]) for at in kept if not scales[at]},
        {names[at]: float(powers[at]) for at in kept if scales[at]},
        0.0, 0.0, 0.0, spread(chosen) / float(np.linalg.norm(chosen)),
    )  # fmt: skip
    value = combined.of(dict(zip(names, relative.tolist(), strict=True)))
    half = 1.6448536 * spread(chosen) * value / total
    return replace(combined, value=value, low=value - half, high=value + half)
