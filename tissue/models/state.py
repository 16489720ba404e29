"""Copies of the internal state of a model, for snapshots."""

from collections.abc import Iterable, Iterator, Mapping
from copy import deepcopy
from dataclasses import fields, is_dataclass
from hashlib import blake2b, file_digest
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from meshes.base.errors import InputError

State = dict[str, Any]
"""State of an object, keyed by name: numbers, arrays and other values that can be pickled."""


def copied(owner: object, names: Iterable[str]) -> State:
    """Return copies of some attributes of an object.

    If two attributes refer to one object, their copies in the result also refer to one object.
    """
    return deepcopy({name: getattr(owner, name) for name in names})


def put_back(owner: object, state: State) -> None:
    """Write copied attributes back to an object; the copied state is not changed.

    Arrays are written in place, because a device array or a view may share their memory.
    """
    for name, value in deepcopy(state).items():
        present = getattr(owner, name)
        if isinstance(present, np.ndarray) and present.shape == np.shape(value):
            present[...] = value
        else:
            setattr(owner, name, value)


def require_shapes(present: Mapping[str, Any], kept: Mapping[str, Any]) -> None:
    """Check that copied arrays have the shapes of the present arrays of a model.

    Raises
    ------
    InputError
        If a shape differs, because the copy belongs to a model with another mesh.
    """
    for name, array in present.items():
        if array.shape != kept[name].shape:
            raise InputError(
                "snapshot",
                f"be of the same mesh and tool ({len(array)} entries of {name})",
                f"another mesh or tool ({len(kept[name])} entries)",
                "make both loops from equal arguments",
            )


def fingerprint(*parts: object) -> str:
    """Return a short text that is equal for equal arguments, even in another process.

    The arguments may be numbers, texts, arrays, tables of a scene, dataclasses, and collections of
    such objects. Numbers of different types, such as 1 and 1.0, are treated as equal if their
    values are equal. For an absolute path, the content of the file or folder is used. For any other
    object, only the name of the class is used.
    """
    digest = blake2b(digest_size=16)
    for known in _plain(parts):
        digest.update(known)
        # Without a separator, the pairs (1, 23) and (12, 3) would be equal.
        digest.update(b"\0")
    return digest.hexdigest()


def _plain(part: object) -> Iterator[bytes]:
    """Yield the content of an argument of `fingerprint` as bytes."""
    if isinstance(part, BaseModel):
        part = {name: getattr(part, name) for name in type(part).model_fields}
    elif is_dataclass(part) and not isinstance(part, type):
        part = {each.name: getattr(part, each.name) for each in fields(part)}
    if isinstance(part, np.ndarray):
        yield f"{part.dtype}{part.shape}".encode()
        yield np.ascontiguousarray(part).tobytes()
    elif isinstance(part, Mapping):
        yield str(len(part)).encode()
        for name in sorted(part):
            yield str(name).encode()
            yield from _plain(part[name])
    elif isinstance(part, tuple | list):
        yield str(len(part)).encode()
        for each in part:
            yield from _plain(each)
    elif isinstance(part, str) and Path(part).is_absolute():
        yield from _contents(Path(part))
    elif isinstance(part, int | float | np.number):
        # 4 and 4.0 are equal arguments
        yield repr(float(part)).encode()
    elif part is None or isinstance(part, str):
        yield str(part).encode()
    else:
        yield type(part).__qualname__.encode()


def _contents(path: Path) -> Iterator[bytes]:
    """Yield the checksum of a file, or of every file in a folder (without subfolders)."""
    for each in sorted(path.iterdir()) if path.is_dir() else [path]:
        if each.is_file():
            with each.open("rb") as file:
                yield file_digest(file, "blake2b").digest()
