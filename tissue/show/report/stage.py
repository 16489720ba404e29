"""3D view of a report: bone or organ over time, tool, force and colour scales."""

from base64 import b64encode
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.show.figures.figure import BONE, COMPONENTS, DEPTH_COLOURS, field_colours, layer_colours
from tissue.show.figures.organ_surface import with_normals
from tissue.show.figures.tool_mesh import faces_of, turning_tool
from tissue.show.report.charts import Record, packed, packed_mesh, packed_shares, packed_vectors
from tissue.show.viewer.saved_surfaces import bone_of, cut_plane, saved_fields, tool_force
from tissue.simulation.run_folder import SavedRun, saved_placement
from tissue.simulation.saved_fields import SavedFields, field_label, field_values
from tissue.simulation.trace import Table
from tissue.simulation.vtk_files import mesh_in_scene

if TYPE_CHECKING:
    import pyvista

__all__ = ["stage"]

TOOL = "#808080"
DEVICE = "#D55E00"
PATH = "#D55E00"
FORCE = COMPONENTS[0]
MOST_POSES = 6000
"""Largest number of poses of the tool (84 kB).

The browser interpolates between the poses.
"""
MOST_POINTS = 3000
"""Largest number of points of the drawn path, more than a screen has pixels across."""
LONGEST = 0.3
"""Ratio of the length of the arrow of the largest force to the size of the touched object."""


class Shown:
    """Surfaces over time, and their colour scales.

    Attributes
    ----------
    parts
        Records of surfaces with their times.
    scales
        Records of colour scales.
    points_mm
        Points that must be in view [mm], shape (n, 3).
    """

    def __init__(self) -> None:
        self.parts: list[Record] = []
        self.scales: list[Record] = []
        self.points_mm: Array = np.zeros((0, 3))

    def see(self, points: Any) -> None:
        """Add the lowest and the highest corner of the box around points [mm] to `points_mm`."""
        points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
        if len(points):
            self.points_mm = np.vstack([self.points_mm, points.min(axis=0), points.max(axis=0)])


def stage(saved: SavedRun) -> Record:
    """Return the record of the 3D view for the browser.

    ``parts`` contains surfaces over time, and ``scales`` their colour scales. ``bounds`` contains,
    for each group of parts, the box that must be in view [mm]. If the trace has rows, the record
    also contains the poses of the tool (``poses``), the scale of the force arrow (``force``), and
    the row of the largest force (``peak_row``).
    """
    scene = saved.scene
    fields = saved_fields(saved)
    groups: dict[str, Shown] = {}
    if (bone := bone_shown(saved)) is not None:
        groups["bone"] = bone
    if fields is not None:
        groups["field"] = fields_shown(fields, cut_plane(saved, fields))
    parts = [part for shown in groups.values() for part in shown.parts]
    around = Shown()
    faces = faces_of(scene)
    # faces are translucent, since the tool passes through them
    for name, colour in layer_colours(tuple(faces)).items():
        parts.append(
            {**_still(faces[name]), "colour": to_hex(colour), "opacity": 0.4, "label": name}
        )
        around.see(faces[name].points)
    record: Record = {
        "parts": parts,
        "scales": [scale for shown in groups.values() for scale in shown.scales],
        "open": scene is not None and not isinstance(scene.tool, Probe),
    }
    if saved.trace is not None and len(saved.trace.rows):
        first = next(iter(groups.values()), around)
        size_mm = float(
            np.linalg.norm(np.ptp(np.vstack([np.zeros((1, 3)), first.points_mm]), axis=0))
        )
        _add_tool(record, saved.trace, scene, around, size_mm=size_mm)
    seen = {
        name: np.vstack([shown.points_mm, around.points_mm])
        for name, shown in (groups or {"": around}).items()
    }
    return {**record, "bounds": {name: _ends(points) for name, points in seen.items()}}


def _ends(points_mm: Array) -> list[list[float]]:
    """Return the lowest and highest corner around points."""
    # nothing is shown, so any box is valid
    if not len(points_mm):
        return [[-1.0] * 3, [1.0] * 3]
    return [points_mm.min(axis=0).tolist(), points_mm.max(axis=0).tolist()]


def _add_tool(
    record: Record, trace: Table, scene: Scene | None, around: Shown, *, size_mm: float
) -> None:
    """Add tool and device with their poses, the path of the tip, and the force arrow."""
    import pyvista

    tips = trace.vectors("tool", "mm")
    rows = np.unique(np.linspace(0, len(tips) - 1, MOST_POSES).astype(int))
    surface = turning_tool(scene.tool if scene is not None else None)
    poses = {
        "rows": rows.tolist(),
        "tool": packed_vectors(tips[rows]),
        "turns": packed_vectors(trace.quaternions()[rows]),
    }
    followers: list[tuple[str, Any, str, float, str]] = []
    if "device_x_mm" in trace and scene is not None:
        device = tips[0] + scene.motion_scale * (trace.vectors("device", "mm") - tips[0])
        poses["device"] = packed_vectors(device[rows])
        # paler than the tool, with which it nearly coincides
        followers.append(("device", surface, DEVICE, 0.25, "device"))
    # length 1: the browser scales it to the force
    arrow = pyvista.Arrow(shaft_radius=0.025, tip_radius=0.06, tip_length=0.18).triangulate()
    followers.append(("tool", surface, TOOL, 0.5, "tool"))
    followers.append(("force", arrow, FORCE, 1.0, "force on the tool"))
    for follows, shape, colour, opacity, label in followers:
        if shape is not None:
            look = {"follows": follows, "colour": colour, "opacity": opacity, "label": label}
            record["parts"].append({**_still(shape), **look})
    path = tips[np.unique(np.linspace(0, len(tips) - 1, MOST_POINTS).astype(int))]
    around.see(path)
    line = {"line": packed_vectors(path), "colour": PATH, "label": "path of the tip"}
    record["parts"].append(line)
    # at least 0.3 mm long in a run without tissue
    longest = LONGEST * max(size_mm, 1.0)
    force = tool_force(trace)
    row = int(np.linalg.norm(force, axis=1).argmax())
    largest = float(np.linalg.norm(force[row]))
    # a run without force has an arrow of no length
    around.see([tips[row], tips[row] + longest * force[row] / max(largest, 1e-9)])
    record |= {
        "poses": poses,
        "force": {"largest_N": largest, "longest_mm": longest},
        "peak_row": row,
    }


def _still(surface: "pyvista.PolyData") -> Record:
    """Return the record of a surface that keeps its shape.

    The two sides of an edge have separate points.
    """
    surface = with_normals(surface.triangulate())
    mesh, _ = packed_mesh(surface.points, surface.regular_faces)
    return {"times": [0.0], "meshes": [mesh], "frames": [{"mesh": 0}], "smooth": True}


MOST_MOMENTS = 40
"""Largest number of times at which the bone of an incomplete run is shown.

The report contains a surface of the bone for each of these times.
"""


def bone_shown(saved: SavedRun) -> Shown | None:
    """Return the surfaces of the bone at the saved times; None for a run without bone.

    They can be coloured by removed depth and by layer.
    """
    moments = list(_bone_moments(saved))
    if not moments:
        return None
    surfaces = [surface for _, _, surface in moments]
    deepest = max(
        (float(one.point_data["removed_depth_mm"].max(initial=0.0)) for one in surfaces),
        default=0.0,
    )
    names = next((list(one.field_data["layer_names"]) for one in surfaces if one.n_cells), [])
    shown = Shown()
    layers = sorted(
        {int(layer) for one in surfaces for layer in np.unique(one.cell_data.get("layer", []))}
    )
    if deepest > 0.0:
        # a run without a cut is shown by layer only
        shown.scales.append({**depth_scale(deepest), "group": "bone", "on": "points"})
    shown.scales.append({**layer_scale(names, layers), "group": "bone", "on": "cells"})
    for part in (False, True):
        taken = [(time_s, surface) for time_s, is_rest, surface in moments if is_rest is part]
        if taken:
            shown.parts.append(
                # uncut bone has depth 0, and a share of it needs a divisor
                {"group": "bone", "smooth": True, **_moments_of_bone(taken, max(deepest, 1e-9))}
            )
    for surface in surfaces:
        shown.see(surface.points)
    return shown


def _bone_moments(saved: SavedRun) -> Iterator[tuple[float, bool, Any]]:
    """Return time [s], kind and surface [mm] of each surface.

    The kind is True for the part of the bone that no cut changes.
    """
    import pyvista

    placement = saved_placement(saved.path)
    index = saved.path / "carving.pvd"
    whole = saved.path / "bone.vtp"
    if saved.complete and (index.is_file() or whole.is_file()):
        entries = _entries(index) if index.is_file() else [(0.0, 0, "bone.vtp")]
        read: dict[str, Any] = {}
        for time_s, part, name in entries:
            # a surface that does not change is listed at every moment
            if name in read:
                continue
            read[name] = mesh_in_scene(pyvista.read(saved.path / name), placement)
            yield time_s, part == 1, read[name]
        return
    bone = bone_of(saved, saved.scene)
    if bone is None:
        return
    yield 0.0, True, bone.rest(bone.layers)
    times = np.zeros(1) if saved.trace is None else saved.trace["time_s"]
    for tick in np.unique(
        np.linspace(0, max(len(times) - 1, 0), MOST_MOMENTS).astype(int)
    ).tolist():
        # moments without a change are left out, except the first
        if bone.at(tick) or tick == 0:
            yield float(times[tick]), False, bone.cut(bone.layers)


def _entries(index: Path) -> list[tuple[float, int, str]]:
    """Read times [s], parts and files from ``carving.pvd``; refuse files outside the folder."""
    with suppress(ElementTree.ParseError, KeyError, ValueError, LookupError, OSError):
        root = ElementTree.fromstring(index.read_bytes())
        found = [
            (float(one.attrib["timestep"]), int(one.attrib["part"]), one.attrib["file"])
            for one in root.iter("DataSet")
        ]
        folder = index.parent.resolve()
        if all(
            (folder / name).resolve().is_relative_to(folder) and (folder / name).is_file()
            for *_, name in found
        ):
            return found
    raise InputError("carving.pvd", "be a ParaView collection", index, "run the scene again")


def _moments_of_bone(moments: Sequence[tuple[float, Any]], deepest_mm: float) -> Record:
    meshes: list[Record] = []
    frames: list[Record] = []
    for _, surface in moments:
        # an empty surface has no array of shape (n, 3)
        triangles = surface.regular_faces if surface.n_cells else np.zeros((0, 3), dtype=int)
        mesh, order = packed_mesh(surface.points, triangles)
        depth = np.asarray(surface.point_data["removed_depth_mm"])[order] / deepest_mm
        layer = np.asarray(surface.cell_data["layer"], dtype=np.uint8)
        frames.append({"mesh": len(meshes), "depth": packed_shares(depth), "layer": packed(layer)})
        meshes.append(mesh)
    return {"times": [time_s for time_s, _ in moments], "meshes": meshes, "frames": frames}


def fields_shown(fields: SavedFields, plane: tuple[Any, Any]) -> Shown:
    """Return the surfaces of the deformed mesh, whole and cut open at a plane, with its fields.

    The user can colour the surfaces by each field. The plane is given by a normal and a point [mm].
    """
    shown = Shown()
    first = fields.frames[0]
    for name in fields.names:
        on = "cells" if name in first.cell_data else "points"
        shown.scales.append({**field_scale(name, fields.limits(name)), "group": "field", "on": on})
    # a single layer needs no colours of its own
    if len(fields.layer_names) > 1:
        layers = sorted({int(layer) for layer in np.unique(first.cell_data["layer"])})
        shown.scales.append(
            {**layer_scale(fields.layer_names, layers), "group": "field", "on": "cells"}
        )
    normal, origin = plane
    for is_open in (False, True):
        meshes = [
            frame.clip(normal=normal, origin=origin) if is_open else frame
            for frame in fields.frames
        ]
        shown.parts.append(
            {"group": "field", "open": is_open, "blend": True, **_moments_of_fields(fields, meshes)}
        )
    shown.see(first.points)
    return shown


def _moments_of_fields(fields: SavedFields, parts: Sequence[Any]) -> Record:
    """Return the surfaces of all frames.

    Consecutive frames with the same triangles share a mesh.
    """
    surfaces = [part.extract_surface(algorithm="dataset_surface").triangulate() for part in parts]
    moved = [fields.moved_mm(surface) for surface in surfaces]
    meshes: list[Record] = []
    frames: list[Record] = []
    order = np.zeros(0, dtype=np.intp)
    for index, surface in enumerate(surfaces):
        if index == 0 or not _is_same(surfaces[index - 1], surface):
            mesh, order = packed_mesh(surface.points, surface.regular_faces)
            meshes.append(mesh)
        frame: Record = {"mesh": len(meshes) - 1}
        if fields.displacement is not None:
            frame["moved"] = packed_vectors(moved[index][order])
        for name in fields.names:
            values = field_values(surface, name)
            if values is not None:
                on_points = name in surface.point_data
                frame[name] = packed_shares(
                    _shares(values[order] if on_points else values, fields.limits(name))
                )
        if len(fields.layer_names) > 1:
            frame["layer"] = packed(np.asarray(surface.cell_data["layer"], dtype=np.uint8))
        frames.append(frame)
    return {"times": fields.times_s.tolist(), "meshes": meshes, "frames": frames}


def _shares(values: NDArray[Any], limits: tuple[float, float]) -> Array:
    """Return the positions of values on their colour scale, which is logarithmic if it begins above
    0.
    """
    low, high = limits
    values = np.asarray(values, dtype=np.float64)
    if low > 0.0:
        return np.asarray(np.log(np.maximum(values, low) / low) / np.log(high / low))
    return np.asarray((values - low) / (high - low))


def _is_same(a: Any, b: Any) -> bool:
    return bool(
        a.n_points == b.n_points
        and np.array_equal(a.faces, b.faces)
        # 0.1 um: the reference positions are equal up to rounding
        and np.allclose(a.points, b.points, atol=1e-4)
    )


UNCUT = 0.02
"""Removed depth, relative to the deepest cut, below which bone counts as uncut."""


def depth_scale(deepest_mm: float) -> Record:
    """Return the colour scale of removed depth; uncut bone has a separate colour."""
    colours = _colours(DEPTH_COLOURS)
    colours[: round(UNCUT * len(colours))] = np.array(BONE)
    return _scale("removed depth", "mm", "depth", colours) | _ends_of_scale(0.0, deepest_mm)


def field_scale(name: str, limits: tuple[float, float]) -> Record:
    """Return the colour scale of a field over the whole run, logarithmic if it begins above 0."""
    colours = _colours(field_colours(*limits))
    return _scale(*field_label(name), name, colours) | _ends_of_scale(*limits)


def layer_scale(names: Sequence[str], shown: Sequence[int]) -> Record:
    """Return the colours of layers, and a legend with the shown layers."""
    colours = layer_colours(tuple(names))
    # an index of one byte
    table = np.zeros((256, 3))
    table[: len(names)] = np.array([colours[name] for name in names])
    legend = [[names[index], to_hex(colours[names[index]])] for index in shown]
    return _scale("layer", "", "layer", table) | {"names": legend}


def _scale(label: str, unit: str, array: str, colours: Array) -> Record:
    """Return the record of a colour scale: its texts, and its colours as bytes."""
    table = b64encode(np.rint(255 * colours).astype(np.uint8).tobytes()).decode("ascii")
    return {"label": label, "unit": unit, "array": array, "colours": table}


def _ends_of_scale(low: float, high: float) -> Record:
    return {"low": low, "high": high, "logarithmic": low > 0.0}


def _colours(name: str) -> Array:
    # matplotlib's maps have 256 colours
    return np.array(colormaps[name](np.linspace(0.0, 1.0, 256)))[:, :3]
