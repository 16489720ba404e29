"""Non-blocking OpenIGTLink server for several clients, each with its own send queue."""

import selectors
import socket
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from time import perf_counter
from typing import TypeVar

from meshes.base.errors import InputError
from tissue.links.igtl_messages import HEADER_BYTES, Header, IgtlError, content_of, parse_header

Result = TypeVar("Result")

LOCAL = "127.0.0.1"
LARGEST = 1 << 16
"""Size of the largest body that is read [bytes]; a larger body is skipped, see `OVERLARGE`.

A run only uses transforms and requests, which are far smaller. Images and meshes are skipped.
"""
OVERLARGE = 1 << 34
"""Body size above which a message counts as invalid [bytes].

No image has 16 GiB. Such a size means that the bytes are not a header.
"""
PIECE = 1 << 16
"""Largest number of bytes read from a client in one call, equal to the largest body size."""
STALLED_S = 10.0
"""Time after which a client that accepts no data from its send queue is disconnected [s].

A client that hangs would otherwise use one of the `MOST_CLIENTS` connections until the run ends.
"""
MOST_CLIENTS = 16
"""Largest number of clients at a time.

Each client has its own queue, so this number limits memory and sending time.
"""


@dataclass(frozen=True, kw_only=True)
class Received:
    """Received message.

    Attributes
    ----------
    client
        Sender of the message.
    header, content
        Header of the message, and content without extended header and metadata.
    """

    client: "Client"
    header: Header
    content: bytes


class Client:
    """Connection to a client, with non-blocking reads and writes.

    Attributes
    ----------
    wants
        Message types that the client has requested.
    """

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self.wants = set[str]()
        self._inbox = bytearray()
        self._outbox = deque[memoryview]()
        self._left_out = 0
        self._moved_s = perf_counter()

    @property
    def waits(self) -> bool:
        """True if the send queue is not empty."""
        return bool(self._outbox)

    def put(self, message: bytes) -> None:
        """Append a message to the send queue."""
        # the time without progress starts when the first message is queued
        if not self._outbox:
            self._moved_s = perf_counter()
        self._outbox.append(memoryview(message))

    def write(self) -> None:
        """Send the part of the queue that the connection accepts now.

        Raises
        ------
        OSError
            If the connection is closed, or the client accepted no data for `STALLED_S`.
        """
        while self._outbox:
            try:
                taken = self.connection.send(self._outbox[0])
            except BlockingIOError:
                if perf_counter() - self._moved_s > STALLED_S:
                    raise TimeoutError(f"took nothing for {STALLED_S:g} s") from None
                return
            self._moved_s = perf_counter()
            self._outbox[0] = self._outbox[0][taken:]
            if not self._outbox[0]:
                self._outbox.popleft()

    def read(self) -> list[tuple[Header, bytes]]:
        """Return header and content of all messages that have been received completely.

        Raises
        ------
        OSError
            If the connection is closed.
        IgtlError
            If the received bytes are not OpenIGTLink.
        """
        with suppress(BlockingIOError):
            came = self.connection.recv(PIECE)
            if not came:
                raise ConnectionResetError("it closed the connection")
            self._inbox += came
        found = []
        while len(self._inbox) >= HEADER_BYTES or self._left_out:
            # the rest of a body that is too large to be read
            if self._left_out:
                gone = min(self._left_out, len(self._inbox))
                del self._inbox[:gone]
                self._left_out -= gone
                if self._left_out:
                    break
                continue
            header = parse_header(self._inbox)
            if header.body_bytes > OVERLARGE:
                raise IgtlError(f"a body of {header.body_bytes} bytes")
            end = HEADER_BYTES + header.body_bytes
            if header.body_bytes > LARGEST:
                self._left_out = end
                continue
            # the rest of the message has not arrived yet
            if len(self._inbox) < end:
                break
            found.append((header, content_of(header, self._inbox[HEADER_BYTES:end])))
            del self._inbox[:end]
        return found


class IgtlServer:
    """Server that listens on a port of this machine, sends to all clients and receives messages.

    No call blocks on a client. Data that a client does not accept at once waits in the send queue
    of this client. A client is disconnected if it sends data that is not OpenIGTLink, or accepts no
    data for `STALLED_S`.

    Parameters
    ----------
    port
        Port to listen on; 0 for a free port.
    host
        Address to listen on. By default, only programs on this machine can connect.

    Attributes
    ----------
    clients
        Connected clients.
    accepted, refused
        Number of clients that were accepted, and number of clients that were refused or
        disconnected. A client is disconnected if it sends invalid messages or accepts no data.

    Raises
    ------
    InputError
        If the port is taken, or the address does not belong to this machine.
    """

    def __init__(self, port: int) -> None:
        try:
            self._listener = socket.create_server((LOCAL, port))
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", None) or "no port"
            raise InputError(
                "port",
                f"be a free port of {LOCAL}",
                f"{port} ({why})",
                "end the program that uses it, or give another port",
            ) from None
        self._listener.setblocking(False)
        self._selector = selectors.DefaultSelector()
        self._selector.register(self._listener, selectors.EVENT_READ)
        self.clients: list[Client] = []
        self.accepted = self.refused = 0

    @property
    def address(self) -> tuple[str, int]:
        """Address and port of the listener."""
        host, port = self._listener.getsockname()
        return host, port

    def poll(self, timeout_s: float) -> tuple[list[Client], list[Received]]:
        """Send queued data, and return new clients and received messages.

        The call waits for new clients or data for at most ``timeout_s``.
        """
        for client in list(self.clients):
            self._try(client, client.write)
        fresh: list[Client] = []
        received: list[Received] = []
        for key, _ in self._selector.select(timeout_s):
            client = key.data
            # the listening socket has no client
            if client is None:
                fresh += self._accept()
            # skip a client that was disconnected earlier in this call
            elif client in self.clients:
                came = self._try(client, client.read)
                received += [
                    Received(client=client, header=header, content=held)
                    for header, held in came or []
                ]
        return fresh, received

    def send(
        self, message: bytes, *, to: list[Client] | None = None, is_stream: bool = False
    ) -> int:
        """Send a message to all clients, or to the clients in `to`; return the number of receivers.

        A stream message is not sent to a client with a non-empty send queue, because a newer stream
        message will follow.
        """
        sent = 0
        for client in list(self.clients if to is None else to):
            if not (is_stream and client.waits) and client in self.clients:
                client.put(message)
                sent += 1
                self._try(client, client.write)
        return sent

    def close(self) -> None:
        """Close all connections and the port."""
        for client in list(self.clients):
            self._leave(client)
        self._selector.close()
        self._listener.close()

    def _accept(self) -> list[Client]:
        """Accept the next waiting client."""
        try:
            connection, _ = self._listener.accept()
        except OSError:  # the client has disconnected
            return []
        if len(self.clients) >= MOST_CLIENTS:
            connection.close()
            self.refused += 1
            return []
        connection.setblocking(False)
        # send each pose at once instead of collecting small messages (Nagle's algorithm)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        client = Client(connection)
        self._selector.register(connection, selectors.EVENT_READ, client)
        self.clients.append(client)
        self.accepted += 1
        return [client]

    def _try(self, client: Client, call: Callable[[], Result]) -> Result | None:
        """Call a method of a client, and disconnect the client if the method fails."""
        try:
            return call()
        except OSError as error:
            self.refused += isinstance(error, TimeoutError)
        except IgtlError:
            self.refused += 1
        self._leave(client)
        return None

    def _leave(self, client: Client) -> None:
        """Remove a client and close its connection."""
        self.clients.remove(client)
        self._selector.unregister(client.connection)
        client.connection.close()
