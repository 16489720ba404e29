"""What a page of the atlas is: a question, a sweep past where a method fails, a verdict, and the engine's answers."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Answer", "Conduct", "Data", "Page", "Verdict", "refused", "shown"]

Array = NDArray[np.float64]
Data = dict[str, dict[str, Array]]
"""Tables of a sweep by name; a table is columns of equal length by name, with the unit in the name."""


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
    draw: "Callable[[Data, Figure], None]"


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
