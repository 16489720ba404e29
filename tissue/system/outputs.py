"""What may be written where, so that nothing is lost unasked; and columns as a table."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file

__all__ = ["require_free_folder", "require_new_file", "write_columns"]


def require_new_file(path: Path, *, overwrite: bool) -> None:
    """Refuse a file that is there, unless it may be replaced.

    Raises
    ------
    InputError
        If it is there and may not, or is a folder.
    """
    if path.is_dir():
        raise InputError(f"out must be a file, got the folder {path}: add the name of a file")
    if path.exists() and not overwrite:
        raise InputError(f"out must not exist yet, got {path}: pass --overwrite or choose another --out")


def require_free_folder(folder: Path, names: Iterable[str], what: str, *, overwrite: bool) -> None:
    """Refuse a folder that is a file, or that holds one of these files and may not lose it; ``what`` they are.

    Raises
    ------
    InputError
        If it is one of both.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"out must be a folder, got the file {folder}: choose another --out")
    there = [name for name in names if (folder / name).exists()]
    if there and not overwrite:
        raise InputError(
            f"out must not hold another {what}, got {folder / there[0]}: pass --overwrite to replace it or choose "
            "another --out"
        )


def write_columns(path: Path, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns of equal length as CSV, by their names, with all digits."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    lines = [",".join(columns), *(",".join(map(repr, row)) for row in rows)]
    with whole_file(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", "utf-8")
