"""Adapter for a user's device over UDP or a WebSocket.

The packets are defined in `tissue.haptics.real.network_protocol`.
"""

import socket
from collections.abc import Hashable
from contextlib import suppress
from time import perf_counter, sleep
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self
from urllib.parse import urlsplit

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.real.adapter import FoundDevice, HardwareSample
from tissue.haptics.real.network_protocol import NO_WRENCH
from tissue.haptics.real.network_session import NetworkSession

if TYPE_CHECKING:
    from tissue.scene.coupling import Hardware

__all__ = ["USUAL", "NetworkAdapter", "Transport", "UdpTransport"]

USUAL = "udp://127.0.0.1:24930"
"""Default address at which a device is awaited."""
MOST_READS = 256
"""Largest number of packets per poll: a quarter of a second of a device, in about 2 ms."""
LONGEST_PACKET = 1024
LOOK_S = 0.6
"""Longest time for which a search waits for a device [s]; a device asks ten times a second."""


class Transport(Protocol):
    """Transport of packets: opened at once, read and written without waiting."""

    address: str
    """Address of the listener."""

    def read(self) -> None:
        """Pass all received packets to the session."""

    def send(self, peer: Hashable, data: bytes) -> None:
        """Send a packet to the device; a packet that cannot be sent is dropped."""

    def close(self) -> None:
        """Stop listening."""


class UdpTransport:
    """Packets as datagrams, read when they are polled.

    Parameters
    ----------
    host, port
        Address to listen on; port 0 for any free port.
    session
        Receiver of the packets.

    Raises
    ------
    InputError
        If the address cannot be used.
    """

    def __init__(self, host: str, port: int, session: NetworkSession) -> None:
        self._session = session
        self._closed = False
        try:
            (family, kind, *_, place), *_ = socket.getaddrinfo(
                host.strip("[]"), port, type=socket.SOCK_DGRAM
            )
            self._socket = socket.socket(family, kind)
        except OSError as error:
            raise _cannot_listen(f"udp://{host}:{port}", error) from None
        try:
            self._socket.bind(place)
        except OSError as error:
            self._socket.close()
            raise _cannot_listen(f"udp://{host}:{port}", error) from None
        self._socket.setblocking(False)
        self.address = f"udp://{host}:{self._socket.getsockname()[1]}"

    def read(self) -> None:
        """Pass all received packets to the session."""
        for _ in range(MOST_READS):
            try:
                data, sender = self._socket.recvfrom(LONGEST_PACKET)
            except BlockingIOError:
                return
            except ConnectionError:  # Windows reports that an earlier packet had no receiver
                continue
            except OSError:
                if self._closed:
                    return
                raise
            if (reply := self._session.receive(data, sender)) is not None:
                self.send(sender, reply)

    def send(self, peer: Hashable, data: bytes) -> None:
        """Send a packet, and drop it if the system does not accept it at once.

        Without packets, the device fades to zero force.
        """
        with suppress(OSError):
            self._socket.sendto(data, peer)  # type: ignore[call-overload]

    def close(self) -> None:
        """Stop listening."""
        self._closed = True
        self._socket.close()


class NetworkAdapter:
    """User's device that sends its pose and receives a wrench.

    Parameters
    ----------
    hardware
        Its ``address`` is ``udp://HOST:PORT`` or ``ws://HOST:PORT``, on which this program listens;
        empty for `USUAL`.

    Attributes
    ----------
    session
        Connected device, and number of dropped packets by reason.

    Raises
    ------
    InputError
        If the address is invalid.
    """

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        self._scheme, self._host, self._port = _parsed(
            (hardware.address if hardware else "") or USUAL
        )
        self.limits: DeviceParameters = device_parameters("network")
        self.session = NetworkSession()
        self._transport: Transport | None = None

    @staticmethod
    def find(address: str = "") -> list[FoundDevice]:
        """Return the device that asks to be used within `LOOK_S`, or the reason for none."""
        from tissue.scene.coupling import Hardware

        try:
            with NetworkAdapter(Hardware(address=address)) as adapter:
                until = perf_counter() + LOOK_S
                while adapter.session.peer is None and perf_counter() < until:
                    adapter.poll()
                    sleep(0.01)
                peer = adapter.session.peer
                dropped = adapter.happened()
                place = adapter.address
        except ValueError as error:  # invalid address, used port or missing package
            return [FoundDevice(name="network", problem=str(error))]
        if peer is not None:
            detail = f"listens at {place}"
            limits = device_parameters("network")
            return [FoundDevice(name="network", where=str(peer), detail=detail, limits=limits)]
        got = "".join(dropped) or "none"
        problem = (
            f"a device must send packets to {place}, got {got} in {LOOK_S:g} s: start its program"
        )
        return [FoundDevice(name="network", problem=problem)]

    @property
    def address(self) -> str:
        """Address of the listener, with the port that replaced 0."""
        return (
            self._transport.address
            if self._transport
            else f"{self._scheme}://{self._host}:{self._port}"
        )

    @property
    def round_trip_s(self) -> float:
        """Time from a wrench to the first packet of the device that has seen it [s]; nan before."""
        return self.session.round_trip_s

    def happened(self) -> list[str]:
        """Return the dropped and lost packets so far, in one sentence or none."""
        good = ("poses", "heartbeats", "hellos")
        found = [
            f"{count} as {what}"
            for what, count in self.session.counts.items()
            if count and what not in good
        ]
        return [f"packets that were not used: {', '.join(found)}"] if found else []

    def __enter__(self) -> Self:
        if self._scheme == "ws":
            from tissue.haptics.real.network_web import WebTransport

            self._transport = WebTransport(self._host, self._port, self.session)
        else:
            self._transport = UdpTransport(self._host, self._port, self.session)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def poll(self) -> HardwareSample | None:
        """Return the newest pose; None if there is no new one since the last call."""
        if (transport := self._transport) is None:
            return None
        transport.read()
        return self.session.take()

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Send a force and a torque; the device plays them until the next packet, or for 50 ms."""
        (fx, fy, fz) = force_N.tolist()
        (tx, ty, tz) = torque_Nm.tolist()
        transport = self._transport
        sending = self.session.wrench(((fx, fy, fz), (tx, ty, tz)))
        # after a close, the number of the packet would be old
        if transport is not None and sending is not None:
            transport.send(*sending)

    def close(self) -> None:
        """Send zero and goodbye, and stop listening."""
        transport = self._transport
        self._transport = None
        if transport is None:
            return
        for sending in (self.session.wrench(NO_WRENCH), self.session.bye()):
            if sending is not None:
                transport.send(*sending)
        transport.close()


def _parsed(address: str) -> tuple[str, str, int]:
    """Return scheme, host and port of an address."""
    try:
        parts = urlsplit(address)
        host = parts.hostname
        port = parts.port
    except ValueError:
        parts = None
        host = None
        port = None
    if (
        parts is None
        or parts.scheme not in ("udp", "ws")
        or not host
        or port is None
        or parts.path.strip("/")
    ):
        raise InputError(
            "hardware.address",
            "be udp://HOST:PORT or ws://HOST:PORT where a device is awaited",
            address,
            f"use {USUAL}",
        )
    return parts.scheme, f"[{host}]" if ":" in host else host, port


def _cannot_listen(address: str, error: OSError) -> InputError:
    """Return the error of an address that cannot be listened on."""
    why = (error.strerror or str(error)).lower()
    return InputError(
        "hardware.address",
        "be free on this machine",
        f"{address} ({why})",
        "end the program that uses it, or use another port",
    )
