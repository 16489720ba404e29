"""Scheduling of a run: scheduling gaps, processor cores and kernel launches.

A scheduling gap is a time in which the system did not run the thread that runs the ticks.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

from kernels.cores import core_count
from kernels.launcher import launch_counts
from tissue.models.tissue_model import SchedulesBackground, TissueModel

SPUN_S = 0.3
SPUN_SHARE = 0.1
"""Largest time for which the clock is polled, divided by the simulated time.

The clock is polled before the ticks, and again after the ticks. Each of these measurements takes at
most `SPUN_S`.

The ratio limits the additional time of a short run. Both values were chosen by judgement.
"""
LEAST_GAP_S = 2e-4
"""Shortest interval between two clock readings that counts as a scheduling gap [s].

A reading takes 0.1 us.
"""


@dataclass(frozen=True)
class MachineGaps:
    """Times in which the system did not run the thread (scheduling gaps), measured by polling.

    Attributes
    ----------
    spun_s
        Measurement time [s].
    gaps_s
        Durations of gaps of at least `LEAST_GAP_S` [s].
    """

    spun_s: float = 0.0
    gaps_s: tuple[float, ...] = ()

    def __add__(self, other: "MachineGaps") -> "MachineGaps":
        return MachineGaps(self.spun_s + other.spun_s, self.gaps_s + other.gaps_s)

    def expected(self, seconds: float) -> float:
        """Return the expected number of scheduling gaps in a given time [s]."""
        return len(self.gaps_s) / self.spun_s * seconds if self.spun_s > 0.0 else 0.0

    @property
    def lost_share(self) -> float:
        """Share of the measurement time that was lost in scheduling gaps."""
        return sum(self.gaps_s) / self.spun_s if self.spun_s > 0.0 else 0.0

    @property
    def longest_s(self) -> float:
        """Duration of the longest scheduling gap [s]; 0 if there are none."""
        return max(self.gaps_s, default=0.0)


def spin(seconds: float, *, now: Callable[[], float] = perf_counter) -> MachineGaps:
    """Read the clock repeatedly for a time [s] and return the scheduling gaps.

    Parameters
    ----------
    seconds
        Measurement time [s].
    now
        Function that returns the time [s].
    """
    gaps = []
    start = last = now()
    while last - start < seconds:
        this = now()
        if this - last >= LEAST_GAP_S:
            gaps.append(this - last)
        last = this
    return MachineGaps(last - start, tuple(gaps))


def spin_time_s(simulated_s: float) -> float:
    """Return the time for which the clock is polled before a run, and again after the run [s]."""
    return min(SPUN_S, SPUN_SHARE * simulated_s)


class Scheduling:
    """Measurement of the scheduling of one run, to be created just before the first tick.

    Parameters
    ----------
    tissue
        Tissue that is simulated.
    cores
        Processor cores available to the run; None for all.
    spin_s
        Time for which the clock is polled now, and again after the ticks have ended [s]; 0 to skip
        this measurement.
    """

    def __init__(self, tissue: TissueModel, *, cores: int | None, spin_s: float) -> None:
        self._cores = cores or core_count()
        self._spin_s = spin_s
        self._background = tissue.scheduling if isinstance(tissue, SchedulesBackground) else ""
        self.gaps = spin(spin_s) if spin_s > 0.0 else MachineGaps()
        self._before = self._after = launch_counts()

    def end(self) -> None:
        """Record how many kernels were launched up to the end of the ticks."""
        self._after = launch_counts()

    def look_again(self) -> None:
        """Poll the clock again, after the work in the background has ended."""
        if self._spin_s > 0.0:
            self.gaps += spin(self._spin_s)

    def summary(self, *, ticks_s: float) -> dict[str, Any]:
        """Return entries for the summary of the run.

        Parameters
        ----------
        ticks_s
            Time in which a scheduling gap can delay a tick [s].
        """
        before = self._before
        after = self._after
        chosen = {
            "cores": self._cores,
            "large_launches": after.large - before.large,
            "split_launches": after.split - before.split,
        }
        found: dict[str, Any] = {
            "scheduling": chosen | ({"background": self._background} if self._background else {})
        }
        if self.gaps.spun_s > 0.0:
            found["machine_gaps"] = {
                "least_us": 1e6 * LEAST_GAP_S,
                "spun_s": self.gaps.spun_s,
                "count": len(self.gaps.gaps_s),
                "longest_us": 1e6 * self.gaps.longest_s,
                "lost_share": self.gaps.lost_share,
                "expected_in_ticks": self.gaps.expected(ticks_s),
            }
        return found
