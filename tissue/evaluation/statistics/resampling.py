"""Intervals by drawing users again: the unit that is sampled is the user, not the trial."""

import numpy as np

from meshes.base.arrays import Ints

__all__ = ["drawn_users"]


def drawn_users(groups: Ints, count: int, rng: np.random.Generator) -> Ints:
    """Users drawn with replacement, as many in each group as it has, in the order of groups.

    Parameters
    ----------
    groups
        Group of every user, 0 to G - 1, shape (users,).
    count
        Number of populations.

    Returns
    -------
    Ints
        Indices of users, shape (count, users).
    """
    members = (np.flatnonzero(groups == group) for group in range(int(groups.max()) + 1))
    return np.concatenate([each[rng.integers(len(each), size=(count, len(each)))] for each in members], axis=1)
