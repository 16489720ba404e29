"""How much users, users' taste for a method, trials and chance vary: closed form for complete designs."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.evaluation.statistics.trials import TrialTable

__all__ = ["Components", "balanced_components", "balanced_values"]


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


def balanced_values(table: TrialTable, metric: str) -> tuple[Array, Ints] | None:
    """A complete table of one task as an array of shape (users, methods, trials), and the group of every user.

    None where a trial failed or is missing, or there is one method or one trial a method alone.
    """
    people, person = np.unique(table.people(), return_inverse=True)
    methods, method = np.unique(table.method, return_inverse=True)
    shape = (len(people), len(methods), len(table) // (len(people) * len(methods)))
    counts = np.bincount(person * len(methods) + method, minlength=len(people) * len(methods))
    if len(np.unique(table.task)) > 1 or table.failed or min(shape) < 2 or (counts != shape[2]).any():
        return None
    order = np.lexsort([table.trial, method, person])
    numbers = table.trial[order].reshape(shape)
    if (numbers != numbers[:, :1]).any():
        return None
    group_of = np.unique(table.group, return_inverse=True)[1]
    return table.values(metric)[order].reshape(shape), group_of[order].reshape(shape)[:, 0, 0].astype(np.int64)


def balanced_components(values: Array, groups: Ints) -> Components:
    """Restricted maximum likelihood in closed form, from the mean squares of a complete design.

    In a complete design the estimates are the solutions of observed = expected mean squares wherever none is negative
    (Searle et al. 1992, section 4.8); a negative one is set to zero, which is then an approximation.

    Parameters
    ----------
    values
        Shape (users, methods, trials), two or more of each and users in each group; trials are paired over methods.
    groups
        Group of every user, shape (users,); means of groups and methods are free.
    """
    users, methods, trials = values.shape
    counts = np.bincount(groups)
    cell_means = np.stack([values[groups == group].mean(axis=(0, 2)) for group in range(len(counts))])
    within = values - cell_means[groups][:, :, None]
    free = users - len(counts)
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
