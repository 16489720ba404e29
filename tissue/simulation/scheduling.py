"""Scheduling of a run: scheduling gaps, processor cores and kernel launches.

A scheduling gap is a time in which the system did not run the thread that runs the ticks.
"""

from collections.abc import Callable
from time import perf_counter
from typing import Any

from kernels.cores import core_count
from kernels.launcher import launch_counts
from tissue.models.tissue_model import SchedulesBackground, TissueModel

SPUN_S = 0.3
SPUN_SHARE = 0.1
"""Largest duration of a measurement of scheduling gaps, divided by the simulated time.

The clock is polled before the ticks, and again after the ticks. Each of these measurements takes at
most `SPUN_S`, and less in a short run. Both values were chosen by judgement.
"""
LEAST_GAP_S = 2e-4
"""Shortest interval between two clock readings that counts as a scheduling gap [s].

A reading takes 0.1 us.
"""


def spin(seconds: float, *, now: Callable[[], float] = perf_counter) -> tuple[float, list[float]]:
    """Read the clock repeatedly, and return the measurement time and the scheduling gaps [s].

    A gap is an interval of at least `LEAST_GAP_S` between two readings.

    Parameters
    ----------
    seconds
        Shortest measurement time [s].
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
    return last - start, gaps


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
        self._spun_s = 0.0
        self._gaps_s: list[float] = []
        self.poll()
        self._before = self._after = launch_counts()

    def end(self) -> None:
        """Record how many kernels were launched up to the end of the ticks."""
        self._after = launch_counts()

    def poll(self) -> None:
        """Poll the clock, before the ticks and after the work in the background has ended."""
        if self._spin_s > 0.0:
            spun_s, gaps_s = spin(self._spin_s)
            self._spun_s += spun_s
            self._gaps_s += gaps_s

    def summary(self, *, ticks_s: float) -> dict[str, Any]:
        """Return entries for the summary of the run.

        Parameters
        ----------
        ticks_s
            Total time during which a scheduling gap would delay a tick [s].
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
        if self._spun_s > 0.0:
            count = len(self._gaps_s)
            found["machine_gaps"] = {
                "least_us": 1e6 * LEAST_GAP_S,
                "spun_s": self._spun_s,
                "count": count,
                "longest_us": 1e6 * max(self._gaps_s, default=0.0),
                "lost_share": sum(self._gaps_s) / self._spun_s,
                "expected_in_ticks": count / self._spun_s * ticks_s,
            }
        return found
