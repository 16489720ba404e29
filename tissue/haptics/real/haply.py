"""Haply's Inverse3 by its Inverse Service: three degrees of freedom with force, orientation and
buttons by the handle.

Not for clinical use. Tested against a stand-in that speaks the documented protocol, not against the
device.
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
from tissue.scene.hardware import Hardware

__all__ = ["HaplyAdapter"]

NAME = "haply"


class HaplyAdapter:
    """An Inverse3 in its own frame: x to the right, y forward, z up.

    `poll` and `push` only exchange numbers with the thread of a `HaplyLink`, so that they never
    wait. A torque is not played. Whatever ends the block, zero is the last force that the service
    is sent.

    Parameters
    ----------
    hardware
        Its ``address`` is that of the service, ``ws://HOST:PORT``, with ``#DEVICE`` for one of
        several devices.
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
        """The newest sample; None where none came since the last call.

        Raises
        ------
        DeviceError
            If the service or the device is lost for good.
        """
        return self._link.newest()

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Let a force be sent, at once and again every millisecond for as long as it is pushed
        again.
        """
        x, y, z = force_N.tolist()
        force: Triple = (x, y, z)
        self._link.play(force)

    def close(self) -> None:
        """Send zero and leave the service, which forgets a force that is not sent again."""
        self._link.end()

    @property
    def releases(self) -> int:
        """How often the exchange has taken the force off by itself."""
        return self._link.releases

    def happened(self) -> tuple[str, ...]:
        """What the exchange with the service has found so far, in sentences."""
        return tuple(self._link.events)

    @staticmethod
    def find(address: str = "") -> list[FoundDevice]:
        """The devices of a service, or why there are none."""
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
