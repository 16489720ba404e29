"""Packets byte for byte, and every fault of a line to a device.

The faults are dropped, counted, refused and forgotten packets.
"""

import math
import re
import struct
from pathlib import Path

import pytest
from network_client import BYE, HELLO, POSE, REFUSED, WRENCH, packet, pose, read

from tissue.haptics.real.adapter import HardwareSample
from tissue.haptics.real.network_session import (
    SILENCE_S,
    Kind,
    NetworkSession,
    Packet,
    is_newer,
    packed,
    unpacked,
)

PAGE = Path(__file__).resolve().parents[4] / "docs/guide/network_protocol.md"
LAST = 2**32 - 1
PUSH = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
SAMPLE = HardwareSample(
    (0.01, -0.02, 0.03), (0.1, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 1
)
SHOWN = {
    "hello": packed(Kind.HELLO, 1, echo=0, time_s=0.0, payload=b""),
    "wrench": packed(
        Kind.WRENCH, 9, echo=2, time_s=12.25, payload=struct.pack("<6d", 0, 0, 1.5, 0, 0, 0)
    ),
    "pose": pose(2, SAMPLE.position_m, velocity=(0.1, 0.0, 0.0), buttons=1, echo=7, time_s=0.5),
}


class Clock:
    """Time by hand."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def connected(number=1, clock=None):
    """A session that has taken the device "me"."""
    session = NetworkSession(clock or Clock())
    assert read(session.receive(packet(HELLO, number), "me"))[0] == HELLO
    return session


@pytest.mark.parametrize("name", SHOWN)
def test_the_bytes_of_the_page_are_those_of_the_code(name):
    text = re.search(rf"^{name}\n((?:[0-9a-f ]+\n)+)", PAGE.read_text("utf-8"), re.MULTILINE)[1]
    assert bytes.fromhex(text.replace("\n", " ")) == SHOWN[name]


def test_a_pose_is_read_and_the_client_of_the_tests_writes_what_the_code_does():
    found = unpacked(SHOWN["pose"])
    assert found == Packet(Kind.POSE, 2, echo=7, time_s=0.5, sample=SAMPLE)
    assert packet(HELLO, 1) == SHOWN["hello"]
    payload = struct.pack("<6d", 0.0, 0.0, 1.5, 0.0, 0.0, 0.0)
    assert packet(WRENCH, 9, payload, echo=2, time_s=12.25) == SHOWN["wrench"]


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("foreign", b""),
        ("foreign", b"GET / HTTP/1.1\r\n\r\n"),
        ("foreign", packet(POSE, 5, magic=b"TDEW")),
        ("length", packet(POSE, 5)[:20]),
        ("length", pose(5)[:-1]),
        ("length", pose(5) + b"\0"),
        ("length", packet(POSE, 5, b"")),
        ("length", packet(HELLO, 5, b"1")),
        ("length", packet(POSE, 5, b"1" * 112, length=111)),
        ("version", packet(POSE, 5, b"1" * 112, version=2)),
        ("version", packet(HELLO, 5, version=0)),
        ("checksum", pose(5)[:-1] + b"\0"),
        ("checksum", pose(5)[:40] + b"\1" + pose(5)[41:]),
        ("kind", packet(0, 5)),
        ("kind", packet(7, 5)),
        ("kind", packet(WRENCH, 5, struct.pack("<6d", *range(6)))),
        ("kind", packet(REFUSED, 5, b"no")),
        ("number", pose(5, (math.nan, 0.0, 0.0))),
        ("number", pose(5, (0.0, math.inf, 0.0))),
        ("number", pose(5, velocity=(0.0, 0.0, -math.inf))),
        ("number", pose(5, quaternion=(0.0, 0.0, 0.0, 0.0))),
        ("number", pose(5, quaternion=(0.0, 0.0, 0.0, 1.02))),
        ("number", pose(5, quaternion=(math.nan, 0.0, 0.0, 1.0))),
        ("number", pose(5, time_s=math.nan)),
    ],
)
def test_what_cannot_be_used_is_counted_and_dropped(name, data):
    session = connected()
    session.receive(pose(2, (1.0, 0.0, 0.0)), "me")
    before = session.counts.copy()
    assert session.receive(data, "me") is None
    assert session.counts - before == {name: 1}
    assert session.take().position_m == (1.0, 0.0, 0.0) and session.peer == "me"


@pytest.mark.parametrize(
    ("number", "before", "newer"),
    [
        (1, 0, True),
        (0, 0, False),
        (0, 1, False),
        (0, LAST, True),
        (LAST, 0, False),
        (2**31 - 1, 0, True),
        (2**31, 0, False),
    ],
)
def test_a_number_is_newer_within_half_of_all(number, before, newer):
    assert is_newer(number, before) is newer


def test_the_round_trip_is_from_a_wrench_to_the_first_packet_that_shows_it():
    clock = Clock()
    session = connected(clock=clock)
    assert math.isnan(session.round_trip_s)
    session.wrench(PUSH)
    clock.now += 0.003
    session.receive(pose(2, echo=2), "me")
    assert session.round_trip_s == pytest.approx(0.003)
    clock.now += 0.1
    session.receive(pose(3, echo=2), "me")  # shown before
    session.receive(pose(4, echo=77), "me")  # never sent
    assert session.round_trip_s == pytest.approx(0.003)


def test_a_second_device_is_refused_with_a_reason_and_its_poses_are_dropped():
    session = connected()
    kind, number, echo, reason = read(session.receive(packet(HELLO, 9), "other"))
    assert (kind, number, echo) == (REFUSED, 0, 9)
    assert reason.decode().startswith(
        "one device must be used at a time, got a second one. End the first"
    )
    assert (
        session.receive(pose(10), "other") is None
        and session.take() is None
        and session.peer == "me"
    )
    assert session.counts == {"hellos": 1, "refused": 1, "stranger": 1}


def test_a_silent_device_is_given_up_and_another_taken():
    clock = Clock()
    session = connected(clock=clock)
    session.receive(pose(2), "me")
    clock.now += 0.99 * SILENCE_S
    assert session.wrench(PUSH) is not None
    clock.now += 0.02 * SILENCE_S
    assert session.take() is None and session.wrench(PUSH) is None and session.peer is None
    assert read(session.receive(packet(HELLO, 1), "other"))[0] == HELLO
    session.receive(pose(2), "other")
    assert session.take() is not None and session.counts["silences"] == 1


def test_a_device_that_starts_again_is_taken_again():
    """Its numbers begin anew; a hello that came twice does not let old poses pass as new ones."""
    session = connected()
    session.receive(pose(1000), "me")
    assert read(session.receive(packet(HELLO, 1, time_s=5.0), "me"))[0] == HELLO
    session.receive(pose(2), "me")
    assert session.take() is not None
    session.receive(pose(3), "me")
    assert read(session.receive(packet(HELLO, 1, time_s=5.0), "me"))[0] == HELLO
    session.receive(pose(2), "me")
    assert session.counts == {"hellos": 2, "poses": 3, "repeated": 1, "late": 1, "lost": 998}


@pytest.mark.parametrize("end", ["bye", "connection"])
def test_a_device_that_ends_makes_a_place(end):
    session = connected()
    session.receive(pose(2), "me")
    session.leave("other")
    assert session.peer == "me"
    if end == "bye":
        session.receive(packet(BYE, 3), "me")
    else:
        session.leave("me")
    assert session.peer is None and session.take() is None and session.wrench(PUSH) is None
    assert read(session.receive(packet(HELLO, 1), "other"))[0] == HELLO
