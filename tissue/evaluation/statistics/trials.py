"""Table of a study's results, with one row for each trial and method.

The order of the rows does not depend on the order in which trials finished.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from pathlib import Path
from types import MappingProxyType

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
    """Means of one metric over the trials of each user, for each method or other level.

    Hypothesis tests compare these means.

    Attributes
    ----------
    metric
        Name of the metric, with its unit.
    values
        Mean over the trials of a user at a level, shape (users, levels). A level is a combination
        with one level of each factor in `factors`.
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

    Attributes
    ----------
    task, group, user, method
        Labels of each row, shape (rows,). Equal user labels in two groups denote two different
        users.
    trial, seed
        Number of the trial within its task, group and user, and the seed that reproduces the trial,
        shape (rows,).
    failure
        Reason of the failure of each row, shape (rows,). Empty for a row that did not fail. The
        metrics of a failed row are NaN.
    metrics
        Values of each metric by name, each of shape (rows,). The name of a metric includes its
        unit.

    Raises
    ------
    InputError
        If a row occurs twice, or a metric of a row that did not fail is not finite.
    """

    task: Text
    group: Text
    user: Text
    trial: Ints
    method: Text
    seed: Ints
    failure: Text
    metrics: Mapping[str, Array]

    def __post_init__(self) -> None:
        columns: dict[str, NDArray[np.generic]] = {
            name: np.asarray(getattr(self, name)) for name in KEYS
        }
        columns |= {name: np.asarray(values, dtype=float) for name, values in self.metrics.items()}
        for name in ("trial", "seed"):
            columns[name] = columns[name].astype(np.int64)
        order = np.lexsort([columns[name] for name in reversed(KEY)])
        for name in KEYS:
            object.__setattr__(self, name, columns[name][order])
        sorted_metrics = {name: columns[name][order] for name in self.metrics}
        object.__setattr__(self, "metrics", MappingProxyType(sorted_metrics))
        rows = list(zip(*(getattr(self, name).tolist() for name in KEY), strict=True))
        for before, after in pairwise(rows):
            if before == after:
                raise InputError(
                    "trial", "be given once", f"{_describe(after)} twice", "remove one of the two"
                )
        for name, values in sorted_metrics.items():
            bad = np.flatnonzero(~np.isfinite(values) & (self.failure == ""))
            if len(bad):
                raise InputError(
                    name,
                    "be finite",
                    f"{values[bad[0]]} in {_describe(rows[bad[0]])}",
                    "run the trial again",
                )

    @classmethod
    def from_rows(cls, rows: Iterable[Mapping[str, object]]) -> "TrialTable":
        """Return a table from rows; a row is a mapping from names to labels and metrics.

        The key ``failure`` may be omitted. A row with a failure may omit metrics.
        """
        listed = list(rows)
        names = list(dict.fromkeys(name for row in listed for name in row if name not in KEYS))
        labels = {name: np.array([str(row.get(name, "")) for row in listed]) for name in KEYS}
        return cls(
            **labels,  # whole numbers are read from their text
            metrics={
                name: np.array([row.get(name, np.nan) for row in listed], dtype=float)
                for name in names
            },
        )

    def write_csv(self, path: Path) -> None:
        """Write the table as CSV.

        Equal tables give files with equal bytes. All digits of the values are written, so that
        exactly the same values can be read back.
        """
        columns = [getattr(self, name).tolist() for name in KEYS]
        columns += [values.tolist() for values in self.metrics.values()]
        write_rows(path, [[*KEYS, *self.metrics], *zip(*columns, strict=True)])

    def __len__(self) -> int:
        return len(self.task)

    @cached_property
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
        """Return the values of a metric in all rows, NaN in failed rows."""
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
        return self._rows(self.failure == "")

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
        labels = list(product(*(levels for _, levels in factors)))
        names, person = np.unique(self.people(), return_inverse=True)
        level = np.zeros(len(self), dtype=np.int64)
        for name, levels in factors:
            level = level * len(levels) + np.searchsorted(levels, getattr(self, name))
        at = (person[kept], level[kept])
        counts = np.zeros((len(names), len(labels)), dtype=np.int64)
        sums = np.zeros(counts.shape)
        np.add.at(counts, at, 1)
        np.add.at(sums, at, values[kept])
        whole = (counts > 0).all(axis=1)
        group_names = tuple(np.unique(self.group).tolist())
        _, first = np.unique(person, return_index=True)
        groups = np.searchsorted(group_names, self.group[first]).astype(np.int64)
        for index, group in enumerate(group_names):
            count = int((whole & (groups == index)).sum())
            # one user has no variation between users
            if count < 2:
                raise InputError(
                    f"group {group}",
                    f"have at least two users with trials of {metric} at every level",
                    count,
                    "add users or leave the group out",
                )
        means = sums[whole] / counts[whole]
        if np.ptp(values[kept]) == 0.0:
            raise InputError(
                metric, "vary over the trials", f"{values[kept][0]:g} in all trials", "leave it out"
            )
        return Cells(
            metric,
            means,
            counts[whole],
            groups[whole],
            group_names,
            tuple(names[whole].tolist()),
            factors,
            tuple(names[~whole].tolist()),
        )

    def _rows(self, kept: Flags) -> "TrialTable":
        columns = {name: getattr(self, name)[kept] for name in KEYS}
        return TrialTable(
            **columns, metrics={name: values[kept] for name, values in self.metrics.items()}
        )


def _describe(row: Sequence[object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in zip(KEY, row, strict=True))
