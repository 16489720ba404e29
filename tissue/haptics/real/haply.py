"""Adapter for Haply's Inverse3 with the Inverse Service.

The device plays force in three degrees of freedom. Its handle provides orientation and buttons. Not
for clinical use. Tested with a stand-in that uses the documented protocol, not with the device.
"""

from types import TracebackType
from typing import Self

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.real.adapter import FoundDevice, HardwareSample
from tissue.haptics.real.haply_link import HaplyLink
from tissue.haptics.real.haply_service import problem_of
from tissue.motion.quaternion import Triple
from tissue.scene.coupling import Hardware

__all__ = ["HaplyAdapter"]

NAME = "haply"


class HaplyAdapter:
    """Inverse3 in its own frame: x to the right, y forward, z up.

    `poll` and `push` only exchange numbers with the thread of a `HaplyLink`, so that they never
    wait. Torque is not played. However the block ends, the last force sent to the service is zero.

    Parameters
    ----------
    hardware
        Its ``address`` is the address of the service, ``ws://HOST:PORT``, with ``#DEVICE`` for one
        of several devices.
    """

    def __init__(self, hardware: Hardware | None = None) -> None:
        self._address = "" if hardware is None else hardware.address
        self._link = HaplyLink(self._address)
        self.limits: DeviceParameters = device_parameters(NAME)

    def __enter__(self) -> Self:
        self._link = HaplyLink(self._address)
        self._link.open()
        self._link.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._link.end()

    def poll(self) -> HardwareSample | None:
        """Return the newest sample; None if there is no new one since the last call.

        Raises
        ------
        DeviceError
            If the service or the device is permanently lost.
        """
        return self._link.newest()

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Send a force now, and again every millisecond while it is renewed."""
        x, y, z = force_N.tolist()
        force: Triple = (x, y, z)
        self._link.play(force)

    def close(self) -> None:
        """Send zero and disconnect from the service, which drops a force that is not sent again."""
        self._link.end()

    @property
    def releases(self) -> int:
        """Number of times that the link has removed the force by itself."""
        return self._link.releases

    def happened(self) -> tuple[str, ...]:
        """Return the events of the exchange with the service so far, as sentences."""
        return tuple(self._link.events)

    @staticmethod
    def find(address: str = "") -> list[FoundDevice]:
        """Return the devices of a service, or the reason for none."""
        try:
            link = HaplyLink(address)
            link.open()
        except InputError as error:
            return [FoundDevice(name=NAME, where=address, problem=str(error))]
        try:
            state = link.state
            found = []
            if not state.device_ids:
                return [FoundDevice(name=NAME, where=link.url, problem=problem_of(state))]
            for device_id in state.device_ids:
                state.device_id = device_id
                busy = ", used by another program" if state.status("in_use") is True else ""
                found.append(
                    FoundDevice(
                        name=NAME,
                        where=f"{link.url}#{device_id}",
                        detail=f"{state.model()}, service {link.version_text}{busy}",
                        limits=device_parameters(NAME),
                        problem=problem_of(state),
                    )
                )
            return found
        finally:
            link.end()
