"""Intervals by drawing users again: the unit that is sampled is the user, not the trial."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from scipy.stats import t

from meshes.base.errors import InputError, require_range
from tissue.evaluation.statistics.outcome import LEVEL, Effect

__all__ = ["bootstrap", "drawn_users"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def drawn_users(groups: Ints, count: int, rng: np.random.Generator, *, per_group: int | None = None) -> Ints:
    """Users drawn with replacement within their groups, in the order of groups.

    Parameters
    ----------
    groups
        Group of every user, 0 to G - 1, shape (users,).
    count
        Number of populations.
    per_group
        Users to draw in each group; as many as there are where it is not given.

    Returns
    -------
    Ints
        Indices of users, shape (count, users drawn).
    """
    drawn = []
    for group in range(int(groups.max()) + 1):
        members = np.flatnonzero(groups == group)
        if not len(members):
            raise InputError(f"group {group} must have users to draw from, got none: leave the group out")
        drawn.append(members[rng.integers(len(members), size=(count, per_group or len(members)))])
    return np.concatenate(drawn, axis=1)


def bootstrap(
    values: Array,
    groups: Ints,
    statistic: Callable[[Array], Array],
    *,
    name: str,
    rng: np.random.Generator,
    count: int = 4000,
    level: float = LEVEL,
) -> Effect:
    """Interval of a statistic of users by the accelerated bootstrap (BCa, Efron 1987), expanded for few users.

    N users redrawn within G groups vary too little by (N - G) / N, and a normal quantile is too near for so few, so the
    quantile is that of t, stretched by sqrt(N / (N - G)) (Hesterberg 2015).

    Parameters
    ----------
    values
        Cell means, shape (users, levels).
    groups
        Group of every user, shape (users,); users are drawn within groups.
    statistic
        Of cell means of shape (..., users, levels), gives shape (...). Users come in the order of groups.
    name
        Name of the effect.
    level
        Coverage; with fewer than ten users the interval may still cover less than stated.
    """
    require_range("level", level, 0.5, 0.999, "use 0.95")
    order = np.argsort(groups, kind="stable")
    free = len(order) - int(groups.max()) - 1
    if free < 2:
        raise InputError(f"users must outnumber groups by two to be drawn again, got {len(order)}: add users")
    stretch = (len(order) / free) ** 0.5
    measured = float(statistic(values[order]))
    found = np.sort(statistic(values[drawn_users(groups, count, rng)]))
    left_out = np.array([float(statistic(values[np.delete(order, each)])) for each in range(len(order))])
    away = left_out.mean() - left_out
    size = float((away**2).sum())
    if size == 0.0:
        raise InputError(f"{name} must vary with the users, got {measured:g} whoever is left out: leave it out")
    pull = float((away**3).sum()) / (6.0 * size**1.5)
    share = np.clip((found < measured).mean() + 0.5 * (found == measured).mean(), 0.5 / count, 1.0 - 0.5 / count)
    shift = float(ndtri(share))
    ends = []
    for tail in (0.5 * (1.0 - level), 0.5 * (1.0 + level)):
        z = shift + stretch * float(t.ppf(tail, free))
        ends.append(float(np.quantile(found, float(ndtr(shift + z / (1.0 - pull * z))))))
    return Effect(name, measured, ends[0], ends[1])
