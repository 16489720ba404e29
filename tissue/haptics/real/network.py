"""Adapter for a user's own device that is connected by UDP or by a WebSocket.

The packets are defined in `tissue.haptics.real.network_session`.
"""

import select
import socket
import threading
from collections import deque
from collections.abc import Hashable
from contextlib import suppress
from math import nan
from time import perf_counter, sleep
from typing import TYPE_CHECKING

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.extras import install_command
from tissue.haptics.real.adapter import FoundDevice, HardwareAdapter, HardwareSample, checked_url
from tissue.haptics.real.network_session import NO_WRENCH, NetworkSession
from tissue.system.stopping import returned_within

if TYPE_CHECKING:
    from websockets.sync.server import ServerConnection

    from tissue.scene.coupling import Hardware

USUAL = "udp://127.0.0.1:24930"
"""Default address on which this program listens for a device."""
MOST_READS = 256
"""Largest number of packets read per poll.

At 1 kHz, 256 packets arrive in a quarter of a second. Reading them takes about 2 ms.
"""
LONGEST_PACKET = 1024
"""Largest number of bytes read from a datagram.

A longer datagram is truncated and then rejected because of its length. A packet with a pose has 140
bytes.
"""
LOOK_S = 0.6
"""Longest time for which a search waits for a device [s].

A device sends a hello packet every 0.1 s.
"""
LONGEST_MESSAGE = 4096
"""Size of the largest accepted WebSocket message [bytes]; a message with a pose has 140 bytes."""
CLOSE_S = 0.2
"""Longest time of each of the two steps in which a connection is closed [s].

In the first step, the device receives its last packets. In the second step, it ends its connection.
A run gives up a device that is not closed after 1 s.
"""
SEND_S = 0.25
"""Longest time for sending a packet to a device before its connection is ended [s].

The value is half of `SILENCE_S`, after which the session gives up a silent device.
"""
HANDSHAKE_S = 2.0
"""Longest time for a new connection to complete the WebSocket handshake [s].

Without this limit, a program that only connects could keep its connection forever.
"""
MOST_WAITING = 2
"""Largest number of packets that wait for the sending thread.

A new wrench replaces the oldest waiting packet.

With two packets, zero force and the goodbye can wait at the same time.
"""


class UdpTransport:
    """Transport of packets as UDP datagrams, which are received when `read` is called.

    Parameters
    ----------
    host, port
        Address to listen on; port 0 for any free port.
    session
        Session that receives the packets.

    Attributes
    ----------
    port
        Port on which the program listens.

    Raises
    ------
    OSError
        If the address cannot be used.
    """

    def __init__(self, host: str, port: int, session: NetworkSession) -> None:
        self._session = session
        self._closed = False
        (family, kind, *_, place), *_ = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        self._socket = socket.socket(family, kind)
        try:
            self._socket.bind(place)
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]

    def read(self) -> None:
        """Pass all received packets to the session."""
        for _ in range(MOST_READS):
            try:
                data, sender = self._socket.recvfrom(LONGEST_PACKET)
            except BlockingIOError:
                return
            except ConnectionError:  # on Windows: an earlier packet had no receiver
                continue
            except OSError:
                # Another thread has closed the socket during the read.
                if self._closed:
                    return
                raise
            if (reply := self._session.receive(data, sender)) is not None:
                self.send(sender, reply)

    def wait(self, seconds: float) -> None:
        """Wait for a packet, for at most ``seconds``."""
        select.select([self._socket], [], [], seconds)

    def send(self, peer: Hashable, data: bytes) -> None:
        """Send a packet; drop the packet if the operating system does not accept it at once.

        A device that receives no packets reduces its force to zero.
        """
        with suppress(OSError):
            self._socket.sendto(data, peer)  # type: ignore[call-overload]

    def close(self) -> None:
        """Stop listening."""
        self._closed = True
        self._socket.close()


class WebTransport:
    """Transport of packets as WebSocket messages.

    If several wrenches wait to be sent, only the newest are sent. A connection with the header
    ``Origin``, which every browser sends, is refused, because a web page must not move a tool.

    Parameters
    ----------
    host, port
        Address to listen on; port 0 for any free port.
    session
        Session that receives the packets, called from the threads of this transport.

    Attributes
    ----------
    port
        Port on which the program listens.

    Raises
    ------
    OSError
        If the address cannot be used. `InputError` if websockets is not installed.
    """

    def __init__(self, host: str, port: int, session: NetworkSession) -> None:
        try:
            from websockets.sync.server import serve
        except ImportError:
            raise InputError(
                "websockets must be installed for a device at ws://. Run "
                f"{install_command('network')}, or use udp://"
            ) from None
        self._session = session
        self._waiting = deque[tuple[Hashable, bytes]](maxlen=MOST_WAITING)
        self._connections: dict[Hashable, ServerConnection] = {}
        self._news = threading.Event()
        self._came = threading.Event()
        self._closed = False
        self._sending_s = nan
        self._server = serve(
            self._talk,
            host,
            port,
            open_timeout=HANDSHAKE_S,
            origins=[None],
            max_size=LONGEST_MESSAGE,
            compression=None,
            ping_interval=None,
            close_timeout=CLOSE_S,
        )
        self.port: int = self._server.socket.getsockname()[1]
        self._sender = threading.Thread(target=self._send_news, daemon=True)
        self._sender.start()
        # the threads of connections inherit that they do not keep this program running
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def read(self) -> None:
        """Do nothing, because the threads pass packets to the session."""

    def wait(self, seconds: float) -> None:
        """Wait for a message, for at most ``seconds``."""
        self._came.wait(seconds)
        self._came.clear()

    def send(self, peer: Hashable, data: bytes) -> None:
        """Queue a packet for the sending thread; the packet may replace an older waiting packet."""
        self._waiting.append((peer, data))
        self._news.set()
        # a device that no longer reads blocks the sending thread
        if perf_counter() - self._sending_s > SEND_S:
            self._cut()

    def close(self) -> None:
        """Send waiting packets and stop listening."""
        self._closed = True
        self._news.set()
        self._sender.join(CLOSE_S)
        if self._sender.is_alive():
            self._cut()
        returned_within(CLOSE_S, self._server.shutdown)
        self._cut()

    def _cut(self) -> None:
        """End all connections at once, even with unsent data."""
        for connection in list(self._connections.values()):
            with suppress(OSError):
                connection.socket.shutdown(socket.SHUT_RDWR)

    def _talk(self, connection: "ServerConnection") -> None:
        """Receive the messages of one connection until it ends."""
        from websockets.exceptions import ConnectionClosed

        self._connections[connection.id] = connection
        try:
            for message in connection:
                # A text message is not a packet. It is counted as ``foreign``.
                data = message if isinstance(message, bytes) else b""
                reply = self._session.receive(data, connection.id)
                self._came.set()
                if reply is not None:
                    connection.send(reply)
        except ConnectionClosed:
            pass
        finally:
            del self._connections[connection.id]
            self._session.leave(connection.id)

    def _send_news(self) -> None:
        """Send queued packets until the transport is closed."""
        from websockets.exceptions import ConnectionClosed

        while self._waiting or not self._closed:
            self._news.wait()
            self._news.clear()
            while self._waiting:
                peer, data = self._waiting.popleft()
                connection = self._connections.get(peer)
                if connection is not None:
                    self._sending_s = perf_counter()
                    with suppress(ConnectionClosed):
                        connection.send(data)
                    self._sending_s = nan


class NetworkAdapter(HardwareAdapter):
    """Adapter of a user's device that sends its pose and receives a wrench over the network.

    Parameters
    ----------
    hardware
        Settings of the device. The setting ``address`` is the address on which this program
        listens, ``udp://HOST:PORT`` or ``ws://HOST:PORT``. If it is empty, `USUAL` is used.

    Attributes
    ----------
    session
        Session with the connected device, which also counts dropped packets.

    Raises
    ------
    InputError
        If the address is invalid.
    """

    name = "network"

    def __init__(self, hardware: "Hardware | None" = None) -> None:
        super().__init__(hardware)
        meant = "udp://HOST:PORT or ws://HOST:PORT where a device is awaited"
        parts, host, self._port = checked_url(
            self._given or USUAL, ("udp", "ws"), meant, USUAL, any_port=True
        )
        self._scheme = parts.scheme
        self._host = f"[{host}]" if ":" in host else host
        self.session = NetworkSession()
        self._transport: UdpTransport | WebTransport | None = None

    @classmethod
    def find(cls, address: str = "") -> list[FoundDevice]:
        """Return the device that sends a hello within `LOOK_S`, or the reason why there is none."""
        from tissue.scene.coupling import Hardware

        try:
            with cls(Hardware(address=address)) as adapter:
                until = perf_counter() + LOOK_S
                while adapter.session.peer is None and perf_counter() < until:
                    adapter.poll()
                    # Ten checks between two hellos of a device.
                    sleep(0.01)
                peer = adapter.session.peer
                dropped = adapter.happened()
                place = adapter.address
        except ValueError as error:  # invalid address, used port or missing package
            return cls.missing(error)
        if peer is not None:
            return [cls.found(str(peer), f"listens at {place}")]
        got = "".join(dropped) or "none"
        required = f"send packets to {place}"
        received = f"{got} in {LOOK_S:g} s"
        return cls.missing(
            str(InputError("a device", required, received, "start the program of the device"))
        )

    @property
    def address(self) -> str:
        """Address on which the program listens, with the actual port instead of 0."""
        port = self._transport.port if self._transport else self._port
        return f"{self._scheme}://{self._host}:{port}"

    @property
    def round_trip_s(self) -> float:
        """Time from sending a wrench to its first confirmation [s]; nan without a confirmation."""
        return self.session.round_trip_s

    def happened(self) -> list[str]:
        """Return one sentence with the numbers of dropped and lost packets.

        The list is empty if there are no such packets.
        """
        good = ("poses", "heartbeats", "hellos")
        found = [
            f"{count} as {what}"
            for what, count in self.session.counts.items()
            if count and what not in good
        ]
        return [f"packets that were not used: {', '.join(found)}"] if found else []

    def open(self) -> None:
        """Listen for a device."""
        kind = WebTransport if self._scheme == "ws" else UdpTransport
        try:
            self._transport = kind(self._host.strip("[]"), self._port, self.session)
        except OSError as error:
            why = (error.strerror or str(error)).lower()
            raise InputError(
                "hardware.address",
                "be free on this machine",
                f"{self.address} ({why})",
                "end the program that uses it, or use another port",
            ) from None

    def poll(self) -> HardwareSample | None:
        """Return the newest pose; None if there is no new pose since the last call."""
        if (transport := self._transport) is None:
            return None
        transport.read()
        return self.session.take()

    def wait(self, seconds: float) -> None:
        """Wait for a packet, for at most ``seconds``."""
        if self._transport is not None:
            self._transport.wait(seconds)

    def refuse(self, sentence: str) -> None:
        """Refuse the connected device with a sentence, so that another device may connect."""
        sending = self.session.refused(sentence)
        if self._transport is not None and sending is not None:
            self._transport.send(*sending)

    def push(self, force_N: Array, torque_Nm: Array) -> None:
        """Send a force and a torque, applied until the next packet but for at most 50 ms."""
        transport = self._transport
        sending = self.session.wrench((*force_N.tolist(), *torque_Nm.tolist()))
        # after a close, the packet would have an old number
        if transport is not None and sending is not None:
            transport.send(*sending)

    def close(self) -> None:
        """Send zero force and goodbye, and stop listening."""
        transport = self._transport
        self._transport = None
        if transport is None:
            return
        for sending in (self.session.wrench(NO_WRENCH), self.session.bye()):
            if sending is not None:
                transport.send(*sending)
        transport.close()
