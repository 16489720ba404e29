"""Report of a run as one file.

It contacts no host, holds the content of the run, and never reads text as markup.
"""

import json
import re
import shutil
from base64 import b64encode
from html.parser import HTMLParser

import numpy as np
import pytest

import tissue
from tissue.materials.constants import constants
from tissue.objects.run import report
from tissue.scene.load import load_scene
from tissue.scene.used_constants import used_constants

LARGEST_MB = 15.0


class Elements(HTMLParser):
    """Elements of a page with their attributes, and the text outside scripts and styles."""

    def __init__(self, page):
        super().__init__()
        self.found, self.text, self._within = [], [], []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))
        self._within.append(tag)

    def handle_endtag(self, tag):
        while self._within and self._within.pop() != tag:
            pass

    def handle_data(self, data):
        if not {"script", "style"} & set(self._within):
            self.text.append(data)


def data_of(page):
    return json.loads(
        re.search(r'<script type="application/json" id="report-data">(.*?)</script>', page)[1]
    )


@pytest.mark.parametrize("name", ["milling", "wall"])
def test_a_report_is_one_small_file_that_loads_nothing(report_of, name):
    page = report_of(name).read_text("utf-8")
    assert len(page) < 1e6 * LARGEST_MB
    elements = Elements(page)
    for tag, attributes in elements.found:
        for key in ("src", "href", "srcset", "action", "data", "poster"):
            assert (attributes.get(key) or "data:").startswith("data:"), (tag, attributes)
    policy = next(each["content"] for tag, each in elements.found if each.get("http-equiv"))
    assert (
        policy.startswith("default-src 'none'") and "http" not in policy and "unsafe" not in policy
    )
    assert "kitware.github.io/vtk-js/icon" not in page


def test_a_report_holds_what_the_run_holds(report_of, run_folder):
    page = report_of("milling").read_text("utf-8")
    text, data, saved = (
        " ".join(Elements(page).text),
        data_of(page),
        tissue.open_run(run_folder("milling")),
    )
    assert data["trace"]["rows"] == len(saved.trace.rows)
    assert {"force_x_N", "tool_x_mm", "removed_mm3"} <= set(data["trace"]["columns"])
    assert f"{saved.summary['force_N']['peak']:.3g} / " in text
    for note in saved.summary["notes"].values():
        assert str(note) in text
    # no power counts at the reference density
    for name, entry in constants("cutting", "bone").items():
        assert (entry.source in text) == (name != "density_exponent")
    assert saved.scene.description in text and 'kind = "block"' in text
    assert [scale["label"] for scale in data["stage"]["scales"]] == ["removed depth", "layer"]
    bone = next(part for part in data["stage"]["parts"] if part.get("group") == "bone")
    assert len(bone["frames"]) >= 3
    assert np.array(data["stage"]["bounds"]["bone"]).shape == (2, 3)


def test_a_report_has_the_section_of_its_run(run_folder, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run_folder("wall"), folder)
    (folder / "pictures").mkdir()
    (folder / "pictures" / "section.png").write_bytes(b"picture")
    page = report(folder, tmp_path / "report.html").read_text("utf-8")
    assert b64encode(b"picture").decode() in page
    assert "<figcaption>Section through the tool" in page


def test_text_of_a_run_is_never_markup(run_folder, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run_folder("wall"), folder)
    nasty = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    summary = json.loads((folder / "summary.json").read_text())
    summary |= {
        "scene": nasty,
        "events": [{"time_s": 0.1, "what": nasty}],
        "notes": {nasty: nasty},
        "machine": nasty,
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    scene = (folder / "scene.toml").read_text()
    (folder / "scene.toml").write_text(f"{scene}\n# {nasty}\n")
    page = report(folder).read_text("utf-8")
    elements = Elements(page)
    assert nasty in " ".join(elements.text)

    assert not [tag for tag, _ in elements.found if tag == "img"]
    plain = Elements(report(run_folder("wall"), tmp_path / "plain.html").read_text("utf-8"))
    assert [tag for tag, _ in elements.found].count("script") == [
        tag for tag, _ in plain.found
    ].count("script")
    assert data_of(page)["events"][0]["what"] == nasty


def test_a_run_that_was_stopped_has_a_report(run_folder, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run_folder("milling"), folder)
    for each in ("bone.vti", "bone.vtp", "bone.stl", "bone.nrrd", "carving.pvd"):
        (folder / each).unlink()
    shutil.rmtree(folder / "carving")
    summary = json.loads((folder / "summary.json").read_text())
    summary |= {"status": "failed", "problem": "a <b>bad</b> end"}
    (folder / "summary.json").write_text(json.dumps(summary))
    page = report(folder).read_text("utf-8")
    assert "a <b>bad</b> end" in " ".join(Elements(page).text)
    assert any(part.get("group") == "bone" for part in data_of(page)["stage"]["parts"])


@pytest.mark.parametrize(
    ("name", "layers", "tables"),
    [
        ("glenoid", ("cortical", "trabecular"), {"cutting, bone"}),
        ("liver-press", ("body",), {"soft, pressed liver"}),
        ("needle", ("capsule",), {"needle, liver", "needle, vessel wall", "soft, liver"}),
        ("wall", ("wall",), {"devices, touch", "hands, any", "hands, expert"}),
    ],
)
def test_constants_are_those_that_the_scene_rests_on(name, layers, tables):
    assert {one.of for one in used_constants(load_scene(name), layers)} == tables
