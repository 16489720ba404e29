"""Report on a saved run as one HTML file that needs no network."""

import json
import re
from base64 import b64encode
from collections.abc import Callable
from contextlib import nullcontext, suppress
from html import escape
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import package_version, require_new_file, write_text
from tissue.scene.texts import folders_of
from tissue.scene.used_constants import used_constants
from tissue.show.report.charts import Record, charts, encoded_columns
from tissue.show.report.page import (
    SECTION,
    assessment_section,
    band_section,
    events_table,
    figures_of,
    materials_table,
    notes_table,
    pictures_of,
    reproduce,
    status_of,
)
from tissue.show.report.stage import stage
from tissue.simulation.run_folder import SavedRun, added_to_run
from tissue.simulation.saved_fields import require_whole
from tissue.system.html import html_page

NAME = "report.html"
"""Name of the report in the folder of a run."""
SCRIPTS = ("decode", "moment", "charts", "surfaces", "stage", "report")
"""Scripts of this project in a report, in the order of their dependencies."""
PACKED = "data"
"""Key of encoded arrays in JSON. Folder names are not removed from these arrays."""
Clean = Callable[[str], str]
"""Function that removes the folders of files from a text."""


def write_report(
    folder: str | Path,
    out: str | Path | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    assessment: tuple[list[str], bytes] | None = None,
) -> Path:
    """Write the report on a run.

    Parameters
    ----------
    folder
        Folder of a finished or stopped run, written by `tissue run`.
    out
        HTML file to write. Default: ``report.html`` in the folder.
    overwrite
        Whether to replace an existing file.
    progress
        Function that is called with a description of the current work.
    assessment
        Lines and picture (PNG) of an assessment of the run. The assessment is a separate section.

    Returns
    -------
    Path of the written file.

    Raises
    ------
    InputError
        If the folder contains no run, if its files are damaged, if the file exists and `overwrite`
        is False, or if trame-vtk is missing.
    """
    report = progress or silent
    folder = Path(folder)
    out = folder / NAME if out is None else Path(out)
    scripts = viewer_scripts()
    saved = SavedRun(folder)
    if out.suffix != ".html":
        raise InputError(
            "out", "end in .html", out, f"choose for example {out.with_suffix('.html')}"
        )
    require_new_file(out, overwrite=overwrite)
    # In the folder of the run, the report counts as a file of the run, which a new run in this
    # folder removes.
    belongs = out.absolute().parent == folder.absolute() and out.name == NAME
    with added_to_run(folder) if belongs else nullcontext():
        report("reading the run", 0.0)
        require_whole(saved, surfaces=True)
        clean = _cleaner(saved)
        shown = _cleaned({"stage": stage(saved), **_trace(saved)}, clean)
        # reading and packing surfaces takes most of the time
        report("writing the report", 0.8)
        text = _html(saved, shown, scripts, clean, assessment)
        write_text(out, text)
    return out


def _trace(saved: SavedRun) -> dict[str, object]:
    if saved.trace is None or not len(saved.trace.rows):
        return {"trace": None, "charts": [], "events": []}
    return {
        "trace": encoded_columns(saved.trace),
        "charts": charts(saved.trace, saved.scene),
        "events": saved.summary.get("events", []),
    }


def _html(
    saved: SavedRun,
    data: Record,
    viewer: tuple[list[str], list[str]],
    clean: Clean,
    assessment: tuple[list[str], bytes] | None,
) -> str:
    """Return the content of the HTML file."""
    scene = saved.scene
    used = used_constants(scene, saved.summary.get("layers", ())) if scene is not None else []
    kept = saved.path / "scene.toml"
    scene_text = clean(kept.read_text("utf-8")) if kept.is_file() else ""

    def text(words: str) -> str:
        return escape(clean(words))

    body = [
        status_of(saved, text),
        figures_of(saved, text),
        "<h2>In 3D</h2>",
        _own("stage.html"),
        pictures_of(saved, SECTION),
        "<h2>Forces</h2>" + _own("charts.html")
        if data["trace"]
        else "<p>The run left no tick.</p>",
        "" if assessment is None else assessment_section(*assessment, text),
        band_section(saved, text),
        "<h2>Events</h2>" + events_table(saved.summary, text),
        "<h2>Notes</h2>" + notes_table(saved.summary, text),
        "<h2>Materials</h2>" + materials_table(used, text),
        reproduce(scene_text, _versions(saved), text),
        _data_element(data),
        "<!-- vtk.js, copyright Kitware Inc., BSD-3-Clause, as trame-vtk ships it -->",
    ]
    classic, modules = viewer
    load = "if (window.OfflineLocalView) window.loadDataSet?.();"
    return html_page(
        clean(str(saved.summary["scene"])),
        "\n".join(body),
        style=_own("report.css"),
        scripts=[_start(len(data["stage"]["parts"])), *classic, load],
        modules=[*modules, "\n".join(_own(f"{name}.js") for name in SCRIPTS)],
    )


def _cleaner(saved: SavedRun) -> Clean:
    """Return a function that replaces paths of files in a text by file names.

    A report is given to other people, and the name of a folder may be the name of a patient. Texts
    are cleaned before they are put into the page, not afterwards. The finished page contains markup
    and encoded arrays, in which a short folder name may occur by chance.
    """
    folders = folders_of(saved.scene) if saved.scene is not None else []

    def clean(text: str) -> str:
        for folder in folders:
            text = text.replace(folder, "")
            # as TOML and JSON write a backslash
            text = text.replace(folder.replace("\\", "\\\\"), "")
        return text

    return clean


def _cleaned(value: Any, clean: Clean) -> Any:
    """Return a JSON value with all texts cleaned, including keys, except encoded arrays."""
    if isinstance(value, str):
        return clean(value)
    if isinstance(value, dict):
        return {
            # encoded arrays may hold a short folder name by chance
            clean(key): each if key == PACKED and isinstance(each, str) else _cleaned(each, clean)
            for key, each in value.items()
        }
    if isinstance(value, list | tuple):
        return [_cleaned(each, clean) for each in value]
    return value


def _data_element(data: Record) -> str:
    """Return the HTML element that contains the data as JSON, escaped for HTML."""
    written = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    return f'<script type="application/json" id="report-data">{written}</script>'


def _start(part_count: int) -> str:
    """Return the script that passes an empty scene with a number of parts to vtk.js."""
    return (
        "window.global = window; window.loadDataSet = () => { window.loadDataSet = undefined; "
        "OfflineLocalView.load(document.getElementById('stage'), "
        f'{{ base64Str: "{empty_scene(part_count)}" }}); }};'
    )


def _own(name: str) -> str:
    return files("tissue.show.report").joinpath("browser", name).read_text("utf-8")


def _versions(saved: SavedRun) -> list[tuple[str, str]]:
    try:
        viewer = version("trame-vtk")
    except PackageNotFoundError:
        viewer = "unknown"
    return [
        ("tissue of the run", str(saved.summary.get("tissue", "unknown"))),
        ("tissue of this report", package_version()),
        ("machine of the run", str(saved.summary.get("machine", "unknown"))),
        ("computed on", str(saved.summary.get("compute", "unknown"))),
        ("3D view", f"vtk.js of trame-vtk {viewer}"),
    ]


STYLE_ELEMENT = "document.createElement('style')"
"""Call with which the viewer adds styles for its file dialogue.

The security policy of the page does not allow this call.
"""
ICONS = "https://kitware.github.io/vtk-js/icon/favicon-"
"""Beginning of the addresses of icons that the viewer would download."""


def viewer_scripts() -> tuple[list[str], list[str]]:
    """Return the classic scripts and the module scripts of the static viewer of trame-vtk.

    The scripts define ``OfflineLocalView``. The icons that the viewer would download are left out.

    Raises
    ------
    InputError
        If trame-vtk is missing, or its version does not contain this viewer (2.11.0 does not).
    """
    found = find_spec("trame_vtk")
    text = ""
    if found is not None and found.origin is not None:
        with suppress(FileNotFoundError):
            file = Path(found.origin).parent / "tools" / "static_viewer.html"
            text = file.read_text("utf-8")
    if "OfflineLocalView" not in text:
        raise InputError(
            "the report needs the vtk.js viewer of trame-vtk, which was not found. Run pip install "
            "-U trame-vtk"
        )
    classic: list[str] = []
    modules: list[str] = []
    for attributes, script in re.findall(r"<script\b([^>]*)>(.*?)</script>", text, re.DOTALL):
        kind = modules if "module" in attributes else classic
        without_icons = script.replace(ICONS, "data:,")
        kind.append(without_icons.replace(STYLE_ELEMENT, "document.createElement('template')"))
    return classic, modules


def empty_scene(parts: int) -> str:
    """Return a vtk.js scene whose parts have no points, as a zip file in base64.

    The parts have empty arrays of colours and normals.

    A script in the browser adds the points later. The scene is needed because the viewer makes the
    objects of vtk.js only from a scene.
    """
    record = json.loads(_own("scene.json"))
    (renderer,) = record["scene"]["dependencies"]
    for index in range(parts):
        renderer["dependencies"].append(json.loads(_own("actor.json").replace("INDEX", str(index))))
        renderer["calls"].append(["addViewProp", [f"instance:${{actor{index}}}"]])
    kept = BytesIO()
    with ZipFile(kept, "w", ZIP_DEFLATED) as archive:
        archive.writestr("index.json", json.dumps(record))
    return b64encode(kept.getvalue()).decode("ascii")
