"""How late the machine itself is: gaps in what a thread that only looks at the clock sees."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

__all__ = ["LEAST_GAP_S", "MachineGaps", "spin"]

LEAST_GAP_S = 2e-4
"""Time between two looks at the clock from which the machine did something else [s]; a look
takes 0.1 us.
"""


@dataclass(frozen=True)
class MachineGaps:
    """Gaps of a spinning clock.

    Attributes
    ----------
    spun_s
        How long the clock was looked at [s].
    gaps_s
        The gaps of at least `LEAST_GAP_S` [s].
    """

    spun_s: float = 0.0
    gaps_s: tuple[float, ...] = ()

    def __add__(self, other: "MachineGaps") -> "MachineGaps":
        return MachineGaps(self.spun_s + other.spun_s, self.gaps_s + other.gaps_s)

    def expected(self, seconds: float) -> float:
        """Gaps that as many seconds of work would meet."""
        return len(self.gaps_s) / self.spun_s * seconds if self.spun_s > 0.0 else 0.0

    @property
    def lost_share(self) -> float:
        """Share of the time that the gaps took."""
        return sum(self.gaps_s) / self.spun_s if self.spun_s > 0.0 else 0.0

    @property
    def longest_s(self) -> float:
        """The longest gap [s], 0 without any."""
        return max(self.gaps_s, default=0.0)


def spin(seconds: float, *, now: Callable[[], float] = perf_counter) -> MachineGaps:
    """Look at the clock for some seconds.

    Parameters
    ----------
    seconds
        How long [s].
    now
        Clock [s].
    """
    gaps = []
    start = last = now()
    while last - start < seconds:
        this = now()
        if this - last >= LEAST_GAP_S:
            gaps.append(this - last)
        last = this
    return MachineGaps(last - start, tuple(gaps))
