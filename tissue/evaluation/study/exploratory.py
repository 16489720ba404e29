"""Results of an older study, shown as exploratory next to the results of the registered study."""

import csv
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.plan import COMPARED
from tissue.evaluation.study.section import (
    Section,
    interval_by_users,
    methods_of,
    tasks_of,
)

__all__ = ["exploratory_section", "read_trials"]

TABLE = "trials.csv"
"""Name of the file with the trials of the compared tasks, in the folder of a study."""


def read_trials(folder: Path) -> TrialTable:
    """Read the successful trials of an older study, which any version of tissue may have written.

    Raises
    ------
    InputError
        If the folder contains no table of trials, or the table cannot be read or has no successful
        trial.
    """
    path = folder / TABLE
    try:
        with require_regular(path).open(encoding="utf-8", newline="") as file:
            table = TrialTable.from_rows(csv.DictReader(file)).complete()
    except (OSError, ValueError, TypeError, csv.Error) as error:
        raise InputError(
            f"{path} cannot be read as a table of trials ({error}). Name a folder that "
            "`tissue study run` wrote"
        ) from None
    if not len(table):
        raise InputError(f"{path} has no trial that did not fail. Name another folder")
    return table


def exploratory_section(table: TrialTable, old: TrialTable, name: str) -> Section:
    """List the metrics in `COMPARED` of a study next to those of an older study.

    No hypothesis is tested. The values are means over people with 95 % intervals.

    Parameters
    ----------
    table, old
        Trials of the registered and of the older study that did not fail.
    name
        Name of the folder of the older study.
    """
    methods = list(dict.fromkeys([*methods_of(table), *methods_of(old)]))
    tasks = list(dict.fromkeys([*tasks_of(table), *tasks_of(old)]))
    rows = []
    for task in tasks:
        for method in methods:
            parts = [each.where(task=task, method=method) for each in (table, old)]
            if not any(map(len, parts)):
                continue
            for metric in COMPARED:
                registered, exploratory = (_text(part, metric) for part in parts)
                rows.append(
                    {
                        "task": task,
                        "method": method,
                        "metric": metric,
                        "registered study": registered,
                        "exploratory, older study": exploratory,
                    }
                )
    sentences = (
        f"The older study in {name} is exploratory. Its results were known before the present plan "
        "was registered, and they decide nothing.",
        f"Means over people with 95 % intervals; {len(table)} rows of the registered study and "
        f"{len(old)} of the older one. Tasks may have changed between the two studies, so that a "
        "difference need not be an effect of the methods.",
    )
    return Section("exploratory", "Older study, exploratory", sentences, rows)


def _text(part: TrialTable, metric: str) -> str:
    """Return mean and interval of a metric as text; empty if there are no values."""
    if not len(part) or metric not in part.metrics:
        return ""
    mean, low, high = interval_by_users(part, metric)
    return f"{mean:.4g} [{low:.4g}, {high:.4g}]"
