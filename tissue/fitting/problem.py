"""What a kind of scene gives to a fit."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from tissue.fitting.forward import Forward
from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.posterior import Posterior

__all__ = ["Problem"]


@dataclass(frozen=True, eq=False)
class Problem:
    """Loads by constants, a log as it is compared with them, and what else could be measured.

    Attributes
    ----------
    forward
        Loads by the constants.
    measured
        The log, averaged over blocks.
    block_s
        Their length [s].
    candidates
        Logs that could be measured next, by what to do in words, given what is known now.
    notes
        What was found or assumed, in sentences.
    fixed
        Constants on which the free ones rest, by their names.
    """

    forward: Forward
    measured: MeasuredLoads
    block_s: float
    candidates: Callable[[Posterior], Sequence[tuple[str, Forward]]]
    notes: tuple[str, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
