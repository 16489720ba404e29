"""Packets of the network protocol as binary WebSocket messages, in a separate thread."""

import asyncio
import threading
from collections import deque
from collections.abc import Hashable
from contextlib import suppress
from typing import TYPE_CHECKING

from meshes.base.errors import InputError
from tissue.haptics.real.network_session import NetworkSession

if TYPE_CHECKING:
    from websockets.asyncio.server import Server, ServerConnection

__all__ = ["WebTransport"]

OPEN_S = 5.0
"""Longest time for the thread to start listening, and to end [s]."""
LONGEST_MESSAGE = 4096
CLOSE_S = 0.2
"""Longest time of each step of a close [s].

The steps: the device receives its last packets, ends its connection, and is cut off. Together
they take less than the second after which a run gives up a device that does not close.
"""
SEND_S = 0.25
"""Longest time for which a device may receive no packets before its connection is ended [s]."""
HANDSHAKE_S = 2.0
"""Longest time for a connection to become a WebSocket [s]."""
MOST_WAITING = 2
"""Largest number of packets that wait for the thread; a further wrench replaces the oldest.

Zero and goodbye can wait together.
"""


class WebTransport:
    """Packets as messages; the newest wrenches are sent, and older waiting ones are dropped.

    Connections with an ``Origin``, as sent by every browser, are refused, because a web page must
    not move a tool.

    Parameters
    ----------
    host, port
        Address to listen on; port 0 for any free port.
    session
        Receiver of the packets, called from the thread.

    Raises
    ------
    InputError
        If the address cannot be used, or websockets is not installed.
    """

    def __init__(self, host: str, port: int, session: NetworkSession) -> None:
        try:
            import websockets.asyncio.server  # noqa: F401
        except ImportError:
            raise InputError(
                "websockets",
                "be installed for a device at ws://",
                "none",
                "pip install 'tissue-sim[network]', or use udp://",
            ) from None
        self._session = session
        self._waiting = deque[tuple[Hashable, bytes]](maxlen=MOST_WAITING)
        self._connections: dict[Hashable, ServerConnection] = {}
        # also connections that are not WebSockets yet
        self._lines: dict[ServerConnection, asyncio.BaseTransport] = {}
        self._ready = threading.Event()
        self._failed = list[OSError]()
        self.address = f"ws://{host}:{port}"
        self._loop = asyncio.new_event_loop()
        self._stop = asyncio.Event()
        self._news = asyncio.Event()
        self._thread = threading.Thread(
            target=self._run, args=(host, port), daemon=True, name="network device"
        )
        self._thread.start()
        self._ready.wait(OPEN_S)
        if self._failed:
            why = (self._failed[0].strerror or str(self._failed[0])).lower()
            raise InputError(
                "hardware.address",
                "be free on this machine",
                f"{self.address} ({why})",
                "end the program that uses it, or use another port",
            )

    def read(self) -> None:
        """Do nothing: the thread passes packets to the session."""

    def send(self, peer: Hashable, data: bytes) -> None:
        """Queue a packet for the thread, in place of an older one that waits."""
        self._waiting.append((peer, data))
        with suppress(RuntimeError):  # the thread has ended
            self._loop.call_soon_threadsafe(self._news.set)

    def close(self) -> None:
        """Send waiting packets and stop listening."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._stop.set)
        if threading.current_thread() is not self._thread:
            self._thread.join(OPEN_S)

    def _run(self, host: str, port: int) -> None:
        try:
            self._loop.run_until_complete(self._serve(host, port))
        except OSError as error:
            self._failed.append(error)
        finally:
            self._ready.set()
            self._loop.close()

    async def _serve(self, host: str, port: int) -> None:
        from websockets.asyncio.server import ServerConnection, serve

        lines = self._lines

        class Line(ServerConnection):
            """Connection that is known from its first byte.

            It can therefore be ended before it is a WebSocket.
            """

            def connection_made(self, transport: asyncio.BaseTransport) -> None:
                """Store the connection."""
                super().connection_made(transport)
                lines[self] = transport

            def connection_lost(self, exc: Exception | None) -> None:
                """Remove the connection."""
                lines.pop(self, None)
                super().connection_lost(exc)

        server = await serve(
            self._talk,
            host.strip("[]"),
            port,
            create_connection=Line,
            open_timeout=HANDSHAKE_S,
            origins=[None],
            max_size=LONGEST_MESSAGE,
            compression=None,
            ping_interval=None,
            close_timeout=CLOSE_S,
        )
        self._listening(server, host)
        sending = asyncio.ensure_future(self._send_news())
        await self._stop.wait()
        sending.cancel()
        with suppress(TimeoutError):  # a device that no longer reads
            async with asyncio.timeout(CLOSE_S):
                await self._send_waiting()
        for connection, line in list(lines.items()):
            if connection not in self._connections.values():
                _abort(line)
        server.close()
        await _ended_within(CLOSE_S)
        for line in list(lines.values()):
            _abort(line)
        await _ended_within(CLOSE_S)

    def _listening(self, server: "Server", host: str) -> None:
        self.address = f"ws://{host}:{next(iter(server.sockets)).getsockname()[1]}"
        self._ready.set()

    async def _talk(self, connection: "ServerConnection") -> None:
        """Receive the messages of one connection until it ends."""
        from websockets.exceptions import ConnectionClosed

        self._connections[connection.id] = connection
        try:
            async for message in connection:
                reply = self._session.receive(
                    message if isinstance(message, bytes) else b"", connection.id
                )
                if reply is not None:
                    await connection.send(reply)
        except ConnectionClosed:
            pass
        finally:
            del self._connections[connection.id]
            self._session.leave(connection.id)

    async def _send_news(self) -> None:
        while True:
            await self._news.wait()
            self._news.clear()
            await self._send_waiting()

    async def _send_waiting(self) -> None:
        from websockets.exceptions import ConnectionClosed

        while self._waiting:
            peer, data = self._waiting.popleft()
            if (connection := self._connections.get(peer)) is not None:
                try:
                    async with asyncio.timeout(SEND_S):
                        await connection.send(data)
                except TimeoutError:  # the device no longer reads, and others must not wait
                    _abort(connection.transport)
                except ConnectionClosed:
                    pass


def _abort(line: asyncio.BaseTransport) -> None:
    """End a connection at once, even with unsent data."""
    if isinstance(line, asyncio.WriteTransport):
        line.abort()


async def _ended_within(seconds: float) -> None:
    """Wait until all other tasks of the thread have ended, for at most some seconds."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    if others:
        await asyncio.wait(others, timeout=seconds)
