"""Figures of a soft organ: under a press, and undeformed with its supports."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from tissue.fem.fields import FieldSeries, Frame
from tissue.scene.tool import Needle
from tissue.show.figures.figure import field_colours, field_words, halo
from tissue.show.figures.organ_surface import (
    SHOWN,
    at_nodes,
    drawn_surface,
    inclusions,
    section_cap,
    with_normals,
)
from tissue.show.figures.rendering import (
    FIELD_AMBIENT,
    Camera,
    Shaded,
    draw_axes,
    draw_shaded,
    paint,
)
from tissue.show.figures.tool_mesh import pose, row_at, tool_surface, tool_turns
from tissue.simulation.run import Run
from tissue.simulation.saved_fields import IN_MM, field_limits, field_values
from tissue.simulation.trace import Table
from tissue.simulation.vtk_files import CELL_TYPES, frame_mesh

if TYPE_CHECKING:
    import pyvista
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable

__all__ = ["draw_held", "draw_press"]


EYE = (0.25, -0.75, 0.62)
ACROSS = (0.0, -1.0, 0.0)
"""Directions to the eye: for the whole organ (lower than in `tissue view`), and for a section
(perpendicular to it).
"""
TOOL = (0.72, 0.72, 0.75)
INCLUSION = "#56B4E9"
"""Colours of the tool and of an inclusion's edge, which is visible on light and dark colours."""
NUDGE = (0.0, 1e-4, 0.0)
"""Distance between a section and the tip of the tool [mm]; with it, the section does not cut a row
of nodes.
"""
ABOVE = 0.2
"""Height of the drawn part of a needle above an organ, relative to the height of the organ."""
HEIGHTS_PX = 90, 150
"""Heights above and below the renderings [pixels]."""


@dataclass(frozen=True)
class _Shown:
    """Field of the picture: name, ends of the colour scale, and whether the organ is cut open."""

    name: str
    ends: tuple[float, float]
    opened: bool

    @property
    def colours(self) -> "ScalarMappable":
        """Mapping from values to colours; the scale is logarithmic if it begins above 0."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm, Normalize

        scale = LogNorm if self.ends[0] > 0.0 else Normalize
        return ScalarMappable(scale(*self.ends), field_colours(*self.ends))


def moment_of_press(series: FieldSeries, trace: Table) -> tuple[Frame | None, str]:
    """Return the frame (saved field) of a press to draw, and a text with the reason.

    If the organ has an inclusion, the frame is the one in which the tool is nearest to the
    inclusion. Otherwise it is the frame with the largest displacement. If nothing was displaced,
    the frame is None.
    """
    pressed = [frame for frame in series.frames if _largest(frame) > 0.0]
    if not pressed:
        return None, ""
    inclusion = inclusions(series.nodes_m[series.cells], series.layer)
    if not len(inclusion):
        return max(pressed, key=_largest), "the recorded frame with the largest displacement"
    middle = 1e3 * series.nodes_m[series.cells[inclusion]].mean(axis=(0, 1))
    tips = trace.vectors("tool", "mm")
    near = min(
        pressed, key=lambda frame: float(np.linalg.norm(tips[row_at(trace, frame.time_s)] - middle))
    )
    return near, f"the tool nearest to the {series.layer_names[series.layer[inclusion[0]]]}"


def draw_press(run: Run, path: Path) -> str | None:
    """Draw the deformed organ in the frame of `moment_of_press`, whole and cut open at the tool.

    Parameters
    ----------
    run
        A run with fields. Each frame has a displacement at the nodes and the von Mises stress in
        the cells.
    path
        File to write.

    Returns
    -------
    None, or the reason why the picture could not be drawn.
    """
    series = run.parts.fields
    trace = run.trace
    tool = tool_surface(run.scene.tool)
    # both pictures show the section along a needle from the front, because of the needle's track
    flat = isinstance(run.scene.tool, Needle)
    assert series is not None
    frame, why = moment_of_press(series, trace)
    if frame is None:
        return "nothing has moved"
    row = row_at(trace, frame.time_s)
    moved = _displacement(frame)
    mesh = frame_mesh(series, frame)
    unit_mm = np.float32(IN_MM[moved.rpartition("_")[2]])
    mesh.points = np.asarray(mesh.points) + unit_mm * mesh.point_data[moved]
    shown: list[_Shown] = []
    # one stress: there are two panels
    for name in (moved, *[name for name in frame.cells if name.startswith("von_mises_")][:1]):
        if (array := field_values(mesh, name)) is not None:
            shown.append(_Shown(name, field_limits(name, [array]), opened=flat or bool(shown)))
    tips = trace.vectors("tool", "mm")[row]
    eye = ACROSS if flat else EYE
    edge = _edge_of_inclusion(mesh, tips)

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        """Return the deformed organ, whole and cut open, with the tool."""
        import pyvista

        place = pose(tips, tool_turns(trace)[row])
        probe = pyvista.PolyData() if tool is None else tool.transform(place, inplace=False)
        surfaces = [_organ(mesh, each, tips, edge, eye) for each in shown]
        organ = np.asarray(surfaces[0].points)
        # a needle is several times as long as an organ is high, so with its shaft the organ would
        # be small
        if flat and probe.n_points:
            probe = probe.clip(
                normal="z", origin=(0.0, 0.0, organ[:, 2].max() + ABOVE * np.ptp(organ[:, 2]))
            )
        side = with_normals(probe) if probe.n_points else probe
        paint(side, np.tile(TOOL, (side.n_points, 1)))
        seen = np.vstack([organ, np.asarray(side.points).reshape(-1, 3)])
        camera = Camera.seeing(seen, eye, (0.0, 0.0, 1.0))
        return [(each.append_polydata(side) if side.n_cells else each, camera) for each in surfaces]

    def annotate(shaded: Shaded) -> None:
        """Name the inclusion, and draw a colour bar under each panel."""
        foot = HEIGHTS_PX[1] / shaded.size_px[1]
        for axes, each in zip(shaded.panels, shown, strict=True):
            left, _, wide, _ = axes.get_position().bounds
            if each.opened and edge is not None:
                _name_inclusion(axes, *edge, shaded.cameras[0])
            # in the upper part under each panel, with space for ticks and label below
            place = shaded.chart.add_axes(
                (left + 0.25 * wide, 0.66 * foot, 0.6 * wide, 0.16 * foot)
            )
            bar = shaded.chart.colorbar(each.colours, cax=place, orientation="horizontal")
            words = field_words(each.name)
            bar.set_label(words + (", cut open at the tool" if each.opened else ""))
            if each.ends[0] > 0.0:  # a logarithmic scale, whose default ticks would overlap
                # four ticks with two digits fit the width of the bar
                ticks = np.geomspace(*each.ends, 4).tolist()
                bar.set_ticks(ticks, labels=[f"{float(f'{tick:.2g}'):g}" for tick in ticks])
                bar.minorticks_off()
        draw_axes(shaded.chart.add_axes((0.0, 0.0, 0.12, foot)), "xyz", shaded.cameras[0])

    force = float(np.linalg.norm(trace.vectors("model_force", "N")[row]))
    title = f"{run.scene.name}: {force:.3g} N at {frame.time_s:.3f} s, {why}"
    if flat:
        modulus_kPa = run.scene.constants.values("soft", "liver")["modulus_kPa"]
        title += f"\nstress for soft.liver.modulus_kPa = {modulus_kPa:.3g}, "
        title += "not for the needle's constants"
    return draw_shaded(
        make, path, annotate, margins_px=HEIGHTS_PX, title=title, ambient=FIELD_AMBIENT
    )


def _organ(
    mesh: "pyvista.UnstructuredGrid",
    shown: _Shown,
    tip_mm: Array,
    edge: "tuple[str, pyvista.PolyData] | None",
    eye: tuple[float, ...],
) -> "pyvista.PolyData":
    """Return the organ in the colours of a field, with the outline of an inclusion.

    If `shown` requests it, the organ is cut open at the tool.
    """
    whole = drawn_surface(mesh, at_nodes(mesh, shown.name))
    parts = [whole]
    if shown.opened:
        place = tip_mm + NUDGE
        cap = section_cap(mesh, whole, shown.name, place_mm=place, normal=np.array(ACROSS))
        # The section is lit as if it faced the eye, so its colours are those of the scale.
        facing = (np.array(eye) / np.linalg.norm(eye)).astype(np.float32)
        cap.point_data["Normals"] = np.tile(facing, (cap.n_points, 1))
        parts = [whole.clip(normal=ACROSS, origin=tuple(place)), cap]
    for part in parts:
        values = np.maximum(np.asarray(part.point_data[SHOWN]), shown.ends[0])
        paint(part, np.asarray(shown.colours.to_rgba(values))[:, :3])
    if shown.opened and edge is not None:
        from matplotlib.colors import to_rgb

        # 0.25 % of the organ's diagonal, about two pixels of the picture
        tube = with_normals(edge[1].tube(radius=0.0025 * whole.length).triangulate())
        parts.append(paint(tube, np.tile(to_rgb(INCLUSION), (tube.n_points, 1))))
    return parts[0].append_polydata(*parts[1:]) if len(parts) > 1 else parts[0]


def _edge_of_inclusion(
    mesh: "pyvista.UnstructuredGrid", tip_mm: Array
) -> "tuple[str, pyvista.PolyData] | None":
    """Return the name and the outline of an inclusion in the section at the tool, or None."""
    names = tuple(str(name) for name in mesh.field_data["layer_names"])
    layer = np.asarray(mesh.cell_data["layer"])
    inside = inclusions(
        np.asarray(mesh.points)[mesh.cell_connectivity.reshape(mesh.n_cells, -1)], layer
    )
    if not len(inside):
        return None
    boundary = mesh.extract_cells(inside.tolist()).extract_surface(algorithm="dataset_surface")
    line = boundary.slice(normal=ACROSS, origin=tuple(tip_mm + NUDGE))
    return (names[layer[inside[0]]], line) if line.n_cells else None


def _name_inclusion(axes: "Axes", name: str, line: "pyvista.PolyData", camera: Camera) -> None:
    """Write the name of the inclusion below its outline."""
    pixels = camera.pixels(line.points)
    # the lowest point of the outline; y of pixels increases downward
    x, y = pixels[pixels[:, 1].argmax()]
    axes.text(x, y + 8.0, name, ha="center", va="top", size=9, color="0.1", path_effects=halo(2.5))


def _displacement(frame: Frame) -> str:
    lengths = (name for name in frame.points if name.startswith("displacement_"))
    return next((name for name in lengths if name.rpartition("_")[2] in IN_MM), "")


def _largest(frame: Frame) -> float:
    name = _displacement(frame)
    return float(np.linalg.norm(frame.points[name], axis=1).max(initial=0.0)) if name else 0.0


FREE = (0.93, 0.91, 0.87)
HELD = (0.902, 0.624, 0.0)
TOUCHABLE = (0.0, 0.447, 0.698)
EYES = {"from above": (0.25, -0.75, 0.62), "from below": (0.25, -0.75, -0.62)}
HELD_HEIGHTS_PX = 110, 80


def draw_held(run: Run, path: Path) -> str | None:
    """Draw the surface of an organ, with colours for held and for touchable parts.

    A triangle is coloured if all its nodes are held, or if the tool can touch all its nodes.

    Returns
    -------
    None, or the reason why the picture could not be drawn.
    """
    assert run.parts.fields is not None
    surface = _surface(run.parts.fields)

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        return [
            (surface, Camera.seeing(surface.points, eye, (0.0, 0.0, 1.0))) for eye in EYES.values()
        ]

    def annotate(shaded: Shaded) -> None:
        """Draw a legend of the held, the touchable and the free faces."""
        from matplotlib.patches import Patch

        named = {"held": HELD, "may be touched": TOUCHABLE, "free": FREE}
        # the two faces of a closed cut lie on each other, and neither can be seen
        middles_mm = np.round(surface.cell_centers().points, 3)
        _, place, count = np.unique(middles_mm, axis=0, return_inverse=True, return_counts=True)
        seen = surface.cell_data["colours"][count[place.ravel()] == 1]
        handles = [
            Patch(facecolor=colour, edgecolor="0.4", label=name)
            for name, colour in named.items()
            if (seen == np.rint(255.0 * np.array(colour))).all(axis=1).any()
        ]
        shaded.chart.legend(handles=handles, loc="lower center", ncols=3, frameon=False)

    title = f"{run.scene.name}: what holds the organ"
    return draw_shaded(
        make, path, annotate, margins_px=HELD_HEIGHTS_PX, title=title, names=list(EYES)
    )


def _surface(series: FieldSeries) -> "pyvista.PolyData":
    """Return the boundary with different colours for held triangles and triangles that can be
    touched.
    """
    import pyvista

    grid = pyvista.UnstructuredGrid(
        {CELL_TYPES[series.cells.shape[1]]: series.cells}, 1e3 * series.nodes_m
    )
    marks = {"touchable": TOUCHABLE, "held": HELD}
    nodes = np.arange(len(series.nodes_m))
    member = np.column_stack([np.isin(nodes, series.node_sets.get(name, ())) for name in marks])
    surface = drawn_surface(grid, member.astype(np.float32))
    colours = np.tile(FREE, (surface.n_cells, 1))
    # a triangle is coloured if all of its nodes belong to the set
    whole = np.asarray(surface.point_data[SHOWN])[surface.regular_faces].min(axis=1) == 1.0
    for index, colour in enumerate(marks.values()):
        colours[whole[:, index]] = colour
    return paint(surface, colours)
