"""Checksum of OpenIGTLink messages: CRC-64 of the body, vectorised with NumPy for large bodies."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["crc64"]

POLYNOMIAL = 0x42F0E1EBA9EA3693
"""Polynomial of ECMA-182, highest bit first, initial value zero, not inverted."""
LANES = 4096
"""Number of parts of a long body that are processed in parallel; a power of two."""
LONG = 2 * LANES
"""Body length from which the parallel method is faster than a loop over bytes [bytes]."""
MASK = 0xFFFFFFFFFFFFFFFF
Words = NDArray[np.uint64]


def _entries() -> list[int]:
    """Return the remainder of every byte followed by eight zero bytes."""
    found = []
    for byte in range(256):
        value = byte << 56
        for _ in range(8):
            value = ((value << 1) ^ POLYNOMIAL if value >> 63 else value << 1) & MASK
        found.append(value)
    return found


ENTRIES = _entries()
TABLE: Words = np.array(ENTRIES, dtype=np.uint64)
BYTE, TOP = np.uint64(8), np.uint64(56)
BITS: Words = np.arange(64, dtype=np.uint64)


def crc64(body: bytes | bytearray | memoryview) -> int:
    """Return the checksum of a message body.

    The remainder is linear in the body. A long body is split into `LANES` parts, whose remainders
    are computed in parallel and then joined in pairs. The earlier of two remainders is first
    advanced by the length of the later part.
    """
    if len(body) < LONG:
        value = 0
        for byte in body:
            value = ((value << 8) & MASK) ^ ENTRIES[(value >> 56) ^ byte]
        return value
    width = -(-len(body) // LANES)
    padded = np.zeros(LANES * width, dtype=np.uint8)
    # leading zeros do not change the remainder
    padded[len(padded) - len(body) :] = np.frombuffer(body, dtype=np.uint8)
    found = np.zeros(LANES, dtype=np.uint64)
    moved = np.uint64(1) << BITS
    for column in np.ascontiguousarray(padded.reshape(LANES, width).T):
        found = (found << BYTE) ^ TABLE[(found >> TOP) ^ column]
        moved = (moved << BYTE) ^ TABLE[moved >> TOP]
    while len(found) > 1:
        found = _through(moved, found[0::2]) ^ found[1::2]
        moved = _through(moved, moved)
    return int(found[0])


def _through(moved: Words, words: Words) -> Words:
    """Apply the linear map that takes bit i to ``moved[i]`` to words."""
    chosen = ((words[:, None] >> BITS) & np.uint64(1)) * moved
    return np.asarray(np.bitwise_xor.reduce(chosen, axis=1))
