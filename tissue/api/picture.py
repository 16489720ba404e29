"""A still picture that a notebook shows by itself."""

from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.whole_file import whole_file

__all__ = ["Picture"]

WIDE_PX = 800
"""Widest that a notebook shows a picture [px]."""


class Picture:
    """A still picture: a notebook shows it, ``array`` has its pixels, `save` writes it.

    Parameters
    ----------
    png
        Contents of a PNG file.
    """

    def __init__(self, png: bytes) -> None:
        self._png = png

    @property
    def array(self) -> NDArray[np.uint8]:
        """Red, green and blue of its pixels, 0 to 255, shape (height, width, 3)."""
        from matplotlib.image import imread

        return np.rint(255.0 * imread(BytesIO(self._png), format="png")[..., :3]).astype(np.uint8)

    def save(self, path: str | Path) -> Path:
        """Write a PNG file; one that is there is replaced."""
        with whole_file(Path(path)) as temporary:
            temporary.write_bytes(self._png)
        return Path(path)

    def __repr__(self) -> str:
        height, width, _ = self.array.shape
        return f"<picture of {width} x {height} pixels>"

    def _repr_png_(self) -> tuple[bytes, dict[str, int]]:
        return self._png, {"width": min(self.array.shape[1], WIDE_PX)}
