"""OpenIGTLink messages: header, checksum and the bodies that a run sends and receives.

All numbers are big-endian, except the voxels of an image. A header of version 2 is followed by an
extended header, and the body is followed by metadata. Lengths are in mm. 3D Slicer interprets all
positions as RAS (right, anterior, superior).
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.arrays import Array, Floats

POLYNOMIAL = 0x42F0E1EBA9EA3693
"""Polynomial of the CRC-64 checksum of ECMA-182.

The highest bit comes first, the initial value is zero, and the result is not inverted.
"""
LANES = 4096
"""Number of parts of a long body that are processed in parallel; a power of two.

A body of 2 MB takes 11 ms with 4096 parts, 19 ms with 1024 parts and 209 ms byte by byte.
"""
LONG = 2 * LANES
"""Body length [bytes] above which parts of the body are processed in parallel.

At this length, the parallel and the serial method take less than 2 ms each. The parallel method is
faster from about 16 kB on.
"""
MASK = 0xFFFFFFFFFFFFFFFF
"""Mask of the 64 bits of a remainder.

The mask is needed because Python integers are not limited to 64 bits.
"""
Words = NDArray[np.uint64]


def _table() -> Words:
    """Return the CRC remainder of each byte value followed by eight zero bytes, shape (256,)."""
    # the byte is in the highest of the 64 bits; each round divides one bit by the polynomial
    values = np.arange(256, dtype=np.uint64) << TOP
    for _ in range(8):
        values = (values << np.uint64(1)) ^ np.uint64(POLYNOMIAL) * (values >> np.uint64(63))
    return values


BYTE = np.uint64(8)
TOP = np.uint64(56)
TABLE = _table()
ENTRIES: list[int] = TABLE.tolist()
BITS: Words = np.arange(64, dtype=np.uint64)


def crc64(body: bytes | bytearray | memoryview) -> int:
    """Return the checksum of a message body.

    The checksum is a polynomial remainder, which is linear in the body. A long body is split into
    `LANES` parts. The remainders of the parts are computed in parallel and then joined in pairs.
    Before two remainders are joined, the first remainder is shifted by the length of the second
    part.
    """
    if len(body) < LONG:
        value = 0
        for byte in body:
            # the highest 8 of the 64 bits leave the remainder
            value = ((value << 8) & MASK) ^ ENTRIES[(value >> 56) ^ byte]
        return value
    width = -(-len(body) // LANES)
    padded = np.zeros(LANES * width, dtype=np.uint8)
    # leading zeros do not change the remainder
    padded[len(padded) - len(body) :] = np.frombuffer(body, dtype=np.uint8)
    found = np.zeros(LANES, dtype=np.uint64)
    # moved[i]: remainder of a body whose only set bit is i, advanced by the length of a part
    moved = np.uint64(1) << BITS
    for column in np.ascontiguousarray(padded.reshape(LANES, width).T):
        found = (found << BYTE) ^ TABLE[(found >> TOP) ^ column]
        moved = (moved << BYTE) ^ TABLE[moved >> TOP]
    while len(found) > 1:
        found = _through(moved, found[0::2]) ^ found[1::2]
        moved = _through(moved, moved)
    return int(found[0])


def _through(moved: Words, words: Words) -> Words:
    """Apply a linear map to 64-bit words. The map converts bit i to ``moved[i]``."""
    chosen = ((words[:, None] >> BITS) & np.uint64(1)) * moved
    return np.asarray(np.bitwise_xor.reduce(chosen, axis=1))


HEADER = struct.Struct(">H12s20sIIQQ")
HEADER_BYTES = HEADER.size
EXTENDED = struct.Struct(">HHII")
"""Format of the extended header.

Its fields are the sizes of the extended header, the metadata header and the metadata, and the
number of the message.
"""
ENTRY = struct.Struct(">HHI")
"""Format of a metadata entry: length of the key, encoding and length of the value."""
NEWEST = 3
"""Highest header version with a known layout. Versions from 2 on have an extended header."""
STATUS_OK = 1
STATUS_SHUT_DOWN = 19
ASCII = 3
UTF8 = 106
"""IANA number of the text encoding UTF-8; `ASCII` is the number of ASCII."""
LONGEST_TEXT = 0xFFFF
"""Largest length of a text that the 16 bits of its length field can hold [bytes]."""
SCALARS = {"i1": 2, "u1": 3, "i2": 4, "u2": 5, "i4": 6, "u4": 7, "f4": 10, "f8": 11}
"""Numbers of the scalar types in messages, keyed by the type codes of NumPy."""
NEWTON = 0x0B << 54 | 1 << 50
NEWTON_METRE = NEWTON | 0x01 << 44 | 1 << 40
"""Code of the unit N m; `NEWTON` is the code of the unit N.

From the highest bits on, a code contains pairs of a unit (6 bits) and its exponent (4 bits).
"""
POINT_SCALARS = 0x00
LITTLE = 2
RAS = 1
"""Code of the frame RAS of an image; `LITTLE` is the code of little-endian voxels.

Only the voxels of an image are little-endian.
"""


class IgtlError(ValueError):
    """Error for bytes that are not an OpenIGTLink message.

    The message of the error is only part of a sentence; the caller completes the sentence.
    """


@dataclass(frozen=True)
class Header:
    """Header of a message.

    Attributes
    ----------
    version
        1 for a message without extended header and metadata, 2 or more for a message with both.
    kind, name
        Type of the message, and name of the sending device.
    time_s
        Time of sending, in seconds since 1970.
    body_bytes, crc
        Length and checksum of the body.
    """

    version: int
    kind: str
    name: str
    time_s: float
    body_bytes: int
    crc: int


def packed(
    kind: str,
    name: str,
    body: bytes,
    *,
    time_s: float,
    metadata: Mapping[str, str] | None = None,
    number: int = 0,
) -> bytes:
    """Return a whole message.

    If metadata is given, the header has version 2 and ``number`` is stored as the message ID.
    """
    version = 1
    if metadata is not None:
        version = 2
        texts = [(key.encode(), *_encoded(value)) for key, value in metadata.items()]
        index = struct.pack(">H", len(texts)) + b"".join(
            ENTRY.pack(len(k), code, len(v)) for k, code, v in texts
        )
        values = b"".join(key + value for key, _, value in texts)
        body = EXTENDED.pack(EXTENDED.size, len(index), len(values), number) + body + index + values
    seconds = int(time_s)
    # the header counts fractions of a second in units of 2**-32 s
    fraction = int((time_s - seconds) * 2**32)
    return (
        HEADER.pack(
            version,
            kind.encode("ascii", "replace"),
            name.encode("ascii", "replace"),
            seconds,
            fraction,
            len(body),
            crc64(body),
        )
        + body
    )


def parse_header(header: bytes | bytearray) -> Header:
    """Parse the header in the first bytes of a message.

    Raises
    ------
    IgtlError
        If the bytes are not a header.
    """
    version, kind, name, seconds, fraction, size, crc = HEADER.unpack(header[:HEADER_BYTES])
    if not 1 <= version <= NEWEST:
        raise IgtlError(f"a header of version {version}")
    kind, name = (text.split(b"\0")[0].decode("ascii", "replace").strip() for text in (kind, name))
    if not kind or not (kind + name).isascii() or not (kind + name).isprintable():
        raise IgtlError("a header whose type or name is not ASCII text")
    # fractions of a second in units of 2**-32 s
    return Header(version, kind, name, seconds + fraction / 2**32, size, crc)


def content_of(header: Header, body: bytes | bytearray) -> bytes:
    """Return the content of a message, without extended header and metadata.

    Raises
    ------
    IgtlError
        If the checksum does not match, or the sizes contradict each other.
    """
    if crc64(body) != header.crc:
        raise IgtlError("a message whose checksum does not match its body")
    # version 1 has no extended header
    if header.version == 1:
        return bytes(body)
    # a body that is too short for the extended header is padded with zeros; the check below then
    # finds a size of 0 and raises an error
    first, index, values, _ = EXTENDED.unpack(body[: EXTENDED.size].ljust(EXTENDED.size, b"\0"))
    last = len(body) - index - values
    if not EXTENDED.size <= first <= last:
        raise IgtlError("an extended header whose sizes do not match its message")
    return bytes(body[first:last])


def transform_body(matrix: ArrayLike) -> bytes:
    """Return the TRANSFORM body for a homogeneous matrix [mm], shape (4, 4).

    The body contains the columns of the matrix without its last row.
    """
    return np.asarray(matrix, dtype=float)[:3].T.astype(">f4").tobytes()


def parse_transform(content: bytes) -> Array:
    """Return the homogeneous matrix of a TRANSFORM [mm], shape (4, 4).

    Raises
    ------
    IgtlError
        If the content has the wrong length or is not finite.
    """
    # twelve float32: three columns of the rotation, and the position
    if len(content) != 48:
        raise IgtlError(f"a TRANSFORM of {len(content)} bytes instead of 48")
    values = np.frombuffer(content, ">f4")
    if not np.isfinite(values).all():
        raise IgtlError("a TRANSFORM with numbers that are not finite")
    matrix = np.eye(4)
    matrix[:3] = values.reshape(4, 3).T
    return matrix


def status_body(code: int, message: str, *, subcode: int = 0, name: str = "") -> bytes:
    """Return a STATUS body with a code such as `STATUS_OK` and a message."""
    return (
        struct.pack(">Hq20s", code, subcode, name.encode("ascii", "replace"))
        + message.encode("ascii", "replace")
        + b"\0"
    )


def string_body(text: str) -> bytes:
    """Return a STRING body in ASCII, or in UTF-8 if necessary, truncated to 65535 bytes."""
    code, encoded = _encoded(text)
    # "ignore" drops the last character if the limit cuts its bytes apart
    encoded = encoded[:LONGEST_TEXT].decode("utf-8", "ignore").encode()
    return struct.pack(">HH", code, len(encoded)) + encoded


def sensor_body(values: ArrayLike, unit: int) -> bytes:
    """Return a SENSOR body with at most 255 values in one common unit, such as `NEWTON`."""
    data = np.asarray(values, dtype=">f8").ravel()
    # one byte holds the number of values; the status byte is reserved and is 0
    return struct.pack(">BBQ", len(data), 0, unit) + data.tobytes()


def ndarray_body(values: ArrayLike) -> bytes:
    """Return an NDARRAY body of an array of numbers in C order (the last index varies fastest)."""
    data = np.asarray(values)
    head = struct.pack(f">BB{data.ndim}H", _scalar(data), data.ndim, *data.shape)
    return head + data.astype(data.dtype.newbyteorder(">")).tobytes()


def polydata_body(
    points_mm: ArrayLike,
    polygons: ArrayLike,
    *,
    scalars: Mapping[str, Floats] | None = None,
) -> bytes:
    """Return a POLYDATA body of polygons that all have the same number of points.

    Parameters
    ----------
    points_mm
        Points [mm], shape (n, 3).
    polygons
        Point indices of each polygon, shape (m, k).
    scalars
        Values at the points, shape (n,), keyed by name.
    """
    points = np.asarray(points_mm, dtype=">f4").reshape(-1, 3)
    corners = np.asarray(polygons)
    cells = np.insert(corners, 0, corners.shape[1], axis=1).astype(">u4")
    named = dict(scalars or {})
    # numbers and sizes of points, vertices, lines, polygons, strips and attributes; only points,
    # polygons and attributes are used
    counts = (len(points), 0, 0, 0, 0, len(cells), cells.nbytes, 0, 0, len(named))
    parts = [struct.pack(">10I", *counts), points.tobytes(), cells.tobytes()]
    parts += [struct.pack(">BBI", POINT_SCALARS, 1, len(values)) for values in named.values()]
    # the format pads the names to an even number of bytes
    names = b"".join(name.encode("ascii") + b"\0" for name in named)
    parts += [names + b"\0" * (len(names) % 2)]
    parts += [np.asarray(values, dtype=">f4").tobytes() for values in named.values()]
    return b"".join(parts)


def image_body(voxels: NDArray[np.generic], ijk_to_ras_mm: ArrayLike) -> bytes:
    """Return an IMAGE body of a scalar volume in RAS.

    Parameters
    ----------
    voxels
        Values of the voxels, indexed by i, j and k; shape (ni, nj, nk).
    ijk_to_ras_mm
        Homogeneous matrix from indices to positions [mm], shape (4, 4). The message gives the
        position of the volume's centre, not of its first voxel.
    """
    matrix = np.asarray(ijk_to_ras_mm, dtype=float)
    shape = voxels.shape
    # the index of the centre is half the index of the last voxel
    middle = matrix @ [*(0.5 * (np.array(shape) - 1.0)), 1.0]
    placed = np.concatenate([matrix[:3, :3].T.ravel(), middle[:3]]).astype(">f4")
    # version 1 of the format, one component per voxel
    head = struct.pack(">HBBBB3H", 1, 1, _scalar(voxels), LITTLE, RAS, *shape) + placed.tobytes()
    # the message contains the whole volume, so the sent part begins at index 0
    window = struct.pack(">6H", 0, 0, 0, *shape)
    return (
        head + window + voxels.astype(voxels.dtype.newbyteorder("<"), copy=False).tobytes(order="F")
    )


def _scalar(values: NDArray[np.generic]) -> int:
    """Return the number of the scalar type of an array in messages."""
    return SCALARS[f"{values.dtype.kind}{values.dtype.itemsize}"]


def _encoded(text: str) -> tuple[int, bytes]:
    """Return the IANA number of the encoding, and the encoded bytes of a text."""
    return (ASCII if text.isascii() else UTF8), text.encode()
