"""Slices stored as TIFF files, one or several to a file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, by

__all__ = ["read_tiff_slices"]


def read_tiff_slices(files: Sequence[Path]) -> NDArray[np.number]:
    """Grey values of TIFF slices in the order given, shape (columns, rows, slices)."""
    from skimage.io import imread

    planes = []
    for file in files:
        try:
            planes.append(np.atleast_3d(imread(file).T))
        except Exception as problem:  # the readers raise many kinds, none documented
            raise InputError(
                f"file must be a readable TIFF slice, got {file.name} (it is damaged or cut off): export it again"
            ) from problem
        if planes[-1].shape[:2] != planes[0].shape[:2]:
            raise InputError(
                f"slices must all have the same size, got {by(planes[-1].shape[:2])} in {file.name} "
                f"after {by(planes[0].shape[:2])}: keep other images out of the folder"
            )
    return np.concatenate(planes, axis=2)
