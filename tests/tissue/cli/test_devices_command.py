"""``tissue devices``: its list without any device, and its test of a device.

The tested device is a client of the network protocol.
"""

import socket
import sys
import threading
import time
import tomllib

import pytest
from network_client import BYE, HELLO, UdpClient, packet, pose, read
from vendor_doubles import ForceDimension, OpenHaptics, without

from tissue import register
from tissue.cli.main import main
from tissue.scene.registry import DEVICES


@pytest.fixture
def command(monkeypatch, capsys):
    """Runs ``tissue`` with arguments: exit code, standard output and error."""

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["tissue", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
        printed = capsys.readouterr()
        return ended.value.code, printed.out, " ".join(printed.err.split())

    return run


@pytest.fixture
def alone(monkeypatch):
    """A machine without any vendor's library, where nothing is listened for long."""
    for package in ("forcedimension_core", "pyOpenHaptics"):
        without(monkeypatch, package)
    monkeypatch.setattr("tissue.haptics.real.network.LOOK_S", 0.01)
    monkeypatch.setattr("tissue.haptics.real.network.USUAL", "udp://127.0.0.1:0")


def test_without_devices_each_kind_has_a_sentence(command, alone):
    code, out, _ = command("devices")
    lines = out.splitlines()
    assert code == 0 and lines[0] == "no device is found"
    assert [line.split()[0] for line in lines[1:]] == [
        "haply",
        "forcedimension",
        "openhaptics",
        "network",
        "recorded",
    ]
    assert "pip install forcedimension-core" in out and "pip install pyOpenHaptics" in out
    assert all(". " in line and " must " in line for line in lines[1:])


def test_found_devices_come_first_with_their_limits(command, alone, monkeypatch):
    ForceDimension().install(monkeypatch)
    OpenHaptics().install(monkeypatch)
    code, out, _ = command("devices")
    assert code == 0 and out.startswith(
        "forcedimension  7  omega.6\n                at most 12 N, no torque; workspace 110 "
        "x 160 x 160 mm; 1000 Hz"
    )
    assert (
        "openhaptics     Default Device  3D Systems Touch\n" in out
        and "no device is found" not in out
    )


def test_a_registered_device_is_listed_and_not_tested(command, alone):
    register.device("own-pen", {"mass_kg": 0.05, "damping_N_s_m": 0.5}, lambda start_m: None)
    try:
        code, out, _ = command("devices")
        assert code == 0 and out.splitlines()[-1].split()[:2] == ["own-pen", "registered;"]
        code, _, error = command("devices", "--test", "own-pen")
        assert code == 2 and "got the registered device own-pen. Use it in a run" in error
    finally:
        DEVICES.remove("own-pen")


class Device:
    """A client that asks, and sends a pose about each millisecond until it is to end."""

    def __init__(self):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
            free.bind(("127.0.0.1", 0))
            self.address = f"udp://127.0.0.1:{free.getsockname()[1]}"
        self.forces, self.ends, self.left = [], threading.Event(), threading.Event()
        self.thread = threading.Thread(target=self.run)

    def run(self):
        client, taken, seen, height = UdpClient(self.address), False, 0, 0.0
        client.line.setblocking(False)
        while not self.ends.is_set():
            try:
                kind, seen, _, payload = read(client.line.recv(2048))
                if (taken := kind != BYE) is False:
                    self.left.set()
                if payload:
                    self.forces.append(memoryview(payload).cast("d")[2])
                    height += 1e-6 * self.forces[-1]
                continue
            except (BlockingIOError, ConnectionError):
                pass
            client.number += 1
            here = pose(client.number, (0.0, 0.0, height), echo=seen)
            client.send(here if taken else packet(HELLO, client.number))
            time.sleep(5e-4)
        client.line.close()

    def __enter__(self):
        self.thread.start()
        return self

    def __exit__(self, *error):
        self.left.wait()  # all that was sent has then come
        self.ends.set()
        self.thread.join()


def test_a_device_is_tested_pushed_and_its_numbers_written(command, tmp_path):
    out_file = tmp_path / "measured.toml"
    with Device() as device:
        arguments = (
            "devices",
            "--test",
            "network",
            "--address",
            device.address,
            "--seconds",
            "0.3",
            "--yes",
        )
        code, out, error = command(*arguments, "--out", str(out_file))
    assert code == 0, error
    names = [line.split("  ")[0] for line in out.splitlines()]
    assert names == [
        "samples",
        "interval",
        "calls",
        "round trip",
        "push",
        f'written to {out_file}: use it in a scene by --set materials="{out_file}"',
    ]
    assert "not shown" not in out and "0.5 N along the device's z" in out
    assert 0.4 < max(device.forces) <= 0.5 and device.forces[-1] == 0.0
    entries = tomllib.loads(out_file.read_text("utf-8"))["devices"]["network"]
    assert (
        10.0 <= entries["rate_Hz"]["value"] <= 1000.0
        and 0.0 < entries["transport_delay_s"]["value"] <= 0.2
    )
    code, _, error = command(*arguments, "--out", str(out_file))
    assert code == 2 and "--overwrite" in error


@pytest.mark.parametrize(
    ("answer", "pushes"),
    [("push\n", True), (" PUSH \n", True), ("y\n", False), ("\n", False), ("", False)],
)
def test_the_push_is_made_only_after_the_word_is_typed(
    command, monkeypatch, tmp_path, answer, pushes
):
    import io

    monkeypatch.setattr(sys, "stdin", io.StringIO(answer))
    with Device() as device:
        code, out, _ = command(
            "devices", "--test", "network", "--address", device.address, "--seconds", "0.1"
        )
    assert code == 0 and "Type push and Enter to feel it" in out
    assert ("not confirmed: left out" in out) is not pushes
    assert (max(device.forces) > 0.4) is pushes


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--yes",), "--yes must be left out without --test. Name a device by --test"),
        (
            ("--out", "x.toml"),
            "--out must be left out without --test. Name a device by --test",
        ),
        (
            ("--test", "network", "--overwrite"),
            "--overwrite must be left out without --out. Remove it",
        ),
        (
            ("--test", "touch"),
            (
                "--test must be one of haply, forcedimension, sigma-7, openhaptics, network "
                "or recorded, got touch"
            ),
        ),
        (
            ("--test", "recorded"),
            "--address must be given with device = recorded. Give a file of poses",
        ),
        (
            ("--test", "network", "--address", "x"),
            "--address must be udp://HOST:PORT or ws://HOST:PORT",
        ),
        (
            ("--test", "network", "--out", "no/such/x.toml"),
            "out must lie in a folder that exists, got no/such/x.toml",
        ),
        (
            ("--test", "network", "--address", "udp://127.0.0.1:0", "--seconds", "0"),
            "seconds must be in [0.1, 600], got 0",
        ),
    ],
)
def test_what_cannot_be_meant_is_refused(command, arguments, sentence):
    code, _, error = command("devices", *arguments)
    assert code == 2 and sentence in error
