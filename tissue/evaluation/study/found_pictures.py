"""Pictures at the head of a report: large letters, and a mark of its own for every method beside its colour."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from tissue.evaluation.statistics.trials import TrialTable
from tissue.evaluation.study.needle import PAPERS, median_interval, noticed_percent, travel_by_people
from tissue.evaluation.study.paper import FORCE_ERROR
from tissue.evaluation.study.section import (
    COLOURS,
    drawing,
    image,
    interval_by_users,
    methods_of,
    tasks_of,
)
from tissue.evaluation.study.tasks import METHODS

__all__ = ["force_dots", "index_dots", "overshoot_dots", "sensitivity_dots"]

MARKS = dict(zip(METHODS, "osDPv^", strict=False))
"""Mark of each method, so that none needs its colour."""
LETTERS = 15
"""Size of letters [pt]; at half the picture's size they are read as 7.5."""
WIDTH, LINE = 10.0, 0.5
"""Width of a picture and height of its lines [inches]."""


def force_dots(table: TrialTable) -> bytes:
    """Force error by method, a panel a task, with 95 % intervals over people, least error and the paper's figures."""
    tasks, methods = tasks_of(table), methods_of(table)
    figure, panels = drawing(WIDTH, LINE * len(methods) + 1.9, len(tasks))
    for axes, task in zip(panels, tasks, strict=True):
        part = table.where(task=task)
        for line, method in enumerate(methods):
            if method not in part.method:
                continue
            _dot(axes, line, method, [100.0 * each for each in interval_by_users(part, "force_error", method)])
            if "least_error" in part.metrics:
                least = 100.0 * float(part.where(method=method).values("least_error").mean())
                axes.plot([least, least], [line - 0.35, line + 0.35], color="black", lw=3)
            if paper := FORCE_ERROR.get(task, {}).get(method):
                axes.plot(paper.mean, line + 0.3, "x", color="black", ms=9, mew=2)
        _methods_axis(axes, methods, named=axes is panels[0])
        axes.set_xlim(left=0.0)
        axes.set_title(task, fontsize=LETTERS)
    figure.supxlabel("force error at the motor / %   | least error   × paper", fontsize=LETTERS)
    return image(figure)


def sensitivity_dots(sensitivity: Mapping[tuple[str, str], Sequence[float]]) -> bytes:
    """Sensitivity d' by pair and method: the mean over groups, and a line that spans the groups."""
    pairs = list(dict.fromkeys(pair for pair, _ in sensitivity))
    methods = [each for each in METHODS if any(method == each for _, method in sensitivity)]
    figure, (axes,) = drawing(WIDTH, (0.22 * len(methods) + 0.25) * len(pairs) + 2.2)
    for at, pair in enumerate(pairs):
        for shift, method in enumerate(methods):
            if (values := sensitivity.get((pair, method))) is not None:
                line = at + 0.8 * ((shift + 0.5) / len(methods) - 0.5)
                label = method if at == 0 else None
                _dot(axes, line, method, (float(np.mean(values)), min(values), max(values)), label=label)
        if at:
            axes.axhline(at - 0.5, color="#CCCCCC", lw=1)
    axes.set_yticks(range(len(pairs)), [pair.replace(": ", ":\n").replace(" or ", " or\n") for pair in pairs])
    axes.set_ylim(len(pairs) - 0.5, -0.5)
    axes.axvline(0.0, color="black", lw=0.8)
    axes.spines["left"].set_visible(False)
    axes.tick_params(labelsize=LETTERS)
    axes.set_xlabel("discrimination at the skin, d′ (0: by guessing)", fontsize=LETTERS)
    figure.legend(loc="outside upper center", ncols=3, frameon=False, fontsize=LETTERS - 1, columnspacing=1.0)
    return image(figure)


def overshoot_dots(needle: TrialTable) -> bytes:
    """Travel after a puncture by method, the median over people with its 95 % interval, and the paper's figures.

    An interval that reaches to people who do not notice the puncture ends at an arrow; how many trials are noticed
    stands beside it.
    """
    shared = needle.shared()
    methods = methods_of(shared)
    figure, (axes,) = drawing(WIDTH, LINE * len(methods) + 1.4)
    found = {method: median_interval(travel_by_people(shared, method)) for method in methods}
    longest = 1.15 * max((each for values in found.values() for each in values if np.isfinite(each)), default=1.0)
    for line, method in enumerate(methods):
        middle, low, high = found[method]
        _dot(axes, line, method, (min(middle, longest), max(low, 0.0), min(high, longest)))
        if high > longest:
            axes.plot(longest, line, ">", color=COLOURS[method], ms=10)
        share = f"{noticed_percent(shared, method):.0f} %"
        axes.text(1.04 * longest, line, share, va="center", fontsize=LETTERS, backgroundcolor="white")
        if paper := PAPERS.get(method):
            axes.errorbar(paper.mean, line + 0.28, xerr=paper.spread, fmt="x", color="black", ms=9, mew=2, lw=1.5)
    _methods_axis(axes, methods, named=True)
    axes.set_xlim(0.0, 1.14 * longest)
    axes.set_title("noticed", loc="right", fontsize=LETTERS)
    axes.set_xlabel("travel after the puncture / mm   × paper ± sd", fontsize=LETTERS)
    return image(figure)


def index_dots(means: Mapping[str, tuple[float, float, float]]) -> bytes:
    """Composite index by method with its intervals."""
    methods = [each for each in METHODS if each in means]
    figure, (axes,) = drawing(WIDTH, LINE * len(methods) + 1.4)
    for line, method in enumerate(methods):
        _dot(axes, line, method, means[method])
    axes.axvline(0.0, color="black", lw=0.8)
    _methods_axis(axes, methods, named=True)
    axes.set_xlabel("composite index / standard deviations (more is better)", fontsize=LETTERS)
    return image(figure)


def _dot(axes: Axes, line: float, method: str, held: Sequence[float], *, label: str | None = None) -> None:
    """A mean with its interval: value, low, high."""
    value, low, high = held
    axes.plot([low, high], [line, line], color=COLOURS[method], lw=3, zorder=2)
    axes.plot(value, line, MARKS[method], color=COLOURS[method], ms=10, mec="black", mew=0.8, label=label, zorder=3)


def _methods_axis(axes: Axes, methods: Sequence[str], *, named: bool) -> None:
    """One line a method, from the top, with its name or without."""
    axes.set_yticks(range(len(methods)), methods if named else [""] * len(methods))
    axes.set_ylim(len(methods) - 0.4, -0.6)
    axes.grid(axis="y", color="#DDDDDD", lw=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=LETTERS)
