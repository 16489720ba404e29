"""Session with one network device, with the packets of the protocol and their checks."""

import struct
import threading
import zlib
from collections import Counter
from collections.abc import Callable, Hashable
from enum import IntEnum
from math import isfinite, isnan, nan
from time import perf_counter
from typing import NamedTuple

from tissue.haptics.real.adapter import HardwareSample
from tissue.motion.quaternion import is_nearly_unit

MAGIC = b"TDEV"
"""First four bytes of every packet."""
VERSION = 1
HEADER = struct.Struct("<4sBBHIId")
"""Magic bytes, version, kind, bytes of the payload, sequence number, echo, sender's time [s]."""
CHECKSUM = struct.Struct("<I")
POSE = struct.Struct("<13dII")
"""Position [m], quaternion (x, y, z, w), velocity [m/s], spin [rad/s], buttons, 4 zero bytes."""
WRENCH = struct.Struct("<6d")
"""Force [N] and torque [N m]."""
HALF = 1 << 31
WHOLE = 1 << 32
"""Number of different sequence numbers of packets; `HALF` is half of this number.

Sequence numbers restart after 2^32 packets. A sequence number is newer than another number if it is
ahead by less than `HALF`.
"""


class Kind(IntEnum):
    """Kind of a packet."""

    HELLO = 1
    """Request of a device to connect, or confirmation that the device is accepted."""
    POSE = 2
    """Pose of the device."""
    WRENCH = 3
    """Force and torque that the device must apply."""
    HEARTBEAT = 4
    """Packet of a sender that is active but has nothing else to send."""
    BYE = 5
    """Packet with which the sender ends the session."""
    REFUSED = 6
    """Refusal of the device, with a sentence."""


LENGTHS = {Kind.HELLO: 0, Kind.POSE: POSE.size, Kind.HEARTBEAT: 0, Kind.BYE: 0}
"""Payload size in bytes, for each kind of packet that a device may send."""
Wrench = tuple[float, float, float, float, float, float]
"""Force [N] and torque [N m] on the hand, in the device's frame."""
NO_WRENCH: Wrench = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class PacketError(Exception):
    """Error for an unusable packet; its text is the name under which the packet is counted."""


class Packet(NamedTuple):
    """Packet received from a device.

    Attributes
    ----------
    kind
        Kind of the packet.
    sequence
        Number of the packet in the sequence of packets from the same sender. The first number is 1.
        After 4294967295, the next number is 0.
    echo
        Sequence number of the newest packet that the sender has received; 0 if it has received
        none.
    time_s
        Time on the clock of the sender [s]; the zero of the clock is arbitrary.
    sample
        Sample in a packet with a pose; None for other kinds of packets.
    """

    kind: Kind
    sequence: int
    echo: int
    time_s: float
    sample: HardwareSample | None


def packed(kind: Kind, sequence: int, *, echo: int, time_s: float, payload: bytes) -> bytes:
    """Return a packet as bytes."""
    head = HEADER.pack(MAGIC, VERSION, kind, len(payload), sequence, echo, time_s)
    return head + payload + CHECKSUM.pack(zlib.crc32(head + payload))


def unpacked(data: bytes) -> Packet:
    """Return a validated packet of a device from bytes.

    Raises
    ------
    PacketError
        If the packet is not valid. The text of the error is one of these names: ``foreign``,
        ``version``, ``length``, ``checksum``, ``kind`` or ``number``.
    """
    if data[:4] != MAGIC:
        raise PacketError("foreign")
    if len(data) < HEADER.size + CHECKSUM.size:
        raise PacketError("length")
    _, version, kind, length, sequence, echo, time_s = HEADER.unpack_from(data)
    if version != VERSION:
        raise PacketError("version")
    end = HEADER.size + length
    if len(data) != end + CHECKSUM.size:
        raise PacketError("length")
    if CHECKSUM.unpack_from(data, end)[0] != zlib.crc32(data[:end]):
        raise PacketError("checksum")
    if kind not in LENGTHS:
        raise PacketError("kind")
    if length != LENGTHS[kind]:
        raise PacketError("length")
    sample = None
    total = time_s
    if kind == Kind.POSE:
        pose = POSE.unpack(data[HEADER.size : end])
        total += sum(pose[:13])
        sample = HardwareSample(pose[:3], pose[7:10], pose[3:7], pose[10:13], pose[13])
    if not isfinite(total) or (sample is not None and not is_nearly_unit(sample.quaternion)):
        raise PacketError("number")
    return Packet(Kind(kind), sequence, echo, time_s, sample)


def is_newer(sequence: int, before: int) -> bool:
    """Return True if a sequence number is newer than another; numbers restart from 0."""
    return 0 < (sequence - before) % WHOLE < HALF


SILENCE_S = 0.5
"""Time without packets after which a device is given up and another device may connect [s].

A device sends at least five packets per second. After this time, at least two packets in a row are
missing.
"""
STORED_SEND_TIMES = 1024
"""Number of wrenches whose send time is stored, to measure round trips.

At 1 kHz, the wrenches of about one second are stored.

The value is a power of two, so that the index in the storage stays consecutive when sequence
numbers restart.
"""
MOST_WORDS = 400
"""Largest length of the sentence in a packet that refuses a device [bytes]."""
BUSY = (
    "one device must be used at a time, got a second one. End the first device, or "
    "wait half a second after it has stopped"
)


class NetworkSession:
    """Session with one device, which processes received packets and builds packets to send.

    The session never waits, and does not use a socket itself. The first device that sends a hello
    is accepted. Other devices are refused until this device has ended the session or was silent for
    `SILENCE_S`. A pose that is late, repeated, damaged or not finite is dropped and counted.

    Parameters
    ----------
    clock
        Function that returns the time [s]; the zero of the time is arbitrary.

    Attributes
    ----------
    peer
        Address of the accepted device; None without a device.
    counts
        Numbers of packets, keyed by outcome. Received packets are ``poses``, ``heartbeats`` and
        ``hellos``. Packets lost in the network are ``lost``. Dropped packets are ``foreign``,
        ``version``, ``length``, ``checksum``, ``kind``, ``number``, ``late``, ``repeated``,
        ``stranger`` or ``refused``. ``silences`` counts devices that were given up.
    round_trip_s
        Round trip time of the newest confirmed wrench [s]: from sending the wrench to the first
        packet that confirms it. It is nan before the first confirmation.
    """

    def __init__(self, clock: Callable[[], float] = perf_counter) -> None:
        self.peer: Hashable | None = None
        self.counts: Counter[str] = Counter()
        self.round_trip_s = nan
        self._clock = clock
        self._heard = 0.0
        self._lock = threading.Lock()
        self._newest: HardwareSample | None = None
        self._seen = 0  # newest sequence number of the device
        self._sent = 0
        self._shown = 0  # newest of our packets that the device has confirmed
        self._sent_at = [nan] * STORED_SEND_TIMES
        # sequence number and time of the hello that was accepted
        self._greeting = (0, nan)

    def receive(self, data: bytes, sender: Hashable) -> bytes | None:
        """Process a packet, and return the reply to the sender, or None if there is no reply."""
        with self._lock:
            try:
                return self._receive(unpacked(data), sender)
            except PacketError as problem:
                self.counts[str(problem)] += 1
                return None

    def take(self) -> HardwareSample | None:
        """Return the newest pose; None if there is no new pose since the last call."""
        with self._lock:
            self._forget_silent()
            newest = self._newest
            self._newest = None
            return newest

    def wrench(self, wrench: Wrench) -> tuple[Hashable, bytes] | None:
        """Return the receiver and packet of a wrench to send, or None if no device is connected."""
        with self._lock:
            self._forget_silent()
            if self.peer is None:
                return None
            return self.peer, self._packet(Kind.WRENCH, WRENCH.pack(*wrench))

    def bye(self) -> tuple[Hashable, bytes] | None:
        """End the session; return receiver and last packet, or None if no device is connected."""
        with self._lock:
            return self._ended_with(self._packet(Kind.BYE))

    def refused(self, sentence: str) -> tuple[Hashable, bytes] | None:
        """End the session; return receiver and refusal, or None if no device is connected."""
        with self._lock:
            # A character that is truncated within its bytes is dropped.
            payload = sentence.encode()[:MOST_WORDS].decode(errors="ignore").encode()
            return self._ended_with(
                packed(Kind.REFUSED, 0, echo=self._seen, time_s=0.0, payload=payload)
            )

    def leave(self, sender: Hashable) -> None:
        """Remove a device whose connection has ended."""
        with self._lock:
            if sender == self.peer:
                self._forget()

    def _receive(self, packet: Packet, sender: Hashable) -> bytes | None:
        self._forget_silent()
        if packet.kind is Kind.HELLO:
            return self._hello(packet, sender)
        if sender != self.peer:
            self.counts["stranger"] += 1
            return None
        if not is_newer(packet.sequence, self._seen):
            self.counts["repeated" if packet.sequence == self._seen else "late"] += 1
            return None
        if lost := (packet.sequence - self._seen) % WHOLE - 1:
            self.counts["lost"] += lost
        self._seen = packet.sequence
        self._heard = self._clock()
        self._measure(packet.echo)
        if packet.kind is Kind.POSE:
            self.counts["poses"] += 1
            self._newest = packet.sample
        elif packet.kind is Kind.HEARTBEAT:
            self.counts["heartbeats"] += 1
        else:
            self._forget()
        return None

    def _hello(self, packet: Packet, sender: Hashable) -> bytes:
        """Accept a device, or the same device after a restart; refuse any other device."""
        if self.peer is not None and sender != self.peer:
            self.counts["refused"] += 1
            return packed(Kind.REFUSED, 0, echo=packet.sequence, time_s=0.0, payload=BUSY.encode())
        if self.peer is None or (packet.sequence, packet.time_s) != self._greeting:
            self.counts["hellos"] += 1
            self.peer = sender
            self._seen = packet.sequence
            self._newest = None
            self._greeting = packet.sequence, packet.time_s
        else:  # after a repeated hello, earlier poses must not be new
            self.counts["repeated"] += 1
        self._heard = self._clock()
        return self._packet(Kind.HELLO)

    def _packet(self, kind: Kind, payload: bytes = b"") -> bytes:
        now = self._clock()
        self._sent = (self._sent + 1) % WHOLE
        # Only wrenches are measured, because a device may confirm other packets later.
        self._sent_at[self._sent % STORED_SEND_TIMES] = now if kind is Kind.WRENCH else nan
        return packed(kind, self._sent, echo=self._seen, time_s=now, payload=payload)

    def _measure(self, echo: int) -> None:
        """Record the round trip time if a packet is the first to confirm a wrench."""
        # Send times of older packets have been overwritten.
        if is_newer(echo, self._shown) and 0 <= (self._sent - echo) % WHOLE < STORED_SEND_TIMES:
            self._shown = echo
            if not isnan(sent := self._sent_at[echo % STORED_SEND_TIMES]):
                self.round_trip_s = self._clock() - sent

    def _ended_with(self, data: bytes) -> tuple[Hashable, bytes] | None:
        """End the session with a last packet."""
        peer = self.peer
        self._forget()
        return None if peer is None else (peer, data)

    def _forget_silent(self) -> None:
        if self.peer is not None and self._clock() - self._heard > SILENCE_S:
            self.counts["silences"] += 1
            self._forget()

    def _forget(self) -> None:
        self.peer = None
        self._newest = None
        self._seen = 0
