"""Named figures of a run that vary with its constants, and their quantiles."""

import re

import numpy as np

from meshes.base.arrays import Array
from tissue.models.tissue_model import SLOW
from tissue.simulation.run import Run
from tissue.simulation.run_folder import Summary

__all__ = [
    "GREATEST",
    "LEVELS",
    "LOADS",
    "Figure",
    "figures_of",
    "intervals",
    "over_time",
    "table_of",
]

Figure = tuple[str, ...]
"""Name of a figure: its position in ``summary.json``, entry by entry.

For an event it is ``events``, a sentence, ``time_s``.
"""
LEVELS = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
"""Quantiles by their names in files: the ends of the 90 and 50 % bands, and the median."""
LOADS: tuple[Figure, ...] = tuple(
    (name, figure) for name in ("force_N", "torque_Nm") for figure in ("peak", "mean_in_contact")
)
"""Figures that every run has, the first columns of a table. Sobol indices refer to them."""
NUMBER = re.compile(r"-?\d+(\.\d+)?([eE][-+]?\d+)?(?![\d.]*%)")
"""Pattern of a measured number in the sentence of an event.

A percentage is not matched: it is a threshold, which distinguishes two events.
"""
PEAKS = "_K"
STRESS = "von_mises_"
GREATEST = "greatest_"
"""Prefix of fields, and of the figure's name, whose largest value is a figure.

`PEAKS` is the suffix of trace columns (temperatures) whose largest value is a figure.
"""


def figures_of(run: Run) -> dict[Figure, float]:
    """Return the figures of a run.

    The figures are loads, volumes, contact, clearances, largest temperature and stress, and events.
    An event is named by its sentence without numbers, and only its first occurrence counts. Events
    about a machine that was too slow are left out.
    """
    summary = run.summary
    trace = run.trace
    found: dict[Figure, float] = {name: summary[name[0]][name[1]] for name in LOADS}
    found |= {
        ("removed_mm3", layer): volume
        for layer, volume in summary["removed_mm3"].items()
        if summary["cuts"]
    }
    found["contact_share",] = float((trace["contact_mm2"] > 0.0).mean())
    for structure, figures in summary.get("keep_clear", {}).items():
        found |= {
            ("keep_clear", structure, name): value
            for name, value in figures.items()
            if value is not None
        }
    for name in run.parts.tissue.measure_names:
        if name.endswith(PEAKS):
            found[f"{GREATEST}{name}",] = float(trace[name].max())
    if (fields := run.parts.fields) is not None:
        for frame in fields.frames:
            for name, values in frame.cells.items():
                if name.startswith(STRESS) and np.isfinite(values).any():
                    greatest = f"{GREATEST}{name}"
                    found[greatest,] = max(found.get((greatest,), 0.0), float(np.nanmax(values)))
    for first in summary.get("break_through", ())[:1]:
        found |= {("break_through", name): value for name, value in first.items()}
    for event in summary["events"]:
        if SLOW in event["what"]:
            continue
        found.setdefault(("events", NUMBER.sub("…", event["what"]), "time_s"), event["time_s"])
    return found


def table_of(runs: list[dict[Figure, float]]) -> tuple[tuple[Figure, ...], Array]:
    """Return the names of all figures and their values in each run, shape (runs, figures).

    A value is NaN where a run does not have the figure.
    """
    names = tuple(dict.fromkeys(name for run in runs for name in run))
    return names, np.array([[run.get(name, np.nan) for name in names] for run in runs])


def intervals(names: tuple[Figure, ...], values: Array) -> Summary:
    """Return quantiles of figures, nested as in a run's summary.

    A figure that only some runs have comes with the share of these runs.

    Parameters
    ----------
    values
        Shape (runs, figures), NaN where a run has no such figure.
    """
    found: Summary = {}
    for name, column in zip(names, values.T, strict=True):
        inside = found
        for part in name[:-1]:
            inside = inside.setdefault(part, {})
        there = column[np.isfinite(column)]
        inside[name[-1]] = _by_level(there)
        if name[0] == "events":
            inside["share"] = len(there) / len(column)
        elif len(there) < len(column):
            inside[name[-1]]["share"] = len(there) / len(column)
    return found


def _by_level(values: Array) -> dict[str, float]:
    """Return quantiles of numbers by their names."""
    return dict(zip(LEVELS, np.quantile(values, tuple(LEVELS.values())).tolist(), strict=True))


REACH = 0.9
"""Smallest share of the runs that a quantile over time may be computed from.

The 5 and 95 % quantiles of fewer runs would describe only a part of them.
"""


def over_time(loads: list[Array], times_s: Array) -> tuple[Array, Summary]:
    """Compute the quantiles `LEVELS` of the loads at each tick.

    A tick counts as long as nine in ten runs reach it. The quantiles are computed from these runs.

    Parameters
    ----------
    loads
        Loads of each run, shape (ticks of the run, channels).
    times_s
        Times of the run at nominal constants, shape (n,). There are no quantiles beyond its end.

    Returns
    -------
    Quantiles, shape (5, ticks, channels), and the span over which they are valid.
    """
    lengths = np.sort([len(each) for each in loads])
    reached = len(lengths) - np.searchsorted(lengths, np.arange(len(times_s)), side="right")
    last = int((reached >= REACH * len(lengths)).sum())
    shortest = min(int(lengths[0]), last)
    levels = tuple(LEVELS.values())
    quantiles = np.empty((len(levels), last, loads[0].shape[1]))
    quantiles[:, :shortest] = np.quantile(
        np.stack([each[:shortest] for each in loads]), levels, axis=0
    )
    for tick in range(shortest, last):
        quantiles[:, tick] = np.quantile(
            [each[tick] for each in loads if len(each) > tick], levels, axis=0
        )
    step_s = times_s[0] if len(times_s) == 1 else times_s[1] - times_s[0]
    return quantiles, {
        "ticks": last,
        "ends_s": float(times_s[last - 1]) if last else 0.0,
        "run_ends_s": float(times_s[-1]),
        "shortest_sample_s": float(step_s * lengths[0]),
        "samples_at_end": int(reached[last - 1]) if last else 0,
    }
