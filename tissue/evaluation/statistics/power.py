"""How often the tests of a study err: thousands of simulated or redrawn populations at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError
from tissue.evaluation.statistics.components import Components
from tissue.evaluation.statistics.discrimination import Share, classification_accuracy
from tissue.evaluation.statistics.outcome import ALPHA
from tissue.evaluation.statistics.resampling import drawn_users
from tissue.evaluation.statistics.strata import strata
from tissue.evaluation.statistics.trials import Cells

__all__ = ["POPULATIONS", "Power", "power", "redrawn_power", "simulated_cells"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
POPULATIONS = 10_000
"""Enough for an error rate of 5 % to be known to 0.4 %."""
TESTS = {"method": ((0,), False), "group": ((), True), "group x method": ((0,), True)}


@dataclass(frozen=True)
class Power:
    """How often one test rejects.

    Attributes
    ----------
    test
        "method", "group" or "group x method".
    users_per_group, populations
        Size of the study and number of populations.
    false_alarms
        Share that rejects where nothing differs (type I), with its interval.
    hits
        Share that rejects the effect (power), with its interval; 1 - hits is type II.
    """

    test: str
    users_per_group: int
    populations: int
    false_alarms: Share
    hits: Share

    @property
    def sentence(self) -> str:
        """Both error rates in words."""
        return (
            f"{self.test}: with {self.users_per_group} users a group, false alarms {_percent(self.false_alarms)}, "
            f"power {_percent(self.hits)} in {self.populations} populations."
        )


def simulated_cells(
    components: Components,
    means: ArrayLike,
    *,
    users_per_group: int,
    trials: int,
    populations: int,
    rng: np.random.Generator,
) -> tuple[Array, Ints]:
    """Cell means of populations drawn from a model with normal users, users by method, trials and rest.

    Means over trials are drawn at once from their own distribution, which is the same.

    Parameters
    ----------
    components
        Variances.
    means
        Mean of each group under each method, shape (groups, methods).
    users_per_group, trials
        Users in each group, and trials of each user under each method.

    Returns
    -------
    values, groups
        Shapes (populations, users, methods) and (users,).
    """
    expected = np.atleast_2d(np.asarray(means, dtype=float))
    if expected.ndim != 2 or not np.isfinite(expected).all():
        raise InputError(f"means must be finite, of shape (groups, methods), got {expected.shape}: one row a group")
    for name, number in (("users_per_group", users_per_group), ("trials", trials), ("populations", populations)):
        if number < 1:
            raise InputError(f"{name} must be at least 1, got {number}: use 10")
    groups = np.repeat(np.arange(len(expected)), users_per_group)
    shape = (populations, len(groups), expected.shape[1])
    shared = np.sqrt(components.user + components.trial / trials)
    per_method = np.sqrt(components.user_method + components.residual / trials)
    values = shared * rng.standard_normal((*shape[:2], 1)) + per_method * rng.standard_normal(shape)
    return values + expected[groups], groups


def power(
    components: Components,
    means: ArrayLike,
    *,
    users_per_group: int,
    trials: int,
    rng: np.random.Generator,
    populations: int = POPULATIONS,
) -> tuple[Power, ...]:
    """Error rates of the tests of methods, groups and both in a study of a given size.

    Parameters
    ----------
    components
        Variances, from :func:`tissue.evaluation.statistics.mixed.mixed_model` or assumed.
    means
        Mean of each group under each method that the study should find, shape (groups, methods).
    users_per_group, trials
        Size of the study.
    """
    size = {"users_per_group": users_per_group, "trials": trials, "populations": populations}
    values, groups = simulated_cells(components, means, rng=rng, **size)
    expected = np.atleast_2d(np.asarray(means, dtype=float))[groups]
    return _rates(values - expected, values, groups, users_per_group)


def redrawn_power(
    cells: Cells, *, rng: np.random.Generator, users_per_group: int | None = None, populations: int = POPULATIONS
) -> tuple[Power, ...]:
    """Error rates with users drawn again from a study, whatever their distribution.

    The null hypothesis is made true by taking the means of each group and method out; what is left of n users is
    stretched by sqrt(n / (n - 1)), since redrawn users vary by that much less than new ones. Power is that of finding
    an effect as large as the one measured, which holds the error of the measurement; where the true effect is zero or
    small it is too high. Assumed effects in :func:`power` do not have that fault.
    """
    if len(cells.factors) != 1:
        raise InputError("cells must have one factor within users, got several: use cells(metric) of one task")
    order = np.argsort(cells.groups, kind="stable")
    values, groups = cells.values[order], cells.groups[order]
    means = np.stack([values[groups == group].mean(axis=0) for group in range(len(cells.group_names))])[groups]
    counts = np.bincount(groups)[groups][:, None]
    null = (values - means) * np.sqrt(counts / (counts - 1.0))
    drawn = drawn_users(groups, populations, rng, per_group=users_per_group)
    return _rates(null[drawn], (means + null)[drawn], groups[drawn[0]], users_per_group or int(counts.min()))


def _rates(null: Array, planted: Array, groups: Ints, users_per_group: int) -> tuple[Power, ...]:
    """Shares of populations in which each test rejects."""
    found = []
    for name, (chosen, between) in TESTS.items():
        if (between and groups.max() == 0) or (chosen and null.shape[-1] < 2):
            continue
        shares = []
        for values in (null, planted):
            rejects = strata(values, groups, (values.shape[-1],), chosen, between=between).p < ALPHA
            shares.append(classification_accuracy(rejects, np.ones(len(rejects), dtype=bool)))
        found.append(Power(name, users_per_group, len(null), shares[0], shares[1]))
    return tuple(found)


def _percent(share: Share) -> str:
    return f"{100.0 * share.value:.1f} % [{100.0 * share.low:.1f}, {100.0 * share.high:.1f}]"
