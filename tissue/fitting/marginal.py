"""The law of one constant given a log, everything else summed over: a normal law where it is one, skewed where not.

A constant whose range spans decades has a flat side: what a log knows of its value is symmetric, what it knows of the
standard normal number behind it is not. So the density of that number is found from place to place, all others summed
over by Laplace's approximation there (Tierney and Kadane 1986).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator

from meshes.base.arrays import Array
from tissue.fitting.noise import innovations
from tissue.fitting.one_sided import END, PRIOR_SPREAD, log_factor
from tissue.fitting.target import Target, Unpacked

__all__ = ["Marginal", "log_density_at", "marginal"]

FIRST_STEP, LONGER = 0.6, 1.3
"""First step from the maximum in standard deviations of the normal law there, and how each step is longer."""
STEEP, SHORTER, SHORTEST = 5.0, 0.4, 0.05
"""Fall of the log density over a step that is taken again, a shorter one; not below this share of the first."""
MOST_PLACES = 16
"""Steps to either side."""
NEGLIGIBLE = 7.0
"""How far the log density falls before the search ends: 1e-3 of the density there."""
FARTHEST = 6.0
"""Where it ends at the latest, in standard deviations of the prior."""
MOST_STEPS, NEAR = 60, 0.01
"""Steps of least squares to the best place of the others, many where a log knows combinations only, whose members lie
on a curve; and twice the log density that the last step is to add, which is taken as it promises."""
DAMPING, HARDER, EASIER = 0.1, 8.0, 0.2
"""Damping of a step that would lower the density, over the information of the priors, and how it grows after another
such step and falls after a good one (Levenberg 1944)."""
FINE = 801
SHARES = np.array([0.05, 0.5, 0.95])


@dataclass(frozen=True)
class Marginal:
    """The law of a constant's standard normal number given a log.

    Attributes
    ----------
    quantiles
        5, 50 and 95 %, shape (3,).
    spread
        Standard deviation, that of the prior being 1.
    """

    quantiles: Array
    spread: float


def marginal(target: Target, maximum: Array, covariance: Array, at: int) -> Marginal:
    """The law of a number of a fit, its noise kept.

    A one-sided constant (`tissue.fitting.one_sided`) has a probability of being its cited value and a density beyond.

    Parameters
    ----------
    target
        The density.
    maximum, covariance
        The normal law about its maximum, shape (size,) and (size, size).
    at
        Place of the number.
    """
    step = FIRST_STEP * float(np.sqrt(covariance[at, at]))
    along = covariance[:, at] / covariance[at, at]
    side = float(target.sides[at]) if at < target.constants else 0.0
    start = maximum - min(side * maximum[at], 0.0) * side * along
    top = log_density_at(target, start, at)[0]
    found = {float(start[at]): top}
    for sign in (-1.0, 1.0):
        if sign == -side and start[at] == 0.0:
            continue
        walked, last, length = [start - sign * step * along, start], top, step
        for _ in range(MOST_PLACES):
            wanted = walked[-1][at] + sign * length
            is_end = sign == -side and side * wanted <= 0.0
            tried, place = log_density_at(target, _ahead(walked, at, 0.0 if is_end else wanted), at)
            if last - tried > STEEP and length > SHORTEST * step:
                length *= SHORTER
                continue
            found[float(place[at])] = tried
            if is_end or tried < max(found.values()) - NEGLIGIBLE or abs(place[at]) > FARTHEST:
                break
            walked, last, length = [*walked, place][-3:], tried, length * LONGER
    return _one_sided(found, side) if side else _two_sided(found)


def _two_sided(found: Mapping[float, float]) -> Marginal:
    """The law of a number from its log density at some places."""
    fine, density = _fine(found)
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    mean = float(density @ fine / density.sum())
    spread = float(np.sqrt(density @ (fine - mean) ** 2 / density.sum()))
    return Marginal(np.interp(SHARES * summed[-1], summed, fine), spread)


def _one_sided(found: Mapping[float, float], side: float) -> Marginal:
    """The law of a number that is 0 or lies on one side of it; its spread is relative to that of the prior."""
    fine, density = _fine({side * place: logarithm for place, logarithm in found.items()})
    end = END * float(density[0]) if fine[0] == 0.0 else 0.0
    step = float(fine[1] - fine[0])
    summed = end + np.concatenate([[0.0], np.cumsum(0.5 * step * (density[1:] + density[:-1]))])
    weights = step * density
    weights[[0, -1]] *= 0.5
    mean = float(weights @ fine / summed[-1])
    square = float(weights @ fine**2 / summed[-1])
    quantiles = np.interp(SHARES * summed[-1], summed, fine)
    spread = float(np.sqrt(square - mean**2)) / PRIOR_SPREAD
    return Marginal(np.sort(side * quantiles), spread)


def _fine(found: Mapping[float, float]) -> tuple[Array, Array]:
    """Places between the first and the last one, and the density there, up to a constant, shape (FINE,) each."""
    places = np.array(sorted(found))
    logarithms = np.array([found[each] for each in places.tolist()])
    fine = np.linspace(places[0], places[-1], FINE)
    return fine, np.exp(PchipInterpolator(places, logarithms - logarithms.max())(fine))


def _ahead(walked: list[Array], at: int, wanted: float) -> Array:
    """The place where the number `at` is as wanted, by a parabola or line through the last places (Lagrange)."""
    numbers = np.array([each[at] for each in walked])
    found = np.zeros(len(walked[0]))
    for k, each in enumerate(walked):
        rest = np.delete(numbers, k)
        found += np.prod((wanted - rest) / (numbers[k] - rest)) * each
    found[at] = wanted
    return found


def log_density_at(target: Target, u: Array, at: int) -> tuple[float, Array]:
    """Log density of the number `at`, everything else but the noise summed over, and the best place of all others.

    Constants, offset and biases are the most probable ones there, by reweighted least squares from those given.

    Parameters
    ----------
    target
        The density.
    u
        A place, shape (size,), the noise among it.
    at
        Place of the number that stays.
    """
    others = np.flatnonzero(np.arange(target.constants + 1 + len(target.log.channels)) != at)
    noise = target.unpacked(u)
    best, damping = _near(target, u, others, noise), 0.0
    for _ in range(MOST_STEPS):
        step = np.linalg.solve(best.normal + damping * np.eye(len(others)), best.gradient)
        if (gain := float(best.gradient @ step)) < NEAR:
            break
        moved = best.u.copy()
        moved[others] += step
        tried = _near(target, moved, others, noise)
        if tried.log_density > best.log_density:
            best, damping = tried, EASIER * damping if damping > DAMPING else 0.0
        else:
            damping = max(HARDER * damping, DAMPING)
    rows = target.whitened(best.sensitivities, noise)[:, others]
    curvature = rows.T @ rows + np.eye(len(others))
    log_density = best.log_density + 0.5 * min(gain, NEAR) - 0.5 * float(np.linalg.slogdet(curvature)[1])
    bounded = np.flatnonzero(np.isin(others, np.flatnonzero(target.sides)))
    if not len(bounded):
        return log_density, best.u
    sides = target.sides[others[bounded]]
    covariance = np.asarray(np.linalg.inv(curvature), dtype=np.float64)[np.ix_(bounded, bounded)]
    return log_density + log_factor(sides * best.u[others[bounded]], covariance * np.outer(sides, sides)), best.u


@dataclass(frozen=True)
class _Near:
    """The density about a place: its logarithm, gradient by the others, their normal matrix, and sensitivities."""

    u: Array
    log_density: float
    gradient: Array
    normal: Array
    sensitivities: Array


def _near(target: Target, u: Array, others: NDArray[np.intp], noise: Unpacked) -> _Near:
    known = np.isfinite(target.log.values)
    simulated, moved = target.linearised(u)
    terms = target.terms(target.log.values - simulated, noise)
    added = np.nan_to_num(innovations(np.where(known[:, :, None], moved, np.nan)[:, :, others], noise.correlation))
    columns = (np.sqrt(terms.weights)[:, :, None] * added).reshape(-1, len(others))
    gradient = -np.tensordot(np.where(known, terms.by_residuals, 0.0), moved, 2)[others] - u[others]
    log_density = terms.log_density - 0.5 * float(u @ u)
    return _Near(u, log_density, gradient, columns.T @ columns + np.eye(len(others)), moved)
