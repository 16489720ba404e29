"""3D view of a report: bone or organ over time, tool, force and colour scales."""

from base64 import b64encode
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.show.figures.figure import BONE, COMPONENTS, DEPTH_COLOURS, field_colours, layer_colours
from tissue.show.figures.organ_surface import with_normals
from tissue.show.figures.tool_mesh import faces_of, turning_tool
from tissue.show.report.charts import Record, packed, packed_mesh, packed_shares, packed_vectors
from tissue.show.viewer.saved_surfaces import (
    Plane,
    bone_of,
    cut_plane,
    saved_fields,
    tool_force,
)
from tissue.simulation.run_folder import SavedRun, saved_placement
from tissue.simulation.saved_fields import SavedFields, field_label, field_values
from tissue.simulation.trace import Table
from tissue.simulation.vtk_files import in_scene, read_collection

if TYPE_CHECKING:
    import pyvista

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
MOST_MOMENTS = 40
"""Largest number of times at which the bone of an incomplete run is shown.

The report contains a surface of the carved bone for each of these times.
"""
LONGEST = 0.3
"""Length of the arrow for the largest force, relative to the size of the touched object."""
UNCUT = 0.02
"""Removed depth, relative to the deepest cut, below which bone counts as uncut."""


def stage(saved: SavedRun) -> Record:
    """Return the record (`Record`) from which the browser builds the 3D view.

    ``parts`` contains the surfaces as they change over time; ``scales`` contains their colour
    scales. ``bounds`` contains, for each group of parts, the box that must be in view [mm]. If the
    trace has rows, the record also contains the poses of the tool (``poses``), the scale of the
    force arrow (``force``), and the row of the largest force (``peak_row``).
    """
    scene = saved.scene
    trace = saved.trace if saved.trace is not None and len(saved.trace.rows) else None
    bone = list(_bone_moments(saved))
    fields = saved_fields(saved)
    record: Record = {
        "parts": [],
        "scales": [],
        "open": scene is not None and not isinstance(scene.tool, Probe),
    }
    seen: dict[str, list[Array]] = {}
    if bone:
        seen["bone"] = _add_bone(record, bone)
    if fields is not None:
        _add_fields(record, fields, cut_plane(saved, fields))
        seen["field"] = [np.asarray(fields.frames[0].points)]
    touched = next(iter(seen.values()), [np.zeros((1, 3))])
    size_mm = float(np.linalg.norm(np.ptp(np.vstack(touched), axis=0)))
    around: list[Array] = []
    # faces are translucent, since the tool passes through them
    for name, face in faces_of(scene).items():
        colour = to_hex(layer_colours((name,))[name])
        record["parts"].append({**_still(face), "colour": colour, "opacity": 0.4, "label": name})
        around.append(np.asarray(face.points))
    if trace is not None:
        around += _add_tool(record, trace, scene, size_mm=size_mm)
    groups = seen or {"": []}
    record["bounds"] = {name: _ends([*points, *around]) for name, points in groups.items()}
    return record


def _ends(points_mm: list[Array]) -> list[list[float]]:
    """Return the lowest and the highest corner of the box around points [mm]."""
    # nothing is shown, so any box is valid
    if not points_mm:
        return [[-1.0] * 3, [1.0] * 3]
    points = np.vstack(points_mm)
    return [points.min(axis=0).tolist(), points.max(axis=0).tolist()]


def _add_tool(record: Record, trace: Table, scene: Scene | None, *, size_mm: float) -> list[Array]:
    """Add tool and device with their poses, the path of the tip, and the force arrow.

    The points that must be in view are returned [mm].
    """
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
    line = {"line": packed_vectors(path), "colour": PATH, "label": "path of the tip"}
    record["parts"].append(line)
    # at least 0.3 mm long in a run without tissue
    longest = LONGEST * max(size_mm, 1.0)
    force = tool_force(trace)
    row = int(np.linalg.norm(force, axis=1).argmax())
    largest = float(np.linalg.norm(force[row]))
    record["poses"] = poses
    record["force"] = {"largest_N": largest, "longest_mm": longest}
    record["peak_row"] = row
    # a run without force has an arrow of no length
    end = tips[row] + longest * force[row] / max(largest, 1e-9)
    return [path, np.stack([tips[row], end])]


def _still(surface: "pyvista.PolyData") -> Record:
    """Return the record of a surface that keeps its shape.

    The two sides of a sharp edge have separate points, because their normals differ.
    """
    surface = with_normals(surface.triangulate())
    mesh = packed_mesh(surface.points, surface.regular_faces)
    return {"times": [0.0], "meshes": [mesh], "frames": [{"mesh": 0}], "smooth": True}


def _bone_moments(saved: SavedRun) -> Iterator[tuple[float, bool, Any]]:
    """Yield time [s], kind and surface [mm] of each surface of the bone.

    The kind is True for the part of the bone that no cut changes. If a complete run has recorded
    surfaces, which are coarser than its voxels, these surfaces are used. Otherwise the cuts are
    replayed.
    """
    import pyvista

    index = saved.path / "carving.pvd"
    whole = saved.path / "bone.vtp"
    if saved.complete and (index.is_file() or whole.is_file()):
        placement = saved_placement(saved.path)
        entries = read_collection(index) if index.is_file() else [(0.0, 0, "bone.vtp")]
        read: dict[str, Any] = {}
        for time_s, part, name in entries:
            # a surface that does not change is listed at every moment
            if name not in read:
                read[name] = in_scene(pyvista.read(saved.path / name), placement)
                yield time_s, part == 1, read[name]
        return
    bone = bone_of(saved, saved.scene)
    if bone is None:
        return
    yield 0.0, True, bone.rest(bone.layers)
    times = np.zeros(1) if saved.trace is None else saved.trace["time_s"]
    last = max(len(times) - 1, 0)
    for tick in np.unique(np.linspace(0, last, MOST_MOMENTS).astype(int)).tolist():
        # moments without a change are left out, except the first
        if bone.at(tick) or tick == 0:
            yield float(times[tick]), False, bone.cut(bone.layers)


def _add_bone(record: Record, moments: list[tuple[float, bool, Any]]) -> list[Array]:
    """Add the surfaces of the bone over time; return the points that must be in view [mm].

    The surfaces can be coloured by removed depth and by layer. A bone without a cut is coloured by
    layer only.
    """
    surfaces = [surface for *_, surface in moments if surface.n_cells]
    deepest_mm = max(
        (float(each.point_data["removed_depth_mm"].max()) for each in surfaces), default=0.0
    )
    names = [str(name) for name in surfaces[0].field_data["layer_names"]] if surfaces else []
    layers = np.unique(np.concatenate([[], *(each.cell_data["layer"] for each in surfaces)]))
    if deepest_mm > 0.0:
        colours = _colours(DEPTH_COLOURS)
        colours[: round(UNCUT * len(colours))] = np.array(BONE)
        scale = _scale("removed depth", "mm", "depth", colours, (0.0, deepest_mm))
        record["scales"].append(scale | {"group": "bone", "on": "points"})
    record["scales"].append(_layer_scale(names, layers.astype(int).tolist(), group="bone"))
    for is_rest in (False, True):
        taken = [(time_s, surface) for time_s, rests, surface in moments if rests is is_rest]
        if not taken:
            continue
        meshes: list[Record] = []
        frames: list[Record] = []
        for _, surface in taken:
            # an empty surface has no array of shape (n, 3)
            triangles = surface.regular_faces if surface.n_cells else np.zeros((0, 3), dtype=int)
            # uncut bone has depth 0, and a share of it needs a divisor
            depth = np.asarray(surface.point_data.get("removed_depth_mm", []), dtype=np.float64)
            layer = np.asarray(surface.cell_data.get("layer", np.zeros(0)), dtype=np.uint8)
            frame = {"mesh": len(meshes), "layer": packed(layer)}
            frame["depth"] = packed_shares(depth / max(deepest_mm, 1e-9))
            frames.append(frame)
            meshes.append(packed_mesh(surface.points, triangles))
        part = {"group": "bone", "smooth": True, "times": [time_s for time_s, _ in taken]}
        record["parts"].append({**part, "meshes": meshes, "frames": frames})
    return [np.asarray(surface.points) for surface in surfaces]


def _add_fields(record: Record, fields: SavedFields, plane: Plane) -> None:
    """Add the surfaces of the deformed mesh, whole and cut open at a plane, with its fields."""
    first = fields.frames[0]
    has_layers = len(fields.layer_names) > 1
    for name in fields.names:
        limits = fields.limits(name)
        on = "cells" if name in first.cell_data else "points"
        scale = _scale(*field_label(name), name, _colours(field_colours(*limits)), limits)
        record["scales"].append(scale | {"group": "field", "on": on})
    # a single layer needs no colours of its own
    if has_layers:
        layers = np.unique(first.cell_data["layer"]).astype(int).tolist()
        record["scales"].append(_layer_scale(fields.layer_names, layers, group="field"))
    normal, origin = plane
    for is_open in (False, True):
        parts = [
            frame.clip(normal=normal, origin=origin) if is_open else frame
            for frame in fields.frames
        ]
        surfaces = [
            part.extract_surface(algorithm="dataset_surface").triangulate() for part in parts
        ]
        meshes: list[Record] = []
        frames: list[Record] = []
        for index, surface in enumerate(surfaces):
            # consecutive frames with the same triangles share a mesh
            if index == 0 or not _is_same(surfaces[index - 1], surface):
                meshes.append(packed_mesh(surface.points, surface.regular_faces))
            frame: Record = {"mesh": len(meshes) - 1}
            if fields.displacement is not None:
                frame["moved"] = packed_vectors(fields.moved_mm(surface))
            for name in fields.names:
                values = field_values(surface, name)
                if values is not None:
                    frame[name] = packed_shares(_shares(values, fields.limits(name)))
            if has_layers:
                frame["layer"] = packed(np.asarray(surface.cell_data["layer"], dtype=np.uint8))
            frames.append(frame)
        part = {"group": "field", "open": is_open, "blend": True, "times": fields.times_s.tolist()}
        record["parts"].append({**part, "meshes": meshes, "frames": frames})


def _shares(values: ArrayLike, limits: tuple[float, float]) -> Array:
    """Return the positions of values on their colour scale.

    The scale is logarithmic if it begins above 0.
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


def _layer_scale(names: Sequence[str], shown: Sequence[int], *, group: str) -> Record:
    """Return the colours of layers, and a legend with the shown layers."""
    colours = layer_colours(tuple(names))
    # an index of one byte
    table = np.zeros((256, 3))
    table[: len(names)] = np.array([colours[name] for name in names])
    legend = [[names[index], to_hex(colours[names[index]])] for index in shown]
    return _scale("layer", "", "layer", table) | {"names": legend, "group": group, "on": "cells"}


def _scale(
    label: str,
    unit: str,
    array: str,
    colours: Array,
    limits: tuple[float, float] | None = None,
) -> Record:
    """Return the record of a colour scale: label, unit, colours as bytes, and end values.

    The scale is logarithmic if it begins above 0.
    """
    table = b64encode(np.rint(255 * colours).astype(np.uint8).tobytes()).decode("ascii")
    record: Record = {"label": label, "unit": unit, "array": array, "colours": table}
    if limits is not None:
        low, high = limits
        record |= {"low": low, "high": high, "logarithmic": low > 0.0}
    return record


def _colours(name: str) -> Array:
    # matplotlib's maps have 256 colours
    return np.array(colormaps[name](np.linspace(0.0, 1.0, 256)))[:, :3]
