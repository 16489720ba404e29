"""Reading of the voxels of an image file, with checks of their size and checksum."""

import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from meshes.base.arrays import Floats, Numbers
from meshes.base.errors import InputError, by
from meshes.base.file_limits import require_memory, require_regular

_GZIP = b"\x1f\x8b"
_ZLIB_OR_GZIP = 47
"""Window argument of zlib: 15 for the largest window, plus 32 to detect zlib or gzip data."""
_DENSEST = 1100
"""Upper bound of inflated size / compressed size. The format deflate allows at most 1032."""
_PIECE = 1 << 17
"""Number of bytes read or inflated at once.

The number is small compared with the size of the voxel array, so the pieces need little memory.
"""


def first_bytes(path: Path, count: int) -> bytes:
    """Return the first bytes of a file, decompressed if the file is gzip.

    If the file is shorter, fewer bytes are returned.
    """
    found = b""
    for piece in _plain(path, 0, is_gzip(path)):
        found += piece
        if len(found) >= count:
            break
    return found[:count]


def read_voxels(
    path: Path,
    dtype: np.dtype[np.number],
    shape: tuple[int, ...],
    *,
    start: int = 0,
    skip: int = 0,
    compressed: bool,
) -> Numbers:
    """Read the rest of a file as a voxel array in which the first index varies fastest.

    Parameters
    ----------
    start
        Position [byte] in the file at which the data begins. If `compressed` is true, the data has
        the format zlib or gzip.
    skip
        Number of bytes before the voxels in the inflated data.

    Raises
    ------
    InputError
        If the file contains fewer or more bytes than the array needs, or is damaged.
    """
    needed = dtype.itemsize * int(np.prod(shape, dtype=object))
    require_regular(path)
    # Check the size before memory is allocated, because a damaged header may state any size.
    if needed > (_DENSEST if compressed else 1) * path.stat().st_size:
        raise _sizes_differ(path, needed, f"a file of {path.stat().st_size}")
    require_memory(needed, path.name, f"{by(shape)} voxels")
    stored = np.empty(needed, dtype=np.uint8)
    at = 0
    for piece in _plain(path, start, compressed):
        skipped = min(skip, len(piece))
        skip -= skipped
        piece = piece[skipped:]
        if at + len(piece) > needed:
            raise _sizes_differ(path, needed, "more")
        stored[at : at + len(piece)] = np.frombuffer(piece, dtype=np.uint8)
        at += len(piece)
    if at < needed:
        raise _sizes_differ(path, needed, str(at))
    return stored.view(dtype).reshape(shape, order="F").astype(dtype.newbyteorder("="), copy=False)


def scaled(values: Numbers, slope: float, intercept: float) -> Numbers:
    """Return values times slope plus intercept, in float32 or float64.

    If the slope is 1 and the intercept is 0, the values are returned unchanged.
    """
    if (slope, intercept) == (1.0, 0.0):
        return values
    # float32 represents every 16-bit value exactly.
    kind = np.float32 if values.dtype.itemsize <= 2 or values.dtype == np.float32 else np.float64
    found: Floats = values.astype(kind)
    found *= kind(slope)
    found += kind(intercept)
    return found


def is_gzip(path: Path) -> bool:
    """Return whether a file starts with the signature of gzip."""
    with path.open("rb") as stream:
        return stream.read(2) == _GZIP


def _plain(path: Path, start: int, compressed: bool) -> Iterator[bytes]:
    """Yield the bytes of a file from byte `start` in pieces, decompressed if required.

    The checksum of compressed data is verified.
    """
    with path.open("rb") as stream:
        stream.seek(start)
        if not compressed:
            while piece := stream.read(_PIECE):
                yield piece
            return
        inflate = zlib.decompressobj(_ZLIB_OR_GZIP)
        while packed := stream.read(_PIECE):
            while packed:
                try:
                    yield inflate.decompress(packed, _PIECE)
                except zlib.error as problem:
                    raise _damaged(path) from problem
                packed = inflate.unconsumed_tail
                if inflate.eof:
                    # gzip allows further members, and zeros at the end
                    packed = inflate.unused_data.lstrip(b"\0")
                    if not packed:
                        break
                    inflate = zlib.decompressobj(_ZLIB_OR_GZIP)
        if not inflate.eof:
            raise _damaged(path)


def _damaged(path: Path) -> InputError:
    found = f"{path.name}, whose compressed data are damaged or cut off"
    return InputError("file", "be complete", found, "export it again")


def _sizes_differ(path: Path, needed: int, found: str) -> InputError:
    requirement = f"contain the {needed} bytes of voxels that its header states"
    return InputError("file", requirement, f"{found} bytes in {path.name}", "export it again")
