"""A saved run as one HTML file that needs no network: written by `tissue report` and `tissue.report`."""

import json
from contextlib import nullcontext
from html import escape
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.file_version import package_version
from meshes.base.isolated_parser import parse_isolated
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.reporting.bands import band_section
from tissue.reporting.browser_viewer import empty_scene, viewer_scripts
from tissue.reporting.charts import charts, columns
from tissue.reporting.page import events_table, figures_of, materials_table, notes_table, reproduce, status_of
from tissue.reporting.stage import stage
from tissue.scene.texts import folders_of
from tissue.scene.used_constants import used_constants
from tissue.simulation.run_folder import SavedRun, added_to_run
from tissue.system.html import html_page
from tissue.system.outputs import require_new_file
from tissue.viewer.run import require_whole

__all__ = ["NAME", "write_report"]

NAME = "report.html"
"""File in a run's folder."""
SCRIPTS = ("decode", "moment", "charts", "surfaces", "stage", "report")
"""Our own scripts, in the order in which they need each other."""
POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
    "base-uri 'none'; form-action 'none'"
)
"""What a browser lets the file do: nothing of it may ask any host."""


def write_report(
    folder: str | Path, out: str | Path | None = None, *, overwrite: bool = False, progress: Progress | None = None
) -> Path:
    """Write a run's report.

    Parameters
    ----------
    folder
        Folder that `tissue run` wrote, of a run that ended or was stopped.
    out
        HTML file to write; without it ``report.html`` in the folder.
    overwrite
        Replace the file where it is there.
    progress
        Called with what is being done.

    Returns
    -------
    The file.

    Raises
    ------
    InputError
        If the folder holds no run or damaged files, the file is there, or trame-vtk is missing.
    """
    report = progress or silent
    folder = Path(folder)
    out = folder / NAME if out is None else Path(out)
    scripts = viewer_scripts()
    saved = SavedRun(folder)
    if out.suffix != ".html":
        raise InputError(f"out must end in .html, got {out}: choose for example {out.with_suffix('.html')}")
    require_new_file(out, overwrite=overwrite)
    # In the run's folder the report is one of the run's files, which a new run there removes.
    belongs = out.absolute().parent == folder.absolute() and out.name == NAME
    with added_to_run(folder) if belongs else nullcontext():
        report("reading the run", 0.0)
        _require_whole(saved)
        shown = stage(saved)
        report("writing the report", 0.8)
        text = _without_folders(saved, _html(saved, {"stage": shown, **_trace(saved)}, scripts))
        with whole_file(out) as temporary:
            temporary.write_text(text, "utf-8")
    return out


def _require_whole(saved: SavedRun) -> None:
    """Refuse files that are damaged, before VTK reads them in this process, which it could end."""
    require_whole(saved)
    surfaces = [saved.path / "bone.vtp", *sorted((saved.path / "carving").glob("*.vtp"))]
    there = {path.relative_to(saved.path).as_posix(): ["layer"] for path in surfaces if path.is_file()}
    if there:
        parse_isolated(
            "meshes.surfaces.vtk_reading:check_vtk",
            saved.path,
            what="folder of a run",
            remedy="run the scene again",
            arrays_by_file=there,
        )


def _trace(saved: SavedRun) -> dict[str, object]:
    if saved.trace is None or not len(saved.trace.rows):
        return {"trace": None, "charts": [], "events": []}
    return {
        "trace": columns(saved.trace),
        "charts": charts(saved.trace, saved.scene),
        "events": saved.summary.get("events", []),
    }


def _html(saved: SavedRun, data: dict[str, object], scripts: str) -> str:
    """The whole file."""
    scene = saved.scene
    used = used_constants(scene, saved.summary.get("layers", ())) if scene is not None else []
    kept = saved.path / "scene.toml"
    body = [
        status_of(saved),
        figures_of(saved),
        "<h2>In 3D</h2>",
        _own("stage.html"),
        "<h2>Forces</h2>" + _own("charts.html") if data["trace"] else "<p>The run left no tick.</p>",
        band_section(saved),
        "<h2>Events</h2>" + events_table(saved.summary),
        "<h2>Notes</h2>" + notes_table(saved.summary),
        "<h2>Materials</h2>" + materials_table(used),
        reproduce(saved, _without_folders(saved, kept.read_text("utf-8") if kept.is_file() else ""), _versions(saved)),
        _scripts(data, scripts),
    ]
    title = escape(str(saved.summary["scene"]))
    head = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}"><link rel="icon" href="data:,">'
    return html_page(title, "\n".join(body), style=_own("report.css"), head=head)


def _without_folders(saved: SavedRun, text: str) -> str:
    """A text with the names of files alone: a report is handed over, and folders may be named after a patient."""
    for folder in folders_of(saved.scene) if saved.scene is not None else ():
        for written in (folder, folder.replace("\\", "\\\\"), escape(folder)):  # as it is, in TOML and JSON, in HTML
            text = text.replace(written, "")
    return text


def _scripts(data: dict[str, object], viewer: str) -> str:
    """The data, vtk.js with an empty scene, and our scripts; no text of the run can end its element."""
    parts = data["stage"]["parts"]  # type: ignore[index]
    written = json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")
    start = (
        "window.global = window; window.loadDataSet = () => { window.loadDataSet = undefined; "
        "OfflineLocalView.load(document.getElementById('stage'), "
        f'{{ base64Str: "{empty_scene(len(parts))}" }}); }};'
    )
    scripts_text = "\n".join(_own(f"{name}.js") for name in SCRIPTS)
    return (
        f'<script type="application/json" id="report-data">{written}</script>\n<script>{start}</script>\n'
        "<!-- vtk.js, copyright Kitware Inc., BSD-3-Clause, as trame-vtk ships it -->\n"
        f"{viewer}\n<script>if (window.OfflineLocalView) window.loadDataSet?.();</script>\n"
        f'<script type="module">\n{scripts_text}\n</script>'
    )


def _own(name: str) -> str:
    return files("tissue.reporting").joinpath("browser", name).read_text("utf-8")


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
