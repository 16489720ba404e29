"""Packets between this program and a user's device: header, payload and checksum, little-endian."""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from math import isfinite

from tissue.haptics.real.adapter import HardwareSample
from tissue.motion.quaternion import Triple, is_nearly_unit

__all__ = [
    "MAGIC",
    "NO_WRENCH",
    "VERSION",
    "WHOLE",
    "Kind",
    "Packet",
    "PacketError",
    "Wrench",
    "is_newer",
    "packed",
    "unpacked",
]

MAGIC = b"TDEV"
"""First four bytes of every packet."""
VERSION = 1
HEADER = struct.Struct("<4sBBHIId")
"""Magic, version, kind, bytes of the payload, sequence number, echo, sender's time [s]."""
CHECKSUM = struct.Struct("<I")
POSE = struct.Struct("<13dII")
"""Position [m], quaternion (x, y, z, w), velocity [m/s], spin [rad/s], buttons, four zero bytes."""
WRENCH = struct.Struct("<6d")
"""Force [N] and torque [N m]."""
LONGEST_REASON = 400
"""Largest length of the sentence in a refusal [bytes]."""
HALF, WHOLE = 1 << 31, 1 << 32
"""Half of the number of sequence numbers, and their number."""


class Kind(IntEnum):
    """Kind of a packet."""

    HELLO = 1
    """The device asks to be used, or has been accepted."""
    POSE = 2
    """Pose of the device."""
    WRENCH = 3
    """Force and torque to play."""
    HEARTBEAT = 4
    """The sender is active and has nothing else to send."""
    BYE = 5
    """The sender ends."""
    REFUSED = 6
    """The device is refused, with a sentence."""


LENGTHS = {
    Kind.HELLO: 0,
    Kind.POSE: POSE.size,
    Kind.WRENCH: WRENCH.size,
    Kind.HEARTBEAT: 0,
    Kind.BYE: 0,
}
"""Bytes of the payload; the sentence of a refusal has any length."""
Wrench = tuple[Triple, Triple]
"""Force [N] and torque [N m] on the hand, in the device's frame."""
NO_WRENCH: Wrench = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


class PacketError(Exception):
    """Error of an unusable packet; its text is the name under which it is counted."""


@dataclass(frozen=True, kw_only=True)
class Packet:
    """Packet of the protocol.

    Attributes
    ----------
    kind
        Kind of the packet.
    sequence
        Number of the packet among the packets of its sender, from 1; 0 follows 4294967295.
    echo
        Sequence number of the newest packet that the sender has received; 0 before the first.
    time_s
        Clock of the sender, with any start [s].
    sample, wrench, reason
        Content of a pose, a wrench or a refusal.
    """

    kind: Kind
    sequence: int
    echo: int = 0
    time_s: float = 0.0
    sample: HardwareSample | None = None
    wrench: Wrench = NO_WRENCH
    reason: str = ""


def packed(packet: Packet) -> bytes:
    """Return a packet as bytes."""
    payload = b""
    if packet.kind is Kind.POSE and packet.sample is not None:
        at = packet.sample
        payload = POSE.pack(
            *at.position_m, *at.quaternion, *at.velocity_m_s, *at.spin_rad_s, at.buttons, 0
        )
    elif packet.kind is Kind.WRENCH:
        payload = WRENCH.pack(*packet.wrench[0], *packet.wrench[1])
    elif packet.kind is Kind.REFUSED:
        payload = packet.reason.encode("utf-8")[:LONGEST_REASON]
    head = HEADER.pack(
        MAGIC, VERSION, packet.kind, len(payload), packet.sequence, packet.echo, packet.time_s
    )
    return head + payload + CHECKSUM.pack(zlib.crc32(head + payload))


def unpacked(data: bytes) -> Packet:
    """Return a validated packet from bytes.

    Raises
    ------
    PacketError
        With the name under which it is counted: ``foreign``, ``version``, ``length``, ``checksum``,
        ``kind`` or ``number``.
    """
    if data[:4] != MAGIC:
        raise PacketError("foreign")
    if len(data) < HEADER.size + CHECKSUM.size:
        raise PacketError("length")
    _, version, number, length, sequence, echo, time_s = HEADER.unpack_from(data)
    if version != VERSION:
        raise PacketError("version")
    if len(data) != HEADER.size + length + CHECKSUM.size:
        raise PacketError("length")
    if CHECKSUM.unpack_from(data, HEADER.size + length)[0] != zlib.crc32(
        data[: HEADER.size + length]
    ):
        raise PacketError("checksum")
    try:
        kind = Kind(number)
    except ValueError:
        raise PacketError("kind") from None
    if length != LENGTHS.get(kind, length) or (kind is Kind.REFUSED and length > LONGEST_REASON):
        raise PacketError("length")
    if not isfinite(time_s):
        raise PacketError("number")
    payload = data[HEADER.size : HEADER.size + length]
    sample = _sample(payload) if kind is Kind.POSE else None
    wrench = _wrench(payload) if kind is Kind.WRENCH else NO_WRENCH
    reason = payload.decode("utf-8", "replace") if kind is Kind.REFUSED else ""
    return Packet(
        kind=kind,
        sequence=sequence,
        echo=echo,
        time_s=time_s,
        sample=sample,
        wrench=wrench,
        reason=reason,
    )


def is_newer(sequence: int, before: int) -> bool:
    """Return whether a sequence number follows another, including a restart from 0 in between."""
    return 0 < (sequence - before) % WHOLE < HALF


def _sample(payload: bytes) -> HardwareSample:
    """Return the sample of a pose; a quaternion of nearly unit length is not changed."""
    x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz, buttons, _ = POSE.unpack(payload)
    total = x + y + z + vx + vy + vz + wx + wy + wz
    if not isfinite(total) or not is_nearly_unit((qx, qy, qz, qw)):
        raise PacketError("number")
    return HardwareSample((x, y, z), (vx, vy, vz), (qx, qy, qz, qw), (wx, wy, wz), buttons)


def _wrench(payload: bytes) -> Wrench:
    fx, fy, fz, tx, ty, tz = WRENCH.unpack(payload)
    if not isfinite(fx + fy + fz + tx + ty + tz):
        raise PacketError("number")
    return (fx, fy, fz), (tx, ty, tz)
