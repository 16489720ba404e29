"""The report's 3D view: bone or organ over time, the tool on its path, what it meets, and its force."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from tissue.figures.faces import faces_of
from tissue.figures.style import COMPONENTS, layer_colours
from tissue.figures.tool_mesh import turning_tool
from tissue.reporting.packing import Record, packed_mesh, packed_vectors
from tissue.reporting.scales import hexadecimal
from tissue.reporting.surfaces import Shown, bone_shown, fields_shown
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields, field_names
from tissue.simulation.trace import Table

if TYPE_CHECKING:
    import pyvista

__all__ = ["stage"]

TOOL, DEVICE, PATH, FORCE = "#808080", "#D55E00", "#D55E00", COMPONENTS[0]
INSIDE_MM = 1e-4
"""How far beside the tool's deepest point an organ is cut open, so that the plane goes through no face of its mesh."""
MOST_POSES = 6000
"""Poses of the tool; between them the browser interpolates."""
MOST_POINTS = 3000
"""Points of the path that is drawn."""
EDGE_DEG = 35.0
"""Angle between triangles from which on they meet in an edge."""
LONGEST = 0.3
"""Length of the arrow of the greatest force, in sizes of what the tool meets."""


def stage(saved: SavedRun) -> Record:
    """The record that the browser shows in 3D.

    ``parts`` are surfaces over time, ``scales`` what their colours can mean, ``bounds`` what has to be seen of each
    group of parts [mm]; of a run with ticks also ``poses`` of the tool, ``force`` and ``peak_row``.
    """
    scene = saved.scene
    groups = {
        name: shown for name, shown in (("bone", bone_shown(saved)), ("field", _fields(saved))) if shown is not None
    }
    parts = [part for shown in groups.values() for part in shown.parts]
    around, faces = Shown(), faces_of(scene)
    for name, colour in layer_colours(tuple(faces)).items():
        parts.append({**_still(faces[name]), "colour": hexadecimal(colour), "opacity": 0.4, "label": name})
        around.see(faces[name].points)
    record: Record = {
        "parts": parts,
        "scales": [scale for shown in groups.values() for scale in shown.scales],
        "open": scene is not None and not isinstance(scene.tool, Probe),
    }
    if saved.trace is not None and len(saved.trace.rows):
        first = next(iter(groups.values()), around)
        size_mm = float(np.linalg.norm(np.ptp(np.vstack([np.zeros((1, 3)), first.points_mm]), axis=0)))
        _add_tool(record, saved.trace, scene, around, size_mm=size_mm)
    seen = {name: np.vstack([shown.points_mm, around.points_mm]) for name, shown in (groups or {"": around}).items()}
    return {**record, "bounds": {name: _ends(points) for name, points in seen.items()}}


def _ends(points_mm: NDArray[np.float64]) -> list[list[float]]:
    """Lowest and highest corner around points."""
    if not len(points_mm):
        return [[-1.0] * 3, [1.0] * 3]
    return [points_mm.min(axis=0).tolist(), points_mm.max(axis=0).tolist()]


def _fields(saved: SavedRun) -> Shown | None:
    if not field_names(saved.path):
        return None
    fields = SavedFields(saved.path)
    x, y, z = map(float, fields.frames[0].center)
    if saved.trace is not None and len(saved.trace.rows):
        y = float(saved.trace["tool_y_mm"][saved.trace["tool_z_mm"].argmin()])
    return fields_shown(fields, ((0.0, -1.0, 0.0), (x, y + INSIDE_MM, z)))


def _add_tool(record: Record, trace: Table, scene: Scene | None, around: Shown, *, size_mm: float) -> None:
    """The tool and its device with their poses, the path of the tip, and the arrow of the force."""
    import pyvista

    tips = trace.vectors("tool", "mm")
    every = max(-(-len(tips) // MOST_POSES), 1)
    rows = np.unique(np.append(np.arange(0, len(tips), every), len(tips) - 1))
    turns = np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"])
    surface = turning_tool(scene.tool if scene is not None else None)
    poses = {"rows": rows.tolist(), "tool": packed_vectors(tips[rows]), "turns": packed_vectors(turns[rows])}
    if "device_x_mm" in trace and scene is not None:
        device = tips[0] + scene.motion_scale * (trace.vectors("device", "mm") - tips[0])
        poses["device"] = packed_vectors(device[rows])
        if surface is not None:
            record["parts"].append({**_still(surface), "follows": "device", "colour": DEVICE, "opacity": 0.25,
                                    "label": "device"})  # fmt: skip
    if surface is not None:
        record["parts"].append({**_still(surface), "follows": "tool", "colour": TOOL, "opacity": 0.5, "label": "tool"})
    path = tips[np.unique(np.linspace(0, len(tips) - 1, MOST_POINTS).astype(int))]
    around.see(path)
    longest = LONGEST * max(size_mm, 1.0)
    record["parts"].append({"line": packed_vectors(path), "colour": PATH, "label": "path of the tip"})
    arrow = pyvista.Arrow(shaft_radius=0.025, tip_radius=0.06, tip_length=0.18).triangulate()
    record["parts"].append({**_still(arrow), "follows": "force", "colour": FORCE, "label": "force on the tool"})
    force = trace.vectors("model_force" if "model_force_x_N" in trace else "force", "N")
    row = int(np.linalg.norm(force, axis=1).argmax())
    greatest = float(np.linalg.norm(force[row]))
    around.see([tips[row], tips[row] + longest * force[row] / max(greatest, 1e-9)])
    record |= {"poses": poses, "force": {"greatest_N": greatest, "longest_mm": longest}, "peak_row": row}


def _still(surface: "pyvista.PolyData") -> Record:
    """One surface that keeps its shape, of its own points on either side of an edge."""
    surface = surface.triangulate().compute_normals(
        cell_normals=False, split_vertices=True, feature_angle=EDGE_DEG, consistent_normals=False
    )
    points: Any = surface.points
    mesh, _ = packed_mesh(points, surface.regular_faces)
    return {"times": [0.0], "meshes": [mesh], "frames": [{"mesh": 0}], "smooth": True}
