"""Detection of new samples from a device that is slower than the loop."""

from math import ceil, nan

from tissue.haptics.device.device import Device, DeviceParameters, Sample
from tissue.haptics.device.reach import reach_of
from tissue.haptics.device.sample_guard import GuardLimits, SampleGuard
from tissue.models.tissue_model import TICK_S

__all__ = ["NewSamples", "guard_of"]

ROUNDING = 1e-9
"""Tolerance for equal times [s], and for a number of ticks."""
OLDEST = 2.5
"""Age at which a sample counts as missing, relative to the time between two samples."""


class NewSamples:
    """Detector for the ticks in which a device has a new sample.

    A device with its own clock dates its samples. Other devices repeat the last pose with the time
    of the tick. A changed pose is then new, and so is a pose that has stayed for the length of a
    sample.

    Parameters
    ----------
    sample_s
        Time between two samples [s]. With a sample in every tick, each sample is new.
    """

    def __init__(self, sample_s: float) -> None:
        self._ticks = ceil(sample_s / TICK_S - ROUNDING)
        self._waited = 0
        self._last = Sample(nan, (nan, nan, nan))

    def is_new(self, sample: Sample, time_s: float) -> bool:
        """Return whether the sample of the tick at a time [s] differs from the previous one."""
        if self._ticks <= 1:
            return True
        last = self._last
        self._last = sample
        self._waited += 1
        if sample.time_s == last.time_s:
            return False
        is_dated = abs(sample.time_s - time_s) > ROUNDING
        has_changed = sample.position_m != last.position_m or sample.quaternion != last.quaternion
        if not (is_dated or has_changed or self._waited >= self._ticks):
            return False
        self._waited = 0
        return True


def guard_of(device: Device, limits: DeviceParameters, *, sample_s: float) -> SampleGuard:
    """Return the guard of a device with ``sample_s`` between two samples [s]."""
    guard = SampleGuard(
        GuardLimits(oldest_s=OLDEST * sample_s),
        force_limit_N=limits.force_limit_N,
        torque_limit_Nm=limits.torque_limit_Nm,
    )
    guard.reach = reach_of(device, limits)
    return guard
