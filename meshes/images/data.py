"""The voxels of an image file: as many as its header states, and where compressed with a
checksum that fits.
"""

import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, by
from meshes.base.file_limits import require_memory, require_regular

__all__ = ["first_bytes", "is_gzip", "read_voxels", "require_size", "require_stated", "scaled"]

_GZIP = b"\x1f\x8b"
_ZLIB_OR_GZIP = 47
_DENSEST = 1100
"""Deflate makes at most 1032 bytes of one."""
_PIECE = 1 << 17


def first_bytes(path: Path, count: int) -> bytes:
    """The first bytes of a file, decompressed where it starts as gzip does; fewer where it is
    shorter.
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
) -> NDArray[np.number]:
    """Read a file to its end as an array, first index fastest.

    Parameters
    ----------
    start
        Byte of the file at which its data, zlib or gzip where `compressed`, begin.
    skip
        Bytes of the inflated data before the voxels.

    Raises
    ------
    InputError
        If it holds fewer or more bytes than that, or is damaged.
    """
    needed = dtype.itemsize * int(np.prod(shape, dtype=object))
    require_stated(path, needed, by(shape), compressed=compressed)
    stored = np.empty(needed, dtype=np.uint8)
    at = 0
    for piece in _plain(path, start, compressed):
        piece, skip = piece[skip:], max(skip - len(piece), 0)
        if at + len(piece) > needed:
            raise _sizes_differ(path, needed, "more")
        stored[at : at + len(piece)] = np.frombuffer(piece, dtype=np.uint8)
        at += len(piece)
    if at < needed:
        raise _sizes_differ(path, needed, str(at))
    return stored.view(dtype).reshape(shape, order="F").astype(dtype.newbyteorder("="), copy=False)


def require_stated(path: Path, needed: int, shape: str, *, compressed: bool) -> None:
    """Refuse a header that states more bytes of voxels than its data file can hold, or than the
    memory limit allows.

    Parameters
    ----------
    path
        File that holds the voxels.
    needed
        Bytes of the voxels by the header.
    shape
        Voxels along the axes, for the message.
    compressed
        Whether the voxels are zlib or gzip.

    Raises
    ------
    InputError
        If it does, or if the path leads to no regular file.
    """
    require_regular(path)
    if needed > (_DENSEST if compressed else 1) * path.stat().st_size:
        raise _sizes_differ(path, needed, f"a file of {path.stat().st_size}")
    require_memory(needed, path.name, f"{shape} voxels")


def require_size(path: Path, start: int, needed: int, *, compressed: bool) -> None:
    """Refuse a file whose data from byte `start`, zlib or gzip where `compressed`, are not
    `needed` bytes.
    """
    found = 0 if compressed else max(path.stat().st_size - start, 0)
    for piece in _plain(path, start, True) if compressed else ():
        found += len(piece)
        if found > needed:
            raise _sizes_differ(path, needed, "more")
    if found != needed:
        raise _sizes_differ(path, needed, str(found))


def scaled(values: NDArray[np.number], slope: float, intercept: float) -> NDArray[np.number]:
    """Values times slope plus intercept; as they are where that changes nothing, else float32 or
    float64.
    """
    if (slope, intercept) == (1.0, 0.0):
        return values
    kind = np.float32 if values.dtype.itemsize <= 2 or values.dtype == np.float32 else np.float64
    found: NDArray[np.floating] = values.astype(kind)
    found *= kind(slope)
    found += kind(intercept)
    return found


def is_gzip(path: Path) -> bool:
    """Whether a file starts as gzip does."""
    with path.open("rb") as stream:
        return stream.read(2) == _GZIP


def _plain(path: Path, start: int, compressed: bool) -> Iterator[bytes]:
    """The bytes of a file from byte `start`, decompressed and held to their checksum, in pieces."""
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
                    # gzip allows further members, and zeros behind
                    packed = inflate.unused_data.lstrip(b"\0")
                    if not packed:
                        break
                    inflate = zlib.decompressobj(_ZLIB_OR_GZIP)
        if not inflate.eof:
            raise _damaged(path)


def _damaged(path: Path) -> InputError:
    found = f"{path.name} whose compressed data are damaged or cut off"
    return InputError("file", "be whole", found, "export it again")


def _sizes_differ(path: Path, needed: int, found: str) -> InputError:
    requirement = f"hold the {needed} bytes of voxels its header states"
    return InputError("file", requirement, f"{found} in {path.name}", "export it again")
