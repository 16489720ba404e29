"""Movies of a run, as GIF with nothing further installed or as MP4."""

import subprocess
from collections.abc import Iterable
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file

if TYPE_CHECKING:
    from PIL.Image import Image as Picture

__all__ = ["FRAMES_PER_S", "check_movie", "movie_times_s", "write_movie"]

FRAMES_PER_S = 20
"""Both kinds can hold it: a GIF counts in hundredths of a second."""
SHORTEST_S, LONGEST_S = 4.0, 12.0
"""A movie that would be shorter or longer plays slower or faster than it really was [s]."""
KINDS = (".mp4", ".gif")


def check_movie(path: Path) -> None:
    """Refuse a file that no movie can be written to.

    Raises
    ------
    InputError
        If its ending is not .mp4 or .gif, or .mp4 cannot be written here.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise InputError(f"movie must be a .mp4 or .gif file, got {path}: use {path.with_suffix('.gif')}")
    problem = _encoder_problem() if kind == ".mp4" else None
    if problem is not None:
        raise InputError(
            f"movie must be a .gif where {problem}, got {path}: use {path.with_suffix('.gif')} or pip install imageio "
            "imageio-ffmpeg"
        )


def _encoder_problem() -> str | None:
    """Why no MP4 can be encoded here, or None."""
    if find_spec("imageio") is None or find_spec("imageio_ffmpeg") is None:
        return "imageio and imageio-ffmpeg are not installed"
    import imageio_ffmpeg

    try:
        encoder = imageio_ffmpeg.get_ffmpeg_exe()
        subprocess.run([encoder, "-version"], check=True, capture_output=True, stdin=subprocess.DEVNULL, timeout=60.0)
    except (RuntimeError, OSError, subprocess.SubprocessError):
        return "imageio-ffmpeg has no ffmpeg that runs"
    return None


def movie_times_s(first_s: float, last_s: float) -> NDArray[np.float64]:
    """Moments of a movie's pictures [s]; it lasts as long as the run where that is between 4 and 12 s."""
    lasts = float(np.clip(last_s - first_s, SHORTEST_S, LONGEST_S))
    return np.linspace(first_s, last_s, round(lasts * FRAMES_PER_S) + 1)


def write_movie(path: Path, pictures: Iterable[NDArray[np.uint8]]) -> None:
    """Write a movie; an existing file is replaced once the new one is whole.

    Parameters
    ----------
    path
        File with the ending .mp4, or .gif of half the width and height.
    pictures
        Red, green and blue of every picture, shape (height, width, 3), both even.
    """
    with whole_file(path) as temporary:
        (_write_mp4 if path.suffix.lower() == ".mp4" else _write_gif)(temporary, pictures)


def _write_gif(path: Path, pictures: Iterable[NDArray[np.uint8]]) -> None:
    from PIL import Image

    def small(picture: NDArray[np.uint8]) -> "Picture":
        return Image.fromarray(picture).reduce(2).quantize(256, dither=Image.Dither.NONE)

    each = iter(pictures)
    small(next(each)).save(
        path,
        format="GIF",
        save_all=True,
        append_images=(small(picture) for picture in each),
        duration=1000 // FRAMES_PER_S,
        loop=0,
    )


def _write_mp4(path: Path, pictures: Iterable[NDArray[np.uint8]]) -> None:
    import imageio.v2
    from imageio.core.format import Format

    with imageio.v2.get_writer(path, fps=FRAMES_PER_S, quality=8, macro_block_size=2) as writer:
        assert isinstance(writer, Format.Writer)
        for picture in pictures:
            writer.append_data(picture)
