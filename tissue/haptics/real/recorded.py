"""A recorded motion as a device in the loop: one pose a tick, and no force."""

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
    from tissue.scene.hardware import Hardware

__all__ = ["RecordedAdapter"]


class RecordedAdapter:
    """The poses of a file, one for each call of `poll`; after the last there is none, and the force
    fades.

    A run plays them where they were recorded: its tool starts at the first pose. Unlike
    ``motion.kind = "replay"``, which moves the tool itself, the poses move the device: coupling,
    prediction and what is commanded are those of a hand that moves so.

    Parameters
    ----------
    hardware
        Its ``address`` is the file: what ``motion.file`` takes, such as a run's trace.csv.

    Raises
    ------
    InputError
        If the file is missing, or is none of poses.
    """

    bounds_itself = True
    """A file has no arm that bounds its positions."""

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
        """The file as a device, or why it is none."""
        from tissue.scene.hardware import Hardware

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
        """The pose of the next tick; None after the last."""
        if self._next >= len(self._samples):
            return None
        self._next += 1
        return self._samples[self._next - 1]

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Take a force and a torque and forget them."""

    def close(self) -> None:
        """End the record."""
        self._next = len(self._samples)


def _samples(path: Path) -> list[HardwareSample]:
    """Poses of a file at every tick, with their rates of change."""
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
