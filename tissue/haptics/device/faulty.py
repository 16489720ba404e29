"""Scheduled faults of a device, to test the robustness of loops."""

from collections import deque
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from math import nan
from types import TracebackType
from typing import Literal, Self

from meshes.base.arrays import Array
from tissue.haptics.device.device import Device, Sample

__all__ = ["Fault", "FaultKind", "FaultyDevice"]

FaultKind = Literal["dropped", "late", "duplicated", "non-finite", "wild"]
WILD_M = 1e9
LATE_READS = 5
"""Delay of a late sample [reads]."""


@dataclass(frozen=True)
class Fault:
    """Fault of the samples between two times [s]."""

    kind: FaultKind
    start_s: float
    end_s: float


class FaultyDevice:
    """Device with faulty samples at given times.

    Samples are dropped, late, repeated, non-finite or wild (1e9 m).
    """

    def __init__(self, device: Device, faults: Sequence[Fault]) -> None:
        self._device = device
        self._faults = tuple(faults)
        self._past: deque[Sample | None] = deque(maxlen=LATE_READS + 1)
        self._returned: Sample | None = None

    @property
    def in_process(self) -> bool:
        """True if the device only computes."""
        return bool(getattr(self._device, "in_process", False))

    def __enter__(self) -> Self:
        if isinstance(self._device, AbstractContextManager):
            self._device.__enter__()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if isinstance(self._device, AbstractContextManager):
            self._device.__exit__(kind, error, trace)

    def read(self, time_s: float) -> Sample | None:
        """Return a sample, modified by the fault at this time."""
        sample = self._device.read(time_s)
        self._past.append(sample)
        kind = next(
            (fault.kind for fault in self._faults if fault.start_s <= time_s < fault.end_s), None
        )
        if kind == "dropped":
            return None
        if kind == "duplicated":
            return self._returned
        if kind == "late":
            return self._past[0]
        if sample is not None and kind is not None:
            wrong = nan if kind == "non-finite" else WILD_M
            sample = sample._replace(position_m=(wrong, *sample.position_m[1:]))
        self._returned = sample
        return sample

    def command(self, force_N: Array, torque_Nm: Array) -> None:
        """Pass the command to the device."""
        self._device.command(force_N, torque_Nm)
