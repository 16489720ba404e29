"""Network device over sockets.

The tests cover UDP and WebSocket, the client of the guide's page, a run, and every exit at zero.
"""

import math
import re
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from network_client import BYE, HELLO, WRENCH, UdpClient, packet, pose, read
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from meshes.base.errors import InputError
from tissue.haptics.device.safe_device import SafeDevice
from tissue.haptics.real.mapped import MappedDevice
from tissue.haptics.real.network import NetworkAdapter
from tissue.scene.coupling import Hardware

PAGE = Path(__file__).resolve().parents[4] / "docs/guide/network_device.md"
ANY_PORT = {scheme: Hardware(address=f"{scheme}://127.0.0.1:0") for scheme in ("udp", "ws")}
FORCE, TORQUE, ZERO = np.array([1.0, -2.0, 3.0]), np.array([0.01, 0.02, -0.03]), np.zeros(3)


def polled(adapter, wanted=lambda sample: sample is not None):
    """Return the first sample that is wanted; pytest ends a test that waits too long."""
    while not wanted(sample := adapter.poll()):
        time.sleep(1e-3)
    return sample


def wrench(payload):
    return struct.unpack("<6d", payload)


def greeted(adapter, client):
    """Let an adapter take a client."""
    client.next(HELLO)
    polled(adapter, lambda sample: adapter.session.peer is not None)
    assert client.receive()[0] == HELLO


def test_the_last_packets_are_zero_and_goodbye():
    with UdpClient("udp://127.0.0.1:1") as client:
        with NetworkAdapter(ANY_PORT["udp"]) as adapter:
            client.place = ("127.0.0.1", int(adapter.address.rpartition(":")[2]))
            greeted(adapter, client)
            adapter.push(FORCE, TORQUE)
        kinds = [client.receive() for _ in range(3)]
        assert [kind for kind, *_ in kinds] == [WRENCH, WRENCH, BYE] and wrench(kinds[1][3]) == (
            0.0,
        ) * 6
        adapter.push(FORCE, TORQUE)
        assert adapter.poll() is None
        adapter.close()
        client.line.settimeout(0.1)
        with pytest.raises(TimeoutError):
            client.receive()


def test_close_may_come_from_another_thread_while_the_loop_polls():
    with UdpClient("udp://127.0.0.1:1") as client, NetworkAdapter(ANY_PORT["udp"]) as adapter:
        client.place = ("127.0.0.1", int(adapter.address.rpartition(":")[2]))
        greeted(adapter, client)
        ends, raised = threading.Event(), []

        def loop():
            try:
                while not ends.is_set():
                    adapter.poll()
                    adapter.push(FORCE, TORQUE)
                    time.sleep(1e-3)  # a full line would drop the last packets
            except Exception as error:
                raised.append(error)

        worker = threading.Thread(target=loop)
        worker.start()
        while client.receive()[0] != WRENCH:
            pass
        adapter.close()
        ends.set()
        worker.join()
        assert raised == []
        while client.receive()[0] != BYE:
            pass


@pytest.mark.parametrize(
    "address",
    [
        "tcp://127.0.0.1:1",
        "udp://127.0.0.1",
        "127.0.0.1:99",
        "udp://:99",
        "udp://127.0.0.1:99999",
        "ws://127.0.0.1:1/x",
        "udp://[::1",
    ],
)
def test_an_address_that_cannot_be_meant_is_refused(address):
    with pytest.raises(
        InputError,
        match=(
            r"hardware\.address must be udp://HOST:PORT or ws://HOST:PORT .* got .*\. Use "
            r"udp://127"
        ),
    ):
        NetworkAdapter(Hardware(address=address))
    (found,) = NetworkAdapter.find(address)
    assert found.problem.startswith("hardware.address must be udp")


@pytest.mark.parametrize("scheme", ["udp", "ws"])
def test_a_port_that_is_taken_is_refused(scheme):
    kind = socket.SOCK_DGRAM if scheme == "udp" else socket.SOCK_STREAM
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        if scheme == "ws":
            taken.listen()
        address = f"{scheme}://127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(
            InputError,
            match=rf"hardware\.address must be free on this machine, got {address} .*\. End the",
        ):
            NetworkAdapter(Hardware(address=address)).__enter__()
        assert "must be free" in NetworkAdapter.find(address)[0].problem


def opened(adapter, **options):
    """A connection to a WebSocket of an adapter."""
    return connect(adapter.address, compression=None, proxy=None, **options)


def received(line):
    return read(line.recv(timeout=10.0))


def test_the_same_packets_pass_in_a_websocket():
    with NetworkAdapter(ANY_PORT["ws"]) as adapter, opened(adapter) as line:
        line.send(packet(HELLO, 1))
        assert received(line)[0] == HELLO
        line.send(pose(2, (0.01, 0.02, 0.03), buttons=2))
        sample = polled(adapter)
        assert (sample.position_m, sample.buttons) == (
            (0.01, 0.02, 0.03),
            2,
        ) and adapter.poll() is None
        adapter.push(FORCE, TORQUE)
        kind, _, echo, payload = received(line)
        assert (kind, echo) == (WRENCH, 2) and wrench(payload) == (*FORCE, *TORQUE)
        line.send("text is no packet")
        line.send(b"TDEV")
        line.send(pose(1))
        line.send(pose(3, (1.0, 0.0, 0.0)))
        assert polled(adapter).position_m == (1.0, 0.0, 0.0)
        assert adapter.session.counts == {
            "hellos": 1,
            "poses": 2,
            "foreign": 1,
            "length": 1,
            "late": 1,
        }
        adapter.push(FORCE, TORQUE)
        assert received(line)[0] == WRENCH
        adapter.close()
        assert wrench(received(line)[3]) == (0.0,) * 6 and received(line)[0] == BYE


def test_a_page_in_a_browser_is_refused():
    with (
        NetworkAdapter(ANY_PORT["ws"]) as adapter,
        pytest.raises(InvalidStatus, match="403"),
        opened(adapter, origin="http://localhost:8000"),
    ):
        pass


class Feeder:
    """Device in a thread that sends a pose each millisecond after its request.

    It keeps each wrench with its time.
    """

    def __init__(self, address, *, until=None, spoil=lambda number, data: data):
        self.client, self.until, self.spoil = (
            UdpClient(address or "udp://127.0.0.1:9"),
            until,
            spoil,
        )
        self.wrenches, self.ends, self.left = [], threading.Event(), threading.Event()
        self.good_until = math.nan
        self.thread = threading.Thread(target=self.run)

    def run(self):
        client, start, taken = self.client, time.perf_counter(), False
        client.line.setblocking(False)
        while not self.ends.is_set():
            try:
                kind, _, _, payload = read(client.line.recv(2048))
                taken = kind != BYE
                if kind == BYE:
                    self.left.set()
                if kind == WRENCH:
                    self.wrenches.append((time.perf_counter(), *wrench(payload)))
                continue
            except (BlockingIOError, ConnectionError):
                pass
            elapsed = time.perf_counter() - start
            client.number += 1
            if not taken:
                client.send(packet(HELLO, client.number))
            elif self.until is None or elapsed < self.until:
                if client.number == 99:
                    self.good_until = time.perf_counter()
                data = self.spoil(
                    client.number, pose(client.number, (0.0, 0.0, -0.02 * min(elapsed, 1.0)))
                )
                client.send(data)
            time.sleep(1e-3)
        client.line.close()

    def reach(self, address):
        """Ask at another address from now on."""
        self.client.place = ("127.0.0.1", int(address.rpartition(":")[2]))

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        self.ends.set()
        self.thread.join()


FAULTS = {
    "silence": lambda number, data: data if number < 100 else b"",
    "wrong version": lambda number, data: (
        data if number < 100 else packet(2, number, data[24:-4], version=2)
    ),
    "not a number": lambda number, data: (
        data if number < 100 else pose(number, (math.nan, 0.0, 0.0))
    ),
    "the same again": lambda number, data: data if number < 100 else pose(90, (0.0, 0.0, 0.0)),
    "cut off": lambda number, data: data if number < 100 else data[:50],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_whatever_a_line_does_the_force_is_zero_soon_after(fault):
    """A force of 1 N is commanded all the time by a loop; once poses fail only zero goes out."""
    hardware = Hardware(address="udp://127.0.0.1:0", ramp_ms=0.0, watchdog_ms=20.0)
    adapter = NetworkAdapter(hardware)
    with (
        SafeDevice(MappedDevice(adapter, hardware)) as held,
        Feeder(adapter.address, spoil=FAULTS[fault]) as feeder,
    ):
        was_pushed, zeros = False, 0
        for tick in range(100_000):
            held.read(1e-3 * tick)
            held.play(np.array([0.0, 0.0, 1.0]), ZERO)
            time.sleep(1e-3)
            was_pushed |= any(each[3] == 1.0 for each in feeder.wrenches[-5:])
            zeros = zeros + 1 if was_pushed and feeder.wrenches[-1][3] == 0.0 else 0
            if zeros > 100 or adapter.session.counts["silences"]:
                break
        assert was_pushed and zeros > 5
    last_push = max(at for at, *parts in feeder.wrenches if any(parts))
    print(
        f"{fault}: last force {1e3 * (last_push - feeder.good_until):.1f} ms after the last "
        "good pose"
    )
    assert not any(any(parts) for at, *parts in feeder.wrenches if at > last_push)


def client_of_the_page(tmp_path, port, seconds):
    """The guide's client, started."""
    (code,) = re.findall(r"^```py\n(.*?)^```", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE)
    assert code.count("\n") < 75
    (tmp_path / "my_device.py").write_text(code)
    command = [sys.executable, "-I", "my_device.py", str(port), str(seconds)]
    return subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_the_client_of_the_page_moves_the_device_and_feels_a_force(tmp_path):
    with NetworkAdapter(ANY_PORT["udp"]) as adapter:
        child = client_of_the_page(tmp_path, adapter.address.rpartition(":")[2], 600)
        try:
            deepest = 0.0
            while (
                deepest > -0.004
                or adapter.session.counts["poses"] < 100
                or math.isnan(adapter.round_trip_s)
            ):
                sample = adapter.poll()
                if sample is not None:
                    deepest = min(deepest, sample.position_m[2])
                    adapter.push(np.array([0.0, 0.0, -500.0 * sample.position_m[2]]), ZERO)
                time.sleep(5e-4)
        finally:
            child.kill()
            child.communicate()
    counts = adapter.session.counts
    assert counts["hellos"] == 1 and not any(
        counts[name] for name in ("checksum", "length", "number", "late", "kind")
    )
