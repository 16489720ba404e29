"""What passes between this program and one device on a network: who it is, what is new, what is
dropped and counted.
"""

import threading
from collections import Counter
from collections.abc import Callable, Hashable
from math import isnan, nan
from time import perf_counter

from tissue.haptics.real.adapter import HardwareSample
from tissue.haptics.real.network_protocol import (
    NO_WRENCH,
    WHOLE,
    Kind,
    Packet,
    PacketError,
    Wrench,
    is_newer,
    packed,
    unpacked,
)

__all__ = ["SILENCE_S", "NetworkSession"]

SILENCE_S = 0.5
"""Silence after which a device is given up and another may take its place [s]."""
KEPT = 1024
"""Wrenches whose time of sending is kept, by which round trips are measured; a power of two."""
BUSY = (
    "one device must be used at a time, got a second: end the first, or wait half a second after "
    "it has stopped"
)


class NetworkSession:
    """Takes the packets of one device and makes those for it; nothing here waits or reads a socket.

    The first device that asks is taken; others are refused until it has ended or was silent for
    `SILENCE_S`. A pose that is late, repeated, damaged or not finite is dropped and counted.

    Parameters
    ----------
    clock
        Seconds from any start.

    Attributes
    ----------
    peer
        Address of the device that was taken; None where there is none.
    counts
        Packets by what became of them: ``poses``, ``heartbeats``, ``hellos``, ``lost`` on the line,
        and those that were dropped as ``foreign``, ``version``, ``length``, ``checksum``, ``kind``,
        ``number``, ``late``, ``repeated``, ``stranger`` or ``refused``; ``silences`` counts devices
        that were given up.
    round_trip_s
        Time from the newest wrench that the device has seen to the first packet that shows it [s];
        nan before.
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
        self._shown = 0  # newest of ours that the device has shown
        self._sent_at = [nan] * KEPT
        # sequence number and time of the hello by which the device was taken
        self._greeting = (0, nan)

    def receive(self, data: bytes, sender: Hashable) -> bytes | None:
        """Take a packet; what to send back to its sender, None for nothing."""
        with self._lock:
            try:
                return self._receive(unpacked(data), sender)
            except PacketError as problem:
                self.counts[str(problem)] += 1
                return None

    def take(self) -> HardwareSample | None:
        """The newest pose; None where none came since the last call."""
        with self._lock:
            self._forget_silent()
            newest = self._newest
            self._newest = None
            return newest

    def wrench(self, wrench: Wrench) -> tuple[Hashable, bytes] | None:
        """Where a wrench goes, and its packet; None without a device."""
        with self._lock:
            self._forget_silent()
            if self.peer is None:
                return None
            return self.peer, self._packet(Kind.WRENCH, wrench)

    def bye(self) -> tuple[Hashable, bytes] | None:
        """Where the last packet goes, and that packet; the device is then free. None without a
        device.
        """
        with self._lock:
            if self.peer is None:
                return None
            peer = self.peer
            data = self._packet(Kind.BYE)
            self._forget()
            return peer, data

    def leave(self, sender: Hashable) -> None:
        """Forget a device whose connection has ended."""
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
        self._seen, self._heard = packet.sequence, self._clock()
        self._measure(packet.echo)
        if packet.kind is Kind.POSE:
            self.counts["poses"] += 1
            self._newest = packet.sample
        elif packet.kind is Kind.HEARTBEAT:
            self.counts["heartbeats"] += 1
        elif packet.kind is Kind.BYE:
            self._forget()
        else:
            self.counts["kind"] += 1
        return None

    def _hello(self, packet: Packet, sender: Hashable) -> bytes:
        """Take a device, or the same one that has started again; refuse any other."""
        if self.peer is not None and sender != self.peer:
            self.counts["refused"] += 1
            return packed(Packet(kind=Kind.REFUSED, sequence=0, echo=packet.sequence, reason=BUSY))
        if self.peer is None or (packet.sequence, packet.time_s) != self._greeting:
            self.counts["hellos"] += 1
            self.peer = sender
            self._seen = packet.sequence
            self._newest = None
            self._greeting = packet.sequence, packet.time_s
        else:  # it came twice: poses from before it must not pass as new
            self.counts["repeated"] += 1
        self._heard = self._clock()
        return self._packet(Kind.HELLO)

    def _packet(self, kind: Kind, wrench: Wrench = NO_WRENCH) -> bytes:
        now = self._clock()
        self._sent = (self._sent + 1) % WHOLE
        self._sent_at[self._sent % KEPT] = now if kind is Kind.WRENCH else nan
        return packed(
            Packet(kind=kind, sequence=self._sent, echo=self._seen, time_s=now, wrench=wrench)
        )

    def _measure(self, echo: int) -> None:
        """Note the round trip where a packet is the first to show one of our wrenches."""
        if is_newer(echo, self._shown) and 0 <= (self._sent - echo) % WHOLE < KEPT:
            self._shown = echo
            if not isnan(sent := self._sent_at[echo % KEPT]):
                self.round_trip_s = self._clock() - sent

    def _forget_silent(self) -> None:
        if self.peer is not None and self._clock() - self._heard > SILENCE_S:
            self.counts["silences"] += 1
            self._forget()

    def _forget(self) -> None:
        self.peer = None
        self._newest = None
        self._seen = 0
