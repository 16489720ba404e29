"""`tissue stability` without a scene: the atlas it writes, and what it refuses."""

import re

import numpy as np


def test_an_atlas_of_two_pages_is_written_whole(command, here):
    code, out, error = command("stability", "--only", "wild_input", "--only", "bad_tetrahedra")
    assert (code, error) == (0, "")
    assert "2 of 2 pages show the limit of their method" in out
    folder = here / "atlas"
    html = (folder / "index.html").read_text("utf-8")
    assert html.startswith("<!doctype html>") and html.count("<section") == 2
    assert html.count("data:image/png;base64,") == 2 and "prefers-color-scheme: dark" in html
    # Nothing is fetched from anywhere: every link is a page of the atlas or a file next to it.
    links = re.findall(r'(?:href|src)="([^"]*)"', html)
    others = [link for link in links if not link.startswith(("#", "data:"))]
    assert others and all((folder / link).is_file() for link in others)
    assert not re.search(r"https?://|<script|@import|url\(", html)
    rows = np.genfromtxt(folder / "wild_input_jump.csv", delimiter=",", names=True)
    np.testing.assert_allclose(rows["bare_N"], rows["theory_N"], rtol=0.01)
    assert f"{rows['bare_N'].max():.1e} N" in html  # the verdict is of these data
