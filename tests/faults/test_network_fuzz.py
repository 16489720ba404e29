"""Line to a network device that damages, repeats, reorders and invents packets.

Nothing false passes, and no session ends.
"""

import struct
import zlib

import numpy as np
import pytest
from network_client import HELLO, packet, pose, read

from tissue.haptics.real.network_session import Kind, NetworkSession, PacketError, unpacked

ROUNDS = 10
KINDS = ("bits", "cut", "longer", "noise", "header", "repeat", "swap", "none")


def spoilt(data, kind, rng):
    """A packet with a fault of the line."""
    raw = bytearray(data)
    if kind == "bits":
        for at in rng.integers(8 * len(raw), size=rng.integers(1, 6)):
            raw[at // 8] ^= 1 << (at % 8)
    elif kind == "cut":
        del raw[rng.integers(len(raw)) :]
    elif kind == "longer":
        raw += rng.bytes(int(rng.integers(1, 200)))
    elif kind == "noise":
        raw = bytearray(
            (b"TDEV" if rng.integers(2) else b"") + rng.bytes(int(rng.integers(0, 300)))
        )
    elif kind == "header":  # a whole packet, its checksum among it, whose fields are anything
        raw[4 : 4 + 12] = rng.bytes(12)
        raw[-4:] = struct.pack("<I", zlib.crc32(bytes(raw[:-4])))
    return bytes(raw)


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_of_damaged_packets_only_whole_ones_pass(seed):
    rng = np.random.default_rng(seed)
    for _ in range(100):
        place = tuple(rng.normal(size=3))
        whole = pose(int(rng.integers(2**32)), place, time_s=float(rng.normal()))
        data = spoilt(whole, KINDS[rng.integers(5)], rng)
        try:
            found = unpacked(data)
        except PacketError as error:
            assert str(error) in ("foreign", "version", "length", "checksum", "kind", "number")
            continue
        if data != whole:  # only a header that is as good as another, with its checksum
            assert found.kind is not Kind.POSE or found.sample.position_m == place


@pytest.mark.parametrize("seed", range(ROUNDS))
def test_a_damaged_line_gives_poses_in_order_and_loses_no_count(seed):
    """A damaged line gives poses in order and counts every packet once.

    Poses that pass equal the sent ones, in their order.
    """
    rng = np.random.default_rng(1000 + seed)
    clock = iter(np.arange(0.0, 1e3, 1e-4))
    session = NetworkSession(lambda: float(next(clock)))
    start = (2**32 - 150) if seed % 2 else 1  # half of the runs pass the end of the numbers
    assert read(session.receive(packet(HELLO, start), "me"))[0] == HELLO
    line, passed, handed = [], [], 0
    for count in range(1, 301):
        line.append(pose((start + count) % 2**32, (float(count), 0.0, 0.0)))
        kind = KINDS[rng.integers(len(KINDS))]
        if kind == "repeat":
            line.append(line[rng.integers(len(line))])
        elif kind == "swap":
            rng.shuffle(line)
        elif kind != "header":
            line[-1] = spoilt(line[-1], kind, rng)
        for data in [line.pop(0) for _ in range(int(rng.integers(0, len(line) + 1)))]:
            session.receive(data, "me" if rng.random() > 0.02 else "other")
            handed += 1
            if (sample := session.take()) is not None:
                passed.append(sample.position_m[0])
    assert (
        passed == sorted(set(passed))
        and set(passed) <= {float(count) for count in range(1, 301)}
        and len(passed) > 5
    )
    counted = sum(count for name, count in session.counts.items() if name not in ("lost", "hellos"))
    assert counted == handed and session.counts["poses"] == len(passed) and session.peer == "me"
