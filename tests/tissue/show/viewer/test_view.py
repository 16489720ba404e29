"""`tissue view`: pictures of whole runs, and drawings that are interrupted."""

from pathlib import Path

import numpy as np
import pytest

from tissue import InputError
from tissue.show.viewer.run_scene import Choice
from tissue.show.viewer.view import view


def _screenshot(folder, picture, **options) -> str:
    """Return the output of `view`; skip the test where OpenGL does not work."""
    try:
        return view(folder, screenshot=picture, **options)
    except InputError as problem:
        if "OpenGL" in str(problem):
            pytest.skip(str(problem))
        raise


@pytest.mark.slow
def test_screenshot_of_a_whole_run_has_a_scale_bar(whole, tmp_path):
    from PIL import Image

    picture = tmp_path / "view.png"
    picture.write_bytes(b"an older picture")
    with pytest.raises(InputError, match="screenshot"):
        _screenshot(whole, picture)
    report = _screenshot(whole, picture, overwrite=True)
    assert "milling" in report and str(picture) in report
    with Image.open(picture) as drawn:
        pixels = np.asarray(drawn.convert("RGB"), dtype=int)
    assert pixels.shape == (950, 1400, 3)
    assert len(np.unique(pixels.reshape(-1, 3)[::53], axis=0)) > 100
    rows = pixels[560:580, 30:300].max(axis=2) < 60  # 380 pixels above the lower edge of 950
    longest = max(np.count_nonzero(row) for row in rows)
    assert 60 < longest < 215


@pytest.mark.parametrize(("kind", "name"), [("movie", "run.gif"), ("screenshot", "run.png")])
@pytest.mark.parametrize("older", [b"an older one", None])
@pytest.mark.parametrize("ends", [KeyboardInterrupt(), "drawing was stopped"])
def test_what_is_not_drawn_to_its_end_leaves_no_file_and_keeps_an_older_one(
    whole, tmp_path, monkeypatch, kind, name, older, ends
):
    file = tmp_path / name
    if older is not None:
        file.write_bytes(older)

    def half(module, folder, kind, choice, into, **options):
        Path(into).write_bytes(b"half of it")
        options["drawn"](0.5)
        if isinstance(ends, str):
            return ends
        raise ends

    reported = []
    monkeypatch.setattr("tissue.show.viewer.view.draw_apart", half)
    # it starts a process each time
    monkeypatch.setattr("tissue.show.viewer.view.require_whole", lambda saved: None)
    with pytest.raises(KeyboardInterrupt if isinstance(ends, KeyboardInterrupt) else InputError):
        view(
            whole,
            **{kind: file},
            overwrite=True,
            progress=lambda doing, share: reported.append((doing, share)),
        )
    assert reported == [(f"drawing the {kind}", 0.0), (f"drawing the {kind}", 0.5)]
    assert [one.name for one in tmp_path.iterdir()] == ([] if older is None else [name])
    assert older is None or file.read_bytes() == older


def test_a_run_without_fields_is_shown_without_a_field(whole, tmp_path):
    with pytest.raises(InputError, match=r"got density_kg_m3. Leave it out: this run has no field"):
        view(whole, Choice(field="density_kg_m3"), screenshot=tmp_path / "run.png")
