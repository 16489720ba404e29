"""Scheduling of a run's launches and background work, and gaps of the machine around its ticks."""

from typing import Any

from kernels.cores import core_count
from kernels.launcher import LaunchCounts, launch_counts
from tissue.models.tissue_model import SchedulesBackground, TissueModel
from tissue.system.priorities import LEAST_GAP_S, MachineGaps, spin

__all__ = ["Scheduling", "spin_time_s"]

SPUN_S, SPUN_SHARE = 0.3, 0.1
"""Time for which the clock is polled before and after the ticks [s], and its largest share.

The share is relative to the simulated time.
"""


def spin_time_s(simulated_s: float) -> float:
    """Return the time to poll the clock before and after the ticks of a run [s]."""
    return min(SPUN_S, SPUN_SHARE * simulated_s)


class Scheduling:
    """Scheduling choices of one run, made just before its ticks begin.

    Parameters
    ----------
    tissue
        Tissue that is simulated.
    cores
        Processor cores available to the run; None for all.
    spin_s
        Time to poll the clock now, and again after the ticks have ended [s]; 0 to skip this.
    """

    def __init__(self, tissue: TissueModel, *, cores: int | None, spin_s: float) -> None:
        self._cores = cores or core_count()
        self._spin_s = spin_s
        self._background = tissue.scheduling if isinstance(tissue, SchedulesBackground) else ""
        self.gaps = spin(spin_s) if spin_s > 0.0 else MachineGaps()
        self._before = self._after = launch_counts()

    def end(self) -> None:
        """Record the launch counts at the end of the ticks."""
        self._after = launch_counts()

    def look_again(self) -> None:
        """Poll the clock again, after background work has ended."""
        if self._spin_s > 0.0:
            self.gaps += spin(self._spin_s)

    @property
    def launches(self) -> LaunchCounts:
        """Number of large launches in the ticks, and of multi-threaded ones among them."""
        before = self._before
        after = self._after
        return LaunchCounts(after.large - before.large, after.split - before.split)

    def summary(self, *, ticks_s: float) -> dict[str, Any]:
        """Return entries of the run's summary.

        Parameters
        ----------
        ticks_s
            Time in which a gap of the machine can delay a tick [s].
        """
        launches = self.launches
        chosen = {
            "cores": self._cores,
            "large_launches": launches.large,
            "split_launches": launches.split,
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
