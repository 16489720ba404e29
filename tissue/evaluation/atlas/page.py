"""What a page of the atlas is: a question, a sweep past where a method fails, a verdict, and the engine's answers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import sqrt

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = [
    "Answer", "Conduct", "Data", "Page", "Table", "Verdict", "boundary", "error_of", "log_slope", "refused",
    "shown", "sweep",
]  # fmt: skip

Table = dict[str, Array]
"""Columns of equal length by name, with the unit in the name."""
Data = dict[str, Table]
"""Tables of a sweep by name."""


class Conduct(Enum):
    """What the engine does where a method fails; the value is the page's wording."""

    HOLDS = "holds"
    FALLS_BACK = "falls back"
    REFUSES = "refuses"
    SILENT = "is silently wrong"


@dataclass(frozen=True)
class Answer:
    """What the engine did when it was asked for something, found by asking it.

    Attributes
    ----------
    asked
        What it was asked for.
    conduct
        What it did.
    result
        What it reported, or figures of what it did.
    """

    asked: str
    conduct: Conduct
    result: str


@dataclass(frozen=True)
class Verdict:
    """What a sweep showed.

    Attributes
    ----------
    fails
        Whether the method that is called into question failed in the sweep, and where theory predicts it.
    holds
        Whether the engine's own method held all along it.
    sentence
        Both in words, with the figures of the sweep.
    """

    fails: bool
    holds: bool
    sentence: str


@dataclass(frozen=True)
class Page:
    """One page of the atlas.

    Attributes
    ----------
    name
        Short name; files of the page begin with it.
    title, question
        For the reader.
    source
        Where the statement in question or the theory comes from.
    measure
        Runs the sweep; with True a coarser one, for tests.
    judge
        Verdict, from the data alone.
    ask
        Asks the engine itself.
    draw
        Draws the data into an empty figure.
    """

    name: str
    title: str
    question: str
    source: str
    measure: Callable[[bool], Data]
    judge: Callable[[Data], Verdict]
    ask: Callable[[], list[Answer]]
    draw: Callable[[Data, Figure], None]


def refused(asked: str, call: Callable[[], object]) -> Answer:
    """Make a call that should be refused; the answer is silently wrong if it is not."""
    try:
        call()
    except InputError as error:
        return Answer(asked, Conduct.REFUSES, str(error))
    return Answer(asked, Conduct.SILENT, "taken without a word")


def shown(asked: str, right: bool, result: str, *, conduct: Conduct = Conduct.HOLDS) -> Answer:
    """An answer whose figures were checked by the caller: silently wrong if they are not right."""
    return Answer(asked, conduct if right else Conduct.SILENT, result)


def sweep(name: str, values: Array, run: Callable[[float], Mapping[str, float]]) -> Table:
    """Table of a sweep: its values, and a column of each number that a run at every one of them gives."""
    rows = [run(value) for value in values.tolist()]
    return {name: values} | {column: np.array([row[column] for row in rows], dtype=float) for column in rows[0]}


def boundary(fails: Callable[[float], bool], low: float, high: float, *, steps: int) -> float:
    """Value above which runs fail, by bisection of the logarithm between two positive ones."""
    for _ in range(steps):
        middle = sqrt(low * high)
        low, high = (low, middle) if fails(middle) else (middle, high)
    return sqrt(low * high)


def log_slope(x: Array, y: Array) -> float:
    """Power of x with which y grows."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def error_of(found: Array, expected: Array) -> float:
    """Largest error of some figures relative to those expected."""
    return float(np.abs(found / expected - 1.0).max())
