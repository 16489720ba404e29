"""Movies: their length, their pictures read back, and what cannot be written."""

import numpy as np
import pytest
from PIL import Image

from tissue import InputError
from tissue.show.viewer.window import FRAMES_PER_S, check_movie, movie_times_s, write_movie


def pictures(count, size=(64, 96)):
    """Pictures in plain colours, each brighter than the last."""
    for index in range(count):
        yield np.full((*size, 3), 20 * index + 20, dtype=np.uint8)


@pytest.mark.parametrize(("lasts_s", "shown_s"), [(0.5, 4.0), (6.0, 6.0), (90.0, 12.0)])
def test_a_movie_is_neither_short_nor_long(lasts_s, shown_s):
    times = movie_times_s(1.0, 1.0 + lasts_s)
    assert len(times) == round(shown_s * FRAMES_PER_S) + 1
    assert (times[0], times[-1]) == (1.0, 1.0 + lasts_s)
    assert np.ptp(np.diff(times)) < 1e-9


def test_a_gif_holds_every_picture_at_half_its_size(tmp_path):
    path = tmp_path / "run.gif"
    path.write_bytes(b"an older movie")
    write_movie(path, pictures(5))
    with Image.open(path) as movie:
        assert (movie.n_frames, movie.size, movie.info["duration"]) == (
            5,
            (48, 32),
            1000 // FRAMES_PER_S,
        )
        for index in range(5):
            movie.seek(index)
            assert np.asarray(movie.convert("RGB")).mean() == pytest.approx(20 * index + 20)
    assert [file.name for file in tmp_path.iterdir()] == ["run.gif"]


def test_an_mp4_holds_every_picture(tmp_path):
    pytest.importorskip("imageio_ffmpeg")
    import imageio.v2

    path = tmp_path / "run.mp4"
    check_movie(path)
    write_movie(path, pictures(8))
    read = [frame.mean() for frame in imageio.v2.get_reader(path)]
    # Colours are rounded twice in the codec.
    assert read == pytest.approx([20.0 * index + 20.0 for index in range(8)], abs=4.0)


def test_a_movie_needs_an_ending(tmp_path):
    with pytest.raises(InputError, match=r"movie .*run.avi. Use .*run.gif$"):
        check_movie(tmp_path / "run.avi")
