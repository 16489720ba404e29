"""Scheduling gaps of this machine, measured by a thread that only reads the clock."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

__all__ = ["LEAST_GAP_S", "MachineGaps", "spin"]

LEAST_GAP_S = 2e-4
"""Shortest interval between two clock readings that counts as a gap [s]; a reading takes 0.1 us."""


@dataclass(frozen=True)
class MachineGaps:
    """Scheduling gaps measured by a spinning clock.

    Attributes
    ----------
    spun_s
        Measurement time [s].
    gaps_s
        Gaps of at least `LEAST_GAP_S` [s].
    """

    spun_s: float = 0.0
    gaps_s: tuple[float, ...] = ()

    def __add__(self, other: "MachineGaps") -> "MachineGaps":
        return MachineGaps(self.spun_s + other.spun_s, self.gaps_s + other.gaps_s)

    def expected(self, seconds: float) -> float:
        """Return the expected number of gaps in a given time [s]."""
        return len(self.gaps_s) / self.spun_s * seconds if self.spun_s > 0.0 else 0.0

    @property
    def lost_share(self) -> float:
        """Share of the measurement time lost in gaps."""
        return sum(self.gaps_s) / self.spun_s if self.spun_s > 0.0 else 0.0

    @property
    def longest_s(self) -> float:
        """Longest gap [s]; 0 without gaps."""
        return max(self.gaps_s, default=0.0)


def spin(seconds: float, *, now: Callable[[], float] = perf_counter) -> MachineGaps:
    """Read the clock repeatedly for some seconds and return the gaps.

    Parameters
    ----------
    seconds
        Measurement time [s].
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
