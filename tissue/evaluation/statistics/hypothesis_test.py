"""The result of a test: its figure, what it rests on, and the alternatives where that fails."""

from dataclasses import dataclass

import numpy as np

from meshes.base.errors import InputError

__all__ = ["ALPHA", "LEVEL", "Assumption", "Effect", "HypothesisTest", "format_p", "require_statsmodels"]

ALPHA = 0.05
"""Share of false alarms that a test allows itself."""
LEVEL = 0.95
"""Coverage of an interval."""


@dataclass(frozen=True)
class Assumption:
    """Something a test rests on, checked on the same data.

    Attributes
    ----------
    name
        What is assumed, such as "normal residuals".
    holds
        Whether the check did not refuse it at :data:`ALPHA`. A check that is passed proves nothing in a small sample.
    finding
        The check with its figures.
    """

    name: str
    holds: bool
    finding: str


@dataclass(frozen=True)
class Effect:
    """The size of an effect with its interval, of coverage :data:`LEVEL`."""

    name: str
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.name} {self.value:.3g} [{self.low:.3g}, {self.high:.3g}]"


@dataclass(frozen=True)
class HypothesisTest:
    """The result of one test.

    Attributes
    ----------
    test
        Name of the test.
    question
        What was asked, such as "force_error: method".
    statistic_name, statistic, degrees
        The figure the test computes, such as F, and its degrees of freedom.
    p
        Chance of a figure as large where there is no effect.
    effect
        Size of the effect, if the test has one.
    assumptions
        What it rests on.
    alternatives
        Tests of the same question that rest on less.
    note
        What a reader must know as well; empty if nothing.
    """

    test: str
    question: str
    statistic_name: str
    statistic: float
    degrees: tuple[float, ...]
    p: float
    effect: Effect | None = None
    assumptions: tuple[Assumption, ...] = ()
    alternatives: tuple["HypothesisTest", ...] = ()
    note: str = ""

    @property
    def sound(self) -> bool:
        """Whether no check refused an assumption."""
        return all(each.holds for each in self.assumptions)

    @property
    def found(self) -> bool:
        """Whether the test rejects at :data:`ALPHA`."""
        return self.p < ALPHA

    @property
    def figures(self) -> str:
        """The statistic with its degrees of freedom and p."""
        degrees = f"({', '.join(f'{each:.4g}' for each in self.degrees)})" if self.degrees else ""
        return f"{self.statistic_name}{degrees} = {self.statistic:.4g}, {format_p(self.p)}"


def format_p(p: float) -> str:
    """A p value as a reader expects it."""
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.4f}" if np.isfinite(p) else "p unknown"


def require_statsmodels() -> None:
    """Refuse to go on where the extra that holds statsmodels is not installed."""
    try:
        import statsmodels  # noqa: F401
    except ImportError:
        raise InputError(
            "statistics of a study must have statsmodels installed, got none: pip install 'tissue-sim[study]'"
        ) from None
