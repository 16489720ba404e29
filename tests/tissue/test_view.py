"""`tissue view`: of whole and of stopped runs, with and without a display."""

import json
import shutil

import numpy as np
import pytest

from tissue import InputError, load_scene, simulate
from tissue.offscreen import display_problem
from tissue.view import view


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a quick run that ended."""
    scene = load_scene("milling", {"voxels.spacing_mm": 0.4, "duration_s": 0.3})
    return simulate(scene).save(tmp_path_factory.mktemp("runs") / "whole", pictures=False)


@pytest.fixture
def stopped(whole, tmp_path):
    """The same run as a kill would have left it: 150 rows and a half, no bone."""
    folder = tmp_path / "stopped"
    folder.mkdir()
    shutil.copy(whole / "scene.toml", folder)
    summary = json.loads((whole / "summary.json").read_text())
    (folder / "summary.json").write_text(
        json.dumps({"format": 1, "status": "running"} | {name: summary[name] for name in ("scene", "layers")})
    )
    lines = (whole / "trace.csv").read_text().splitlines(keepends=True)
    (folder / "trace.csv").write_text("".join(lines[:151]) + lines[151][:40])
    return folder


def _screenshot(folder, picture) -> str:
    """What `view` says; skips the test where no OpenGL works."""
    try:
        return view(folder, screenshot=picture)
    except InputError as problem:
        if "OpenGL" in str(problem):
            pytest.skip(str(problem))
        raise


def _colours(path) -> int:
    from PIL import Image

    with Image.open(path) as picture:
        assert picture.size == (1400, 950)
        return len(np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3)[::53], axis=0))


def test_screenshot_of_a_whole_run(whole, tmp_path):
    picture = tmp_path / "view.png"
    picture.write_bytes(b"an older picture")
    said = _screenshot(whole, picture)
    assert said.startswith("milling: 0.3 s, force up to ")
    assert said.endswith(f"screenshot in {picture}")
    assert _colours(picture) > 100


def test_a_stopped_run_says_so_and_shows_what_it_has(stopped, tmp_path):
    said = _screenshot(stopped, tmp_path / "view.png")
    assert said.splitlines()[0] == "run is incomplete: it stopped at 0.149 s of 0.3 s"
    assert _colours(tmp_path / "view.png") > 100


@pytest.mark.parametrize("rows", [0, 1])
def test_a_run_stopped_at_once_can_be_seen(stopped, tmp_path, rows):
    lines = (stopped / "trace.csv").read_text().splitlines(keepends=True)
    (stopped / "trace.csv").write_text("".join(lines[: 1 + rows]))
    (stopped / "scene.toml").unlink()
    said = _screenshot(stopped, tmp_path / "view.png")
    assert said.startswith(
        ("run is incomplete: it stopped before its first tick was written", "run is incomplete: it stopped at 0.000 s")[
            rows
        ]
    )


def test_without_a_display_the_remedy_is_a_screenshot(whole, monkeypatch):
    monkeypatch.setattr("tissue.offscreen.sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    assert display_problem() == "there is no display (DISPLAY is not set)"
    with pytest.raises(InputError, match=r"DISPLAY is not set\): pass --screenshot FILE$"):
        view(whole)


def test_a_folder_without_a_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="run must be a folder that `tissue run` wrote"):
        view(tmp_path, screenshot=tmp_path / "view.png")


@pytest.mark.parametrize(
    ("name", "message"), [("view.jpeg", "must be a .png file"), ("none/view.png", "must lie in an existing folder")]
)
def test_a_screenshot_needs_a_place(whole, tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        view(whole, screenshot=tmp_path / name)


def test_a_screenshot_that_cannot_be_drawn_leaves_no_file(whole, tmp_path, monkeypatch):
    monkeypatch.setattr("tissue.offscreen._windows", lambda: iter(()))
    with pytest.raises(InputError, match="screenshot must be drawn in 3D, but this machine has no OpenGL library"):
        view(whole, screenshot=tmp_path / "view.png")
    assert not (tmp_path / "view.png").exists()
