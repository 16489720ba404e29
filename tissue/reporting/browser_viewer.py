"""vtk.js as trame-vtk ships it, for a file that needs no network: its viewer's scripts and an empty scene for them."""

import json
import re
from base64 import b64encode
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

from meshes.base.errors import InputError

__all__ = ["empty_scene", "viewer_scripts"]

STYLE_ELEMENT = "document.createElement('style')"
"""Call by which the viewer adds styles for its own file dialogue, which the policy of a page does not allow."""
ICONS = "https://kitware.github.io/vtk-js/icon/favicon-"
"""Begin of the addresses of icons that the viewer would fetch."""


def viewer_scripts() -> tuple[list[str], list[str]]:
    """Return the classic and the module scripts of trame-vtk's static viewer, without the icons that it would fetch.

    They offer ``OfflineLocalView``.

    Raises
    ------
    InputError
        If trame-vtk is missing, or its version ships no such viewer (2.11.0 does not).
    """
    found = find_spec("trame_vtk")
    file = None if found is None or found.origin is None else Path(found.origin).parent / "tools" / "static_viewer.html"
    text = file.read_text("utf-8") if file is not None and file.is_file() else ""
    if "OfflineLocalView" not in text:
        raise InputError("report must have the vtk.js viewer of trame-vtk, got none: pip install -U trame-vtk")
    classic: list[str] = []
    modules: list[str] = []
    for attributes, script in re.findall(r"<script\b([^>]*)>(.*?)</script>", text, re.DOTALL):
        kind = modules if "module" in attributes else classic
        without_icons = script.replace(ICONS, "data:,")
        kind.append(without_icons.replace(STYLE_ELEMENT, "document.createElement('template')"))
    return classic, modules


def empty_scene(parts: int) -> str:
    """A scene of so many parts without points, each with colours at points and cells and normals, as base64 of a zip.

    The browser's script gives them their points: vtk.js makes objects only from such a scene.
    """
    actors = [_actor(index) for index in range(parts)]
    camera = {"id": "camera", "type": "vtkCamera", "properties": {}}
    renderer = {
        "id": "renderer",
        "type": "vtkRenderer",
        "properties": {"background": [1.0, 1.0, 1.0]},
        "dependencies": [camera, *actors],
        "calls": [
            ["setActiveCamera", ["instance:${camera}"]],
            *(["addViewProp", [f"instance:${{{actor['id']}}}"]] for actor in actors),
        ],
    }
    window = {
        "id": "window",
        "type": "vtkRenderWindow",
        "mtime": 1,
        "properties": {},
        "dependencies": [renderer],
        "calls": [["addRenderer", ["instance:${renderer}"]]],
    }
    content = {name: {"content": b64encode(bytes(12)).decode()} for name in ("Uint8Array", "Float32Array")}
    kept = BytesIO()
    with ZipFile(kept, "w", ZIP_DEFLATED) as archive:
        archive.writestr("index.json", json.dumps({"scene": window, "hashes": content}))
    return b64encode(kept.getvalue()).decode("ascii")


def _actor(index: int) -> dict[str, object]:
    arrays = (
        ("pointData", "setScalars", "Uint8Array"),
        ("cellData", "setScalars", "Uint8Array"),
        ("pointData", "setNormals", "Float32Array"),
    )
    fields = [
        {"name": f"{location} {setter}", "hash": kind, "vtkClass": "vtkDataArray", "dataType": kind,
         "numberOfComponents": 3, "location": location, "registration": setter}
        for location, setter, kind in arrays
    ]  # fmt: skip
    data = {"id": f"data{index}", "type": "vtkPolyData", "properties": {"fields": fields}}
    mapper = {
        "id": f"mapper{index}",
        "type": "vtkMapper",
        "properties": {},
        "dependencies": [data],
        "calls": [["setInputData", [f"instance:${{data{index}}}"]]],
    }
    property_ = {"id": f"property{index}", "type": "vtkProperty", "properties": {}}
    return {
        "id": f"actor{index}",
        "type": "vtkActor",
        "properties": {},
        "dependencies": [mapper, property_],
        "calls": [
            ["setMapper", [f"instance:${{mapper{index}}}"]],
            ["setProperty", [f"instance:${{property{index}}}"]],
        ],
    }
