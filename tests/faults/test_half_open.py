"""Peers that accept a connection and then stop responding.

A finished run stays finished, without an error.
"""

import base64
import hashlib
import json
import re
import socket
import struct
import threading
import time
from contextlib import suppress

import numpy as np
import pytest
from network_client import HELLO, WRENCH, packet, pose, read

from meshes.base.errors import InputError
from tissue import load_scene, simulate
from tissue.haptics.real.haply import HaplyAdapter
from tissue.haptics.real.network import NetworkAdapter
from tissue.scene.coupling import Hardware

CLOSES_S = 0.9
"""A run gives a device up that takes longer than a second to close."""
KEY = "dGhlIHNhbXBsZSBub25jZQ=="
REQUEST = (
    "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: "
    f"Upgrade\r\nSec-WebSocket-Key: {KEY}\r\n"
    "Sec-WebSocket-Version: 13\r\n\r\n"
).encode()
STATE = {
    "cursor_position": {"x": 0.0, "y": -0.1, "z": 0.1},
    "cursor_velocity": {"x": 0.0, "y": 0.0, "z": 0.0},
}
DEVICE = {
    "device_id": "0A",
    "state": STATE,
    "status": {"calibrated": True, "power_supply": True, "ready": True},
}


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


def test_a_device_takes_the_place_of_one_that_reads_no_more():
    """A device replaces one that reads no more and gets its wrenches at once.

    The first one's buffers are full, so that a packet for it waits.
    """
    with NetworkAdapter(Hardware(address="ws://127.0.0.1:0")) as adapter:
        port = int(adapter.address.rpartition(":")[2])
        first = Peer(port, [REQUEST, framed(packet(HELLO, 1), masked=True)])
        until = time.perf_counter() + 10.0
        while adapter.session.peer is None and time.perf_counter() < until:
            adapter.poll()
            time.sleep(1e-3)
        dead, transport = adapter.session.peer, adapter._transport
        line = transport._connections[dead].transport
        transport._loop.call_soon_threadsafe(lambda: line.write(bytes(20_000_000)))
        while adapter.session.peer == dead and time.perf_counter() < until:
            adapter.push(np.ones(3), np.zeros(3))
            adapter.poll()
            time.sleep(1e-3)
        second = Peer(port, [REQUEST, framed(packet(HELLO, 1), masked=True)])
        heard = b""
        while time.perf_counter() < until and packet_of_kind(heard, WRENCH) is None:
            adapter.poll()
            adapter.push(np.ones(3), np.zeros(3))
            if second.line is not None:
                second.line.settimeout(0.01)
                with suppress(TimeoutError):
                    heard += second.line.recv(4096)
        assert packet_of_kind(heard, WRENCH) is not None and first.line is not None


def packet_of_kind(heard, kind):
    """Return the first packet of a kind from the bytes of a line.

    The bytes begin with the answer to the handshake.
    """
    for match in re.finditer(rb"TDEV", heard):
        data = heard[match.start() :]
        size = 28 + struct.unpack_from("<H", data, 6)[0] if len(data) > 8 else len(data) + 1
        if len(data) >= size and read(data[:size])[0] == kind:
            return data[:size]
    return None


class Service(threading.Thread):
    """Haply's service in raw sockets, which stops answering, or reading, where a test asks for it.

    Parameters
    ----------
    mute
        From where on there is no answer: "connect", "handshake", "version" or "".
    """

    def __init__(self, mute=""):
        super().__init__(daemon=True)
        self.mute, self.silent, self.taken = mute, threading.Event(), 0
        self.listens = socket.create_server(("127.0.0.1", 0))
        self.url = f"ws://127.0.0.1:{self.listens.getsockname()[1]}"
        self.lines = []
        self.start()

    def run(self):
        while True:
            line, _ = self.listens.accept()
            self.lines.append(line)
            if self.mute != "connect":
                threading.Thread(target=self.talk, args=(line,), daemon=True).start()

    def talk(self, line):
        """Answer one connection."""
        request = b""
        while b"\r\n\r\n" not in request:
            request += line.recv(4096)
        if b"Upgrade" not in request:
            with suppress(OSError):
                while self.mute == "version":  # an endless answer, a byte at a time
                    line.sendall(b"H")
                    time.sleep(0.05)
            line.sendall(b"HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n")
            return
        key = re.search(rb"Sec-WebSocket-Key: (\S+)", request)[1]
        accept = base64.b64encode(
            hashlib.sha1(key + b"258EAFA5-E914-47DA-95CA-C5AB0DC85B11").digest()
        )
        line.sendall(
            b"HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            b"Sec-WebSocket-Accept: " + accept + b"\r\n\r\n"
        )
        if self.mute == "handshake":
            return
        frame = framed(json.dumps({"session_id": 1, "inverse3": [DEVICE]}).encode(), opcode=1)
        line.sendall(frame)
        while not self.silent.is_set():
            if not line.recv(65536):
                return
            self.taken += 1
            line.sendall(frame)


@pytest.mark.slow
@pytest.mark.parametrize("mute", ["connect", "handshake"])
def test_a_service_that_never_answers_is_refused_in_time(mute):
    service, began = Service(mute), time.perf_counter()
    with pytest.raises(InputError, match="haply must be reached at"):
        HaplyAdapter(Hardware(address=service.url)).__enter__()
    assert time.perf_counter() - began < 8.0


@pytest.mark.slow
def test_a_service_that_never_states_its_version_is_used():
    service, began = Service("version"), time.perf_counter()
    with HaplyAdapter(Hardware(address=service.url)) as adapter:
        assert time.perf_counter() - began < 8.0
        until = time.perf_counter() + 10.0
        while adapter.poll() is None:
            assert time.perf_counter() < until


@pytest.mark.parametrize("full", [False, True])
def test_a_run_whose_service_vanishes_at_its_end_is_finished(full):
    """A run whose service vanishes in the last tenth of a second is finished.

    The service reads no more and its buffers may be full, so that zero cannot be sent.
    """
    service = Service()
    keys = {
        "device": "haply",
        "hardware.address": service.url,
        "duration_s": 0.4,
        "coupling.stiffness_N_m": 100.0,
    }

    def vanish(tick, row):
        if tick == 300:
            service.silent.set()
        if tick == 398 and full:
            for link in found:
                fill(link)

    found = []
    original = HaplyAdapter.__enter__

    def noted(adapter):
        found[:] = [adapter]
        return original(adapter)

    HaplyAdapter.__enter__ = noted
    try:
        run = simulate(load_scene("wall", keys), on_tick=vanish)
    finally:
        HaplyAdapter.__enter__ = original
    assert service.taken > 10 and len(run.trace.rows) == 400


def fill(link):
    """Fill the buffers of a connection, so that the next frame on it waits.

    A thread that is left running fills them.
    """
    connection = link._socket

    def send():
        with suppress(Exception):
            connection.send(bytes(20_000_000))

    threading.Thread(target=send, daemon=True).start()
    time.sleep(0.1)


def test_closing_a_connection_that_nobody_reads_is_quick():
    service = Service()
    adapter = HaplyAdapter(Hardware(address=service.url)).__enter__()
    service.silent.set()
    fill(adapter)
    began = time.perf_counter()
    adapter.close()
    assert time.perf_counter() - began < CLOSES_S
