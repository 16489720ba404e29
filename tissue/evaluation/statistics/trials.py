"""Table of a study's results, with one row for each trial and method.

The order of the rows does not depend on the order in which trials finished.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from meshes.base.whole_file import write_rows

Text = NDArray[np.str_]
KEY = ("task", "group", "user", "trial", "method")
KEYS = (*KEY, "seed", "failure")


@dataclass(frozen=True)
class Cells:
    """Means of one metric over each user's trials, one mean per combination of factor levels.

    Hypothesis tests compare these means.

    Attributes
    ----------
    metric
        Name of the metric, with its unit.
    values
        Mean over the trials of a user at a level, shape (users, levels). Here, a level is a
        combination of factor levels, one from each factor in `factors`.
    counts
        Number of trials in each mean, shape (users, levels).
    groups
        Group of every user, as an index into `group_names`, shape (users,).
    users
        Label of every user.
    factors
        Crossed factors within users: name and levels of each factor. In `values`, the last factor
        changes fastest along the axis of the levels.
    dropped
        Users that are omitted because they have no successful trial at one of the levels.
    """

    metric: str
    values: Array
    counts: Ints
    groups: Ints
    group_names: tuple[str, ...]
    users: tuple[str, ...]
    factors: tuple[tuple[str, tuple[str, ...]], ...]
    dropped: tuple[str, ...] = ()

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of levels of every factor within users."""
        return tuple(len(levels) for _, levels in self.factors)


@dataclass(frozen=True)
class TrialTable:
    """Trials of a study, sorted by task, group, user, trial and method.

    Use `from_rows`, which sorts and checks the rows. The constructor does neither.

    Attributes
    ----------
    task, group, user, method
        Labels of each row, shape (rows,). Equal user labels in two groups denote two different
        users.
    trial, seed
        Number of the trial (counted within its task, group and user), and the seed that reproduces
        the trial, shape (rows,).
    failure
        Reason why the trial of each row failed, shape (rows,). Empty for a row that did not fail.
        The metrics of a failed row are NaN.
    metrics
        Values of each metric by name, each of shape (rows,). The name of a metric includes its
        unit.
    """

    task: Text
    group: Text
    user: Text
    trial: Ints
    method: Text
    seed: Ints
    failure: Text
    metrics: Mapping[str, Array]

    @classmethod
    def from_rows(cls, rows: Iterable[Mapping[str, object]]) -> "TrialTable":
        """Return a sorted table from rows; a row is a mapping from names to labels and metrics.

        The key ``failure`` may be omitted. A row with a failure may omit metrics.

        Raises
        ------
        InputError
            If a row occurs twice, or a metric of a row that did not fail is not finite.
        """
        given = list(rows)
        names = list(dict.fromkeys(name for row in given for name in row if name not in KEYS))
        listed = sorted(given, key=_key)
        keys = [_key(row) for row in listed]
        for before, after in pairwise(keys):
            if before == after:
                raise InputError(
                    "trial",
                    "be given only once",
                    f"{_describe(after)} twice",
                    "remove one of the two",
                )
        labels: dict[str, Any] = {
            name: np.array([str(row.get(name, "")) for row in listed]) for name in KEYS
        }
        for name in ("trial", "seed"):
            labels[name] = labels[name].astype(np.int64)
        metrics = {}
        for name in names:
            values = np.array([row.get(name, np.nan) for row in listed], dtype=float)
            bad = np.flatnonzero(~np.isfinite(values) & (labels["failure"] == ""))
            if len(bad):
                found = f"{values[bad[0]]} in {_describe(keys[bad[0]])}"
                raise InputError(name, "be finite", found, "run the trial again")
            metrics[name] = values
        return cls(**labels, metrics=metrics)

    def write_csv(self, path: Path) -> None:
        """Write the table as CSV.

        Writing the same table twice gives identical files. All digits of the values are written, so
        that exactly the same values can be read back.
        """
        columns = [getattr(self, name).tolist() for name in KEYS]
        columns += [values.tolist() for values in self.metrics.values()]
        write_rows(path, [[*KEYS, *self.metrics], *zip(*columns, strict=True)])

    def __len__(self) -> int:
        return len(self.task)

    @property
    def failed(self) -> int:
        """Number of rows with a failure."""
        return int((self.failure != "").sum())

    def where(self, **chosen: str | Sequence[str]) -> "TrialTable":
        """Return the rows with the chosen labels.

        An example is ``where(task="wall", method=["penalty", "koopman"])``.
        """
        kept = np.ones(len(self), dtype=bool)
        for name, wanted in chosen.items():
            column = getattr(self, name)
            kept &= np.isin(column, [wanted] if isinstance(wanted, str) else list(wanted))
        return self._rows(kept)

    def values(self, metric: str) -> Array:
        """Return the values of a metric in all rows; NaN in failed rows."""
        if metric not in self.metrics:
            raise InputError(
                "metric", f"be one of {', '.join(self.metrics)}", metric, "choose one of those"
            )
        return self.metrics[metric]

    def people(self) -> Text:
        """Return the group and the user of every row as one label, shape (rows,)."""
        return np.char.add(np.char.add(self.group, "/"), self.user)

    def complete(self) -> "TrialTable":
        """Return the rows that did not fail."""
        return self.where(failure="")

    def shared(self) -> "TrialTable":
        """Return the rows of trials that succeeded under all methods of the table.

        All methods are then compared on the same trials.
        """
        trials = zip(self.task, self.people(), self.trial, strict=True)
        names = np.array([str(each) for each in trials])
        whole = self.failure == ""
        every, counts = np.unique(names[whole], return_counts=True)
        kept = every[counts == len(np.unique(self.method))]
        return self._rows(whole & np.isin(names, kept))

    def cells(self, metric: str, *, within: Sequence[str] = ("method",)) -> Cells:
        """Return the means of a metric over the trials of each user, for each level in `within`.

        Raises
        ------
        InputError
            If a group has fewer than two users with trials at all levels, or the metric is
            constant.
        """
        values = self.values(metric)
        kept = self.failure == ""
        factors = tuple((name, tuple(np.unique(getattr(self, name)).tolist())) for name in within)
        names, person = np.unique(self.people(), return_inverse=True)
        cell = person
        for name, levels in factors:
            cell = cell * len(levels) + np.searchsorted(levels, getattr(self, name))
        shape = (len(names), prod(len(levels) for _, levels in factors))
        counts = np.bincount(cell[kept], minlength=prod(shape)).reshape(shape)
        sums = np.bincount(cell[kept], values[kept], minlength=prod(shape)).reshape(shape)
        whole = (counts > 0).all(axis=1)
        _, first = np.unique(person, return_index=True)
        group_names, groups = np.unique(self.group[first], return_inverse=True)
        users = np.bincount(groups[whole], minlength=len(group_names))
        # One user has no variation between users.
        if users.min() < 2:
            raise InputError(
                f"group {group_names[users < 2][0]}",
                f"have at least two users with trials of {metric} at every level",
                users[users < 2][0],
                "add users or leave the group out",
            )
        if np.ptp(values[kept]) == 0.0:
            raise InputError(
                metric, "vary over the trials", f"{values[kept][0]:g} in all trials", "leave it out"
            )
        return Cells(
            metric,
            sums[whole] / counts[whole],
            counts[whole],
            groups[whole],
            tuple(group_names.tolist()),
            tuple(names[whole].tolist()),
            factors,
            tuple(names[~whole].tolist()),
        )

    def _rows(self, kept: Flags) -> "TrialTable":
        columns = {name: getattr(self, name)[kept] for name in KEYS}
        return TrialTable(
            **columns, metrics={name: values[kept] for name, values in self.metrics.items()}
        )


def _key(row: Mapping[str, object]) -> tuple[str | int, ...]:
    """Return the labels of a row by which a table is sorted."""
    labels = [str(row.get(name, "")) for name in KEY]
    return *labels[:3], int(labels[3]), labels[4]


def _describe(row: Sequence[object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in zip(KEY, row, strict=True))
