"""Peers that accept a connection and then stop responding.

A finished run stays finished, without an error.
"""

import socket
import struct
import threading
import time

import pytest
from network_client import HELLO, packet, pose

from tissue import load_scene, simulate

KEY = "dGhlIHNhbXBsZSBub25jZQ=="
REQUEST = (
    "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: "
    f"Upgrade\r\nSec-WebSocket-Key: {KEY}\r\n"
    "Sec-WebSocket-Version: 13\r\n\r\n"
).encode()


def framed(data, *, opcode=2, masked=False):
    """A frame of a WebSocket by RFC 6455, masked with zeros."""
    size = len(data)
    length = (
        bytes([size | 0x80 * masked])
        if size < 126
        else struct.pack(">BH", 126 | 0x80 * masked, size)
    )
    return bytes([0x80 | opcode]) + length + bytes(4 * masked) + data


def free_port():
    with socket.socket() as line:
        line.bind(("127.0.0.1", 0))
        return line.getsockname()[1]


class Peer(threading.Thread):
    """Device that connects to a run as soon as it listens, sends some parts, and then stops.

    Its line stays open.
    """

    def __init__(self, port, parts):
        super().__init__(daemon=True)
        self.port, self.parts, self.line = port, parts, None
        self.start()

    def run(self):
        until = time.perf_counter() + 20.0
        while self.line is None and time.perf_counter() < until:
            try:
                self.line = socket.create_connection(("127.0.0.1", self.port))
            except OSError:
                time.sleep(5e-3)
        for part in self.parts:
            self.line.sendall(part)
            time.sleep(1e-3)


HANDSHAKES = {
    "nothing": [],
    "half a request": [REQUEST[:40]],
    "a request": [REQUEST],
    "a device that vanishes": [
        REQUEST,
        framed(packet(HELLO, 1), masked=True),
        *(framed(pose(2 + tick, (0.0, 0.0, 1e-5 * tick)), masked=True) for tick in range(100)),
    ],
    "half a frame": [REQUEST, framed(packet(HELLO, 1), masked=True)[:9]],
}


@pytest.mark.parametrize(
    "parts",
    [
        each
        if each in ("nothing", "a device that vanishes")
        else pytest.param(each, marks=pytest.mark.slow)
        for each in HANDSHAKES
    ],
)
def test_a_run_with_a_silent_connection_finishes(parts):
    port = free_port()
    peer = Peer(port, HANDSHAKES[parts])
    keys = {"device": "network", "hardware.address": f"ws://127.0.0.1:{port}", "duration_s": 0.25}
    run = simulate(load_scene("wall", keys))
    assert peer.line is not None and len(run.trace.rows) == 250
