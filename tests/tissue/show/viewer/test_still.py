"""Still pictures of a window, clean for a page."""

import numpy as np
import pytest

from tissue import InputError
from tissue.show.viewer.run_scene import Choice
from tissue.show.viewer.view import view


def _drawn(folder, file, **chosen):
    """Pixels of a picture; skips the test where no OpenGL works."""
    from PIL import Image

    try:
        view(folder, Choice(**chosen), screenshot=file)
    except InputError as problem:
        if "OpenGL" in str(problem):
            pytest.skip(str(problem))
        raise
    with Image.open(file) as picture:
        return np.asarray(picture)


@pytest.mark.slow
def test_a_clean_picture_shows_the_bone_alone(whole, tmp_path):
    pixels = _drawn(whole, tmp_path / "clean.png", clean=True)
    assert pixels.shape[2] == 4 and max(pixels.shape) > 1000
    there = pixels[..., 3] > 0
    assert (
        not there[:4].any()
        and not there[-4:].any()
        and not there[:, :4].any()
        and not there[:, -4:].any()
    )
    # One thing: a row through it is there without a gap, and most of the picture is filled.
    for line in (*there[:: len(there) // 9], *there.T[:: len(there.T) // 9]):
        assert np.count_nonzero(np.diff(line.astype(int)) == 1) <= 1
    assert there.mean() > 0.4
    shown = pixels[there][:, :3].astype(int)
    assert not (shown.max(axis=1) < 20).any()  # no black text
