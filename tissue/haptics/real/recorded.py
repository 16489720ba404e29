"""Recorded motion as a device in the loop: one pose per tick, without force."""

from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, names_of_caller
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.real.adapter import FoundDevice, HardwareSample
from tissue.models.tissue_model import TICK_S
from tissue.motion.replay import read_replay

if TYPE_CHECKING:
    from tissue.scene.coupling import Hardware

__all__ = ["RecordedAdapter"]


class RecordedAdapter:
    """Poses of a file, one for each call of `poll`; after the last one, the force fades.

    A run plays the poses at their recorded positions: its tool starts at the first pose. Unlike
    ``motion.kind = "replay"``, which moves the tool itself, the poses move the device. Coupling,
    prediction and commanded force are those for a hand with this motion.

    Parameters
    ----------
    hardware
        Its ``address`` is a file as for ``motion.file``, such as a run's trace.csv.

    Raises
    ------
    InputError
        If the file is missing, or does not contain poses.
    """

    bounds_itself = True
    """No reach is applied, because a file has no arm that bounds its positions."""

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        address = hardware.address if hardware else ""
        if not address:
            raise InputError(
                "hardware.address",
                "be a file of poses with device = recorded",
                "nothing",
                "use a run's trace.csv",
            )
        self.limits: DeviceParameters = device_parameters("recorded")
        self._samples = _samples(Path(address))
        self._next = 0

    @staticmethod
    def find(address: str = "") -> list[FoundDevice]:
        """Return the file as a device, or the reason for none."""
        from tissue.scene.coupling import Hardware

        try:
            adapter = RecordedAdapter(Hardware(address=address))
        except InputError as error:
            return [FoundDevice(name="recorded", problem=str(error))]
        lasts = TICK_S * (len(adapter._samples) - 1)
        return [
            FoundDevice(
                name="recorded",
                where=address,
                detail=f"{lasts:g} s of poses",
                limits=adapter.limits,
            )
        ]

    def __enter__(self) -> Self:
        self._next = 0
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def poll(self) -> HardwareSample | None:
        """Return the pose of the next tick; None after the last one."""
        if self._next >= len(self._samples):
            return None
        self._next += 1
        return self._samples[self._next - 1]

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Ignore a force and a torque."""

    def close(self) -> None:
        """End the recording."""
        self._next = len(self._samples)


def _samples(path: Path) -> list[HardwareSample]:
    """Return the poses of a file at every tick, with their rates of change."""
    from scipy.spatial.transform import Rotation

    with names_of_caller({"motion.file": "hardware.address"}):
        motion = read_replay(path, step_s=TICK_S)
    tips = motion.sweep_m()
    turns = Rotation.from_matrix(motion.rotations()).as_quat()
    times = TICK_S * np.arange(len(tips), dtype=np.float64)
    played = RecordedDevice(times, tips, turns, rate_Hz=1.0 / TICK_S)
    samples = [played.read(time_s) for time_s in times.tolist()]
    return [
        HardwareSample(each.position_m, each.velocity_m_s, each.quaternion, each.spin_rad_s)
        for each in samples
        if each is not None
    ]
