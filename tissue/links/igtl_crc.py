"""The checksum of an OpenIGTLink message: CRC-64 of its body, for bodies of many megabytes in
NumPy.
"""

import numpy as np
from numpy.typing import NDArray

__all__ = ["crc64"]

POLYNOMIAL = 0x42F0E1EBA9EA3693
"""ECMA-182, highest bit first, begun at zero and not inverted."""
LANES = 4096
"""Parts of a long body that are gone through beside each other, a power of two."""
LONG = 2 * LANES
"""Bytes from which that is faster than byte by byte."""
MASK = 0xFFFFFFFFFFFFFFFF
Words = NDArray[np.uint64]


def _entries() -> list[int]:
    """Remainder of every byte that is followed by eight zero bytes."""
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
    """The checksum of a message's body.

    The remainder is linear in the body: a long one is cut into `LANES` parts, whose remainders are
    found at once and then joined in pairs, the earlier of two moved on by the length of the later.
    """
    if len(body) < LONG:
        value = 0
        for byte in body:
            value = ((value << 8) & MASK) ^ ENTRIES[(value >> 56) ^ byte]
        return value
    width = -(-len(body) // LANES)
    padded = np.zeros(LANES * width, dtype=np.uint8)
    # zeros in front change nothing
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
    """Words under the linear map that takes bit i to ``moved[i]``."""
    chosen = ((words[:, None] >> BITS) & np.uint64(1)) * moved
    return np.asarray(np.bitwise_xor.reduce(chosen, axis=1))
