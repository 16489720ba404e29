"""Errors of estimated forces where prior or noise are wrong."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.perception.estimate import map_force_N
from tissue.perception.recursive import LocalLevel

__all__ = ["AssumptionResult", "map_estimate_errors", "recursive_estimate_errors"]

MEDIAN_N, LOG_SPREAD, NOISE_N = 1.0, 1.0, 0.3
"""What single looks are tried on: forces as the prior of ``perception.toml``, a look that scatters as at 4 N."""
WANDER, NOISE, TICKS = 1e-4, 1.0, 2000
"""Variances of level and look that the recursion is tried on, and for how long."""
TAIL = 3.0
"""Degrees of freedom of Student's t for heavy tails; its variance is brought to that of the Gaussian."""
FATIGUE = 0.1
"""Share by which a force feels stronger after long pressing, memory of the literature (Jones and Hunter 1983)."""


@dataclass(frozen=True, kw_only=True)
class AssumptionResult:
    """An assumption and what it costs.

    Attributes
    ----------
    assumed
        What is taken for granted, or what is true instead.
    error
        Root mean square error: of one look in units of its noise, of the recursion in units of the right filter's
        standard deviation.
    held
        Share of true levels within 1.96 standard deviations of the recursion; not a number for one look.
    """

    assumed: str
    error: float
    held: float = float("nan")


def map_estimate_errors(rng: np.random.Generator, *, count: int = 20_000) -> list[AssumptionResult]:
    """The estimate of greatest density from one look at each of ``count`` forces, by what is assumed."""
    truth = MEDIAN_N * np.exp(LOG_SPREAD * rng.standard_normal(count))
    gaussian, tails = NOISE_N * rng.standard_normal(count), NOISE_N * _heavy(rng, count)
    error_of = lambda estimate: float(np.sqrt(np.mean((estimate - truth) ** 2))) / NOISE_N  # noqa: E731

    def found(seen: Array, *, median: float = 1.0, spread: float = 1.0, noise: float = 1.0) -> float:
        return error_of(map_force_N(seen, noise * NOISE_N, median_N=median * MEDIAN_N, log_spread=spread * LOG_SPREAD))

    seen = truth + gaussian
    return [
        AssumptionResult(assumed="the look itself", error=error_of(seen)),
        AssumptionResult(assumed="right prior and noise", error=found(seen)),
        AssumptionResult(assumed="prior's median / 3", error=found(seen, median=1.0 / 3.0)),
        AssumptionResult(assumed="prior's median x 3", error=found(seen, median=3.0)),
        AssumptionResult(assumed="prior's spread / 2", error=found(seen, spread=0.5)),
        AssumptionResult(assumed="prior's spread x 2", error=found(seen, spread=2.0)),
        AssumptionResult(assumed="noise / 2", error=found(seen, noise=0.5)),
        AssumptionResult(assumed="noise x 2", error=found(seen, noise=2.0)),
        AssumptionResult(assumed="truth has heavy tails", error=found(truth + tails)),
        AssumptionResult(assumed="truth fatigues by 10 %", error=found((1.0 + FATIGUE) * truth + gaussian)),
    ]


def recursive_estimate_errors(rng: np.random.Generator, *, runs: int = 200) -> list[AssumptionResult]:
    """The recursive estimate of a wandering level in each of ``runs`` runs, by what is assumed."""
    right = LocalLevel(wander=WANDER, noise=NOISE)
    level = 5.0 + np.cumsum(np.sqrt(WANDER) * rng.standard_normal((TICKS, runs)), axis=0)
    gaussian, tails = rng.standard_normal((TICKS, runs)), _heavy(rng, (TICKS, runs))
    fatigue = FATIGUE * np.linspace(0.0, 1.0, TICKS)[:, None]
    cases = [
        ("right variances", right, level + gaussian),
        ("wander / 10", LocalLevel(wander=0.1 * WANDER, noise=NOISE), level + gaussian),
        ("wander x 10", LocalLevel(wander=10.0 * WANDER, noise=NOISE), level + gaussian),
        ("noise / 10", LocalLevel(wander=WANDER, noise=0.1 * NOISE), level + gaussian),
        ("truth has heavy tails", right, level + tails),
        ("truth fatigues by 10 %", right, (1.0 + fatigue) * level + gaussian),
    ]
    return [_followed(assumed, law, level, seen, right.steady_variance) for assumed, law, seen in cases]


def _followed(assumed: str, law: LocalLevel, level: Array, seen: Array, best: float) -> AssumptionResult:
    """The second half of runs that a filter follows."""
    estimate, variance = seen[0], law.noise
    off, held = [], []
    for tick in range(1, len(level)):
        estimate, variance = law.step(estimate, variance, seen[tick])
        if tick >= len(level) // 2:
            off.append((estimate - level[tick]) ** 2)
            held.append(off[-1] < 1.96**2 * variance)
    return AssumptionResult(assumed=assumed, error=float(np.sqrt(np.mean(off) / best)), held=float(np.mean(held)))


def _heavy(rng: np.random.Generator, shape: int | tuple[int, ...]) -> Array:
    """Student's t with unit variance."""
    return np.asarray(rng.standard_t(TAIL, shape) / np.sqrt(TAIL / (TAIL - 2.0)))
