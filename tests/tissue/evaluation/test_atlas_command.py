"""`tissue stability` without a scene: the atlas it writes, and what it refuses."""

import re

import numpy as np
import pytest


def test_an_atlas_of_two_pages_is_written_whole(command, here):
    code, out, error = command("stability", "--only", "smoothness", "--only", "damper_sign")
    assert (code, error) == (0, "")
    assert "2 of 2 pages show their boundary" in out
    folder = here / "atlas"
    html = (folder / "index.html").read_text("utf-8")
    assert html.startswith("<!doctype html>") and html.count("<section") == 2
    assert html.count("data:image/png;base64,") == 2 and "prefers-color-scheme: dark" in html
    # Nothing is fetched from anywhere: every link is a page of the atlas or a file beside it.
    links = re.findall(r'(?:href|src)="([^"]*)"', html)
    others = [link for link in links if not link.startswith(("#", "data:"))]
    assert others and all((folder / link).is_file() for link in others)
    assert not re.search(r"https?://|<script|@import|url\(", html)
    rows = np.genfromtxt(folder / "damper_sign_cycle.csv", delimiter=",", names=True)
    np.testing.assert_allclose(rows["ours_J"], -rows["theory_J"], rtol=1e-3, atol=1e-12)
    assert f"{1e6 * rows['printed_J'][-1]:.0f} µJ a cycle" in html  # the verdict is of these data


def test_an_atlas_is_not_written_over(command, here):
    (here / "kept").mkdir()
    (here / "kept" / "index.html").write_text("mine")
    code, _, error = command("stability", "--out", "kept", "--only", "smoothness")
    assert code == 2 and "got kept with index.html" in error
    assert command("stability", "--out", "kept", "--only", "smoothness", "--overwrite")[0] == 2
    assert (here / "kept" / "index.html").read_text() == "mine"
    assert command("stability", "--out", "made", "--only", "smoothness")[0] == 0
    code, _, error = command("stability", "--out", "made", "--only", "smoothness")
    assert code == 2 and "out must not hold another atlas" in error
    assert command("stability", "--out", "made", "--only", "smoothness", "--overwrite")[0] == 0
    assert "<section" in (here / "made" / "index.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--only", "nothing"), "only must be one of one_step_order, powers,"),
        (("--set", "device=omni"), "--set must go with a scene, got device=omni without one"),
        (("wall", "--only", "pade"), "--only must go without a scene, got pade with wall"),
        (("--out", "file"), "out must be a folder, got the file file"),
    ],
)
def test_what_makes_no_atlas_is_refused(command, here, arguments, sentence):
    (here / "file").write_text("")
    code, _, error = command("stability", *arguments)
    assert code == 2 and sentence in error.replace("\n", " ")
