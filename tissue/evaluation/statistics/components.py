"""How much users, users' taste for a method, trials and chance vary: closed form for complete designs."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.evaluation.statistics.trials import TrialTable

__all__ = ["Components", "balanced_components", "balanced_values"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class Components:
    """Variances in the square of the metric's unit.

    Attributes
    ----------
    user
        Of users about their group.
    user_method
        Of how users differ in taking the methods, within a task.
    trial
        Of trials of one user, shared by all methods that render that trial.
    residual
        Of what is left.
    user_task
        Of how users differ in taking the tasks; zero for one task.
    """

    user: float
    user_method: float
    trial: float
    residual: float
    user_task: float = 0.0


def balanced_values(table: TrialTable, metric: str) -> tuple[Array, Ints]:
    """A complete table of one task as an array of shape (users, methods, trials), and the group of every user.

    Raises
    ------
    InputError
        If a trial failed or is missing.
    """
    values = table.values(metric)
    people, person = np.unique(table.people(), return_inverse=True)
    methods, method = np.unique(table.method, return_inverse=True)
    count, rest = divmod(len(table), len(people) * len(methods))
    if len(np.unique(table.task)) > 1:
        raise InputError("table must hold one task, got several: choose one by where(task=...)")
    order = np.lexsort([table.trial, method, person])
    full = not rest and bool((np.bincount(person * len(methods) + method, minlength=1) == count).all())
    if not full or table.failed or not np.isfinite(values).all():
        raise InputError(
            f"table must be complete for a closed form, got {len(table)} rows of {len(people)} users and "
            f"{len(methods)} methods, {table.failed} failed: use mixed_model"
        )
    shaped = (len(people), len(methods), count)
    numbers = table.trial[order].reshape(shaped)
    if (numbers != numbers[:, :1]).any():
        raise InputError("trials must be the same under every method, got different numbers: use mixed_model")
    group_of = np.unique(table.group, return_inverse=True)[1]
    return values[order].reshape(shaped), group_of[order].reshape(shaped)[:, 0, 0].astype(np.int64)


def balanced_components(values: Array, groups: Ints) -> Components:
    """Restricted maximum likelihood in closed form, from the mean squares of a complete design.

    In a complete design the estimates are the solutions of observed = expected mean squares wherever none is negative
    (Searle et al. 1992, section 4.8); a negative one is set to zero, which is then an approximation.

    Parameters
    ----------
    values
        Shape (users, methods, trials), two or more of each; trials are paired over methods.
    groups
        Group of every user, shape (users,); means of groups and methods are free.
    """
    if values.ndim != 3 or min(values.shape) < 2:
        raise InputError(f"values must have two or more users, methods and trials, got {values.shape}: add some")
    users, methods, trials = values.shape
    counts = np.bincount(groups)
    cell_means = np.stack([values[groups == group].mean(axis=(0, 2)) for group in range(len(counts))])
    within = values - cell_means[groups][:, :, None]
    free = users - len(counts)
    if free < 1:
        raise InputError(f"users must outnumber groups, got {users} in {len(counts)}: use two or more a group")
    user = within.mean(axis=(1, 2))
    taste = within.mean(axis=2) - user[:, None]
    trial = within.mean(axis=1) - user[:, None]
    rest = within - user[:, None, None] - taste[:, :, None] - trial[:, None, :]
    between = methods * trials * float((user**2).sum()) / free
    tastes = trials * float((taste**2).sum()) / (free * (methods - 1))
    repeats = methods * float((trial**2).sum()) / (users * (trials - 1))
    residual = float((rest**2).sum()) / (users * (trials - 1) * (methods - 1))
    return Components(
        max(0.0, (between - tastes - repeats + residual) / (methods * trials)),
        max(0.0, (tastes - residual) / trials),
        max(0.0, (repeats - residual) / methods),
        residual,
    )
