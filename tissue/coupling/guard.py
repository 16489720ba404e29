"""What a loop believes of a device: samples that a hand could have made; without them the force fades to nothing."""

from dataclasses import dataclass
from math import dist, isfinite, sqrt

import numpy as np
from numpy.typing import NDArray

from meshes.errors import require_positive
from tissue.coupling.device import Sample
from tissue.coupling.quaternion import Quaternion, conjugate, logarithm, product, unit

__all__ = ["GuardLimits", "SampleGuard"]

Array = NDArray[np.float64]
NO_TORQUE = np.zeros(3)


@dataclass(frozen=True, kw_only=True)
class GuardLimits:
    """What counts as believable.

    Attributes
    ----------
    fastest_m_s, fastest_rad_s
        Greatest speed of a hand [m/s], [rad/s]; a sample further away than that from the last good one is refused.
    oldest_s
        Age above which a sample counts as missing [s].
    fade_s
        Time in which a force fades to zero once samples are missing, and comes back after them [s].
    """

    fastest_m_s: float = 5.0
    fastest_rad_s: float = 60.0
    oldest_s: float = 2.5e-3
    fade_s: float = 0.02

    def __post_init__(self) -> None:
        require_positive("fastest_m_s", self.fastest_m_s, "use 5")
        require_positive("fastest_rad_s", self.fastest_rad_s, "use 60")
        require_positive("oldest_s", self.oldest_s, "use two and a half ticks")
        require_positive("fade_s", self.fade_s, "use 0.02")


class SampleGuard:
    """Judges every sample and holds the force that follows from it to what can be vouched for.

    Call `believe` with what the device told, then `vouch` with the force that the loop has found for a good sample, or
    with None after a bad one. A bad sample makes the last good force fade in a straight line, to exactly zero after
    ``fade_s``; good ones bring the force back as slowly. Forces are bounded always.

    Parameters
    ----------
    limits
        What is believed.
    force_limit_N, torque_limit_Nm
        Greatest force and torque that are vouched for, in their own direction; a zero torque limit lets none pass.

    Attributes
    ----------
    share
        Share of the force that is played now, 0 to 1.
    events
        Time [s] and a sentence for every change between good and bad, and every other kind of fault.
    bad_ticks
        Samples that were not believed.
    """

    def __init__(
        self, limits: GuardLimits | None = None, *, force_limit_N: float, torque_limit_Nm: float = 0.0
    ) -> None:
        self._limits = limits or GuardLimits()
        self._caps = (require_positive("force_limit_N", force_limit_N, "give the device's"), torque_limit_Nm)
        self.share = 0.0
        self.events: list[tuple[float, str]] = []
        self.bad_ticks = 0
        self._good: Sample | None = None
        self._fault = ""
        self._wrench = (np.zeros(3), np.zeros(3))
        self._clock: float | None = None
        self._step = 0.0

    def believe(self, sample: Sample | None, time_s: float) -> Sample | None:
        """The sample if a hand can have made it, with its quaternion at unit length; else None."""
        self._step = 0.0 if self._clock is None else max(time_s - self._clock, 0.0)
        self._clock = time_s
        turned = None if sample is None else unit(sample.quaternion)
        fault = self._fault_of(sample, turned, time_s)
        if fault != self._fault:
            self.events.append((time_s, f"{fault}: the force fades" if fault else "samples are good again"))
            self._fault = fault
        if fault or sample is None or turned is None:
            self.bad_ticks += 1
            return None
        self._good = sample._replace(quaternion=turned)
        return self._good

    def vouch(self, force_N: Array | None, torque_Nm: Array | None = None) -> tuple[Array, Array]:
        """Force and torque to play now; None or a wrench that is not finite is a fault of this tick."""
        change = self._step / self._limits.fade_s
        torque = NO_TORQUE if torque_Nm is None else torque_Nm
        if force_N is not None and not all(map(isfinite, (*force_N.tolist(), *torque.tolist()))):
            self.events.append((self._clock or 0.0, "the force is not finite: it fades"))
            force_N = None
        if force_N is not None and not self._fault:
            self.share = min(self.share + change, 1.0)
            self._wrench = _capped(force_N, self._caps[0]), _capped(torque, self._caps[1])
        else:
            self.share = max(self.share - change, 0.0)
        return self.share * self._wrench[0], self.share * self._wrench[1]

    def _fault_of(self, sample: Sample | None, turned: Quaternion | None, time_s: float) -> str:
        """What is wrong with a sample, or nothing; its quaternion at unit length beside it."""
        limits, good = self._limits, self._good
        if sample is None:
            return "no sample"
        if turned is None or not sample.finite:
            return "a sample that is not finite"
        if time_s - sample.time_s > limits.oldest_s:
            return "an old sample"
        if max(map(abs, sample.velocity_m_s)) > limits.fastest_m_s:
            return "a speed that no hand has"
        if good is None:
            return "" if max(map(abs, sample.position_m)) < 10.0 else "a position that no hand reaches"
        elapsed = max(sample.time_s - good.time_s, 0.0) + limits.oldest_s
        if dist(sample.position_m, good.position_m) > limits.fastest_m_s * elapsed:
            return "a jump that no hand makes"
        turn = logarithm(product(turned, conjugate(good.quaternion)))
        if sum(angle * angle for angle in turn) > (limits.fastest_rad_s * elapsed) ** 2:
            return "a turn that no hand makes"
        return ""


def _capped(vector: Array, limit: float) -> Array:
    """A vector no longer than a limit."""
    size = sqrt(vector.dot(vector))
    return vector * (limit / size) if size > limit else np.array(vector)
