"""Figures of a soft organ: deformed by a tool, and undeformed with its supports."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array, Singles
from tissue.fem.fields import FieldSeries, Frame
from tissue.scene.tool import Needle
from tissue.show.figures.figure import EDGE, field_colours, field_words
from tissue.show.figures.organ_surface import (
    SHOWN,
    at_nodes,
    drawn_surface,
    inclusions,
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
from tissue.show.figures.tool_mesh import pose, row_at, tool_surface
from tissue.simulation.run import Run
from tissue.simulation.saved_fields import IN_MM, field_limits, field_values
from tissue.simulation.trace import Table
from tissue.simulation.vtk_files import CELL_TYPES, frame_mesh

if TYPE_CHECKING:
    import pyvista
    from matplotlib.cm import ScalarMappable

EYE = (0.25, -0.75, 0.62)
ACROSS = (0.0, -1.0, 0.0)
"""Direction to the camera for the section of an organ; `EYE` is the direction for the whole organ.
"""
TOOL = (0.72, 0.72, 0.75)
INCLUSION = (0.337, 0.706, 0.914)
"""Colour (red, green, blue) of an inclusion's outline; `TOOL` is the colour of the tool."""
NUDGE = (0.0, 1e-4, 0.0)
"""Shift of a section from the tip of the tool [mm]; the section then passes through no nodes."""
ABOVE = 0.2
"""Length of a needle that is drawn above an organ, relative to the height of the organ."""
HEIGHTS_PX = 90, 150
"""Heights of the margins above and below the renderings [pixels]."""


def moment_of_press(series: FieldSeries, trace: Table) -> tuple[Frame | None, str]:
    """Return the frame (saved fields at one time) to draw, and a text that explains the choice.

    If the organ has an inclusion, the frame is the one with the smallest distance between tool and
    inclusion. Otherwise the frame is the one with the largest displacement. If nothing was
    displaced, the frame is None.
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
    """Draw the deformed organ at the time from `moment_of_press`: whole, and cut open at the tool.

    The whole organ is coloured by displacement, and the section by von Mises stress. For a needle,
    both pictures show the section along the needle.

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
    along_needle = isinstance(run.scene.tool, Needle)
    eye = ACROSS if along_needle else EYE
    assert series is not None
    frame, why = moment_of_press(series, trace)
    if frame is None:
        return "nothing has moved"
    row = row_at(trace, frame.time_s)
    tip_mm = trace.vectors("tool", "mm")[row]
    moved = _displacement(frame)
    mesh = frame_mesh(series, frame)
    unit_mm = np.float32(IN_MM[moved.rpartition("_")[2]])
    mesh.points = np.asarray(mesh.points) + unit_mm * mesh.point_data[moved]
    stress = [name for name in frame.cells if name.startswith("von_mises_")][:1]
    found = {name: field_values(mesh, name) for name in (moved, *stress)}
    colours = [_colours(name, each) for name, each in found.items() if each is not None]
    names = [name for name, each in found.items() if each is not None]
    opened = [along_needle or index > 0 for index in range(len(names))]

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        """Return the deformed organ with the tool for each field."""
        import pyvista

        organs = []
        for name, mapped, is_open in zip(names, colours, opened, strict=True):
            body = drawn_surface(mesh, at_nodes(mesh, name))
            if is_open:
                body = _cut_open(mesh, body, name, tip_mm, eye)
            body = paint(body, np.asarray(mapped.to_rgba(body.point_data[SHOWN]))[:, :3])
            outline = _outline(mesh, tip_mm) if is_open else []
            organs.append(body.append_polydata(*outline) if outline else body)
        tool = tool_surface(run.scene.tool) or pyvista.PolyData()
        if tool.n_points:
            tool = tool.transform(pose(tip_mm, trace.quaternions()[row]), inplace=False)
            # a needle is several times as long as an organ is high
            if along_needle:
                low, high = organs[0].bounds[4:]
                tool = tool.clip(normal="z", origin=(0.0, 0.0, high + ABOVE * (high - low)))
            # the normals split points at sharp edges
            tool = with_normals(tool)
            tool = paint(tool, np.tile(TOOL, (tool.n_points, 1)))
        shown = [organ.append_polydata(tool) for organ in organs]
        camera = Camera.seeing(shown[0].points, eye, (0.0, 0.0, 1.0))
        return [(each, camera) for each in shown]

    def annotate(shaded: Shaded) -> None:
        """Draw a colour bar under each panel."""
        foot = HEIGHTS_PX[1] / shaded.size_px[1]
        for axes, name, mapped, is_open in zip(shaded.panels, names, colours, opened, strict=True):
            left, _, wide, _ = axes.get_position().bounds
            # in the upper part under each panel, with space for ticks and label below
            place = shaded.chart.add_axes(
                (left + 0.25 * wide, 0.66 * foot, 0.6 * wide, 0.16 * foot)
            )
            bar = shaded.chart.colorbar(mapped, cax=place, orientation="horizontal")
            bar.set_label(field_words(name) + (", cut open at the tool" if is_open else ""))
            low, high = mapped.get_clim()
            # the default ticks of a logarithmic scale would overlap
            if low is not None and high is not None and low > 0.0:
                ticks = np.geomspace(low, high, 4).tolist()
                bar.set_ticks(ticks, labels=[f"{float(f'{tick:.2g}'):g}" for tick in ticks])
                bar.minorticks_off()
        draw_axes(shaded.chart.add_axes((0.0, 0.0, 0.12, foot)), "xyz", shaded.cameras[0])

    force = float(np.linalg.norm(trace.vectors("model_force", "N")[row]))
    title = f"{run.scene.name}: {force:.3g} N at {frame.time_s:.3f} s, {why}"
    if along_needle:
        modulus_kPa = run.scene.constants.values("soft", "liver")["modulus_kPa"]
        title += f"\nstress for soft.liver.modulus_kPa = {modulus_kPa:.3g}, "
        title += "not for the needle's constants"
    return draw_shaded(
        make, path, annotate, margins_px=HEIGHTS_PX, title=title, ambient=FIELD_AMBIENT
    )


def _colours(name: str, values: Singles) -> "ScalarMappable":
    """Return the matplotlib object that maps the values of a field to colours.

    The scale is logarithmic if it begins above 0.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    ends = field_limits(name, [values])
    scale = LogNorm if ends[0] > 0.0 else Normalize
    return ScalarMappable(scale(*ends, clip=True), field_colours(*ends))


def _cut_open(
    mesh: "pyvista.UnstructuredGrid",
    boundary: "pyvista.PolyData",
    name: str,
    tip_mm: Array,
    eye: tuple[float, ...],
) -> "pyvista.PolyData":
    """Return the part of an organ's boundary behind the tool, closed by a section."""
    origin = tuple(tip_mm + NUDGE)
    body = mesh.copy(deep=False)
    body.clear_data()
    body.point_data[SHOWN] = at_nodes(mesh, name)
    # a triangle whose back faces the eye would be dark
    section = body.slice(normal=ACROSS, origin=origin).triangulate().flip_faces()
    # the section is lit as if it faced the eye, so its colours are those of the scale
    facing = np.array(eye, dtype=np.float32) / np.float32(np.linalg.norm(eye))
    section.point_data["Normals"] = np.tile(facing, (section.n_points, 1))
    # Linear elasticity can turn cells over at the tip of a needle, so that parts of the section
    # overlap. The part with the larger value is moved towards the eye, by up to 0.1 % of the
    # organ's size. Its place in the picture stays, because the projection is parallel.
    values = np.asarray(section.point_data[SHOWN], dtype=np.float64)
    forward = 0.001 * mesh.length * values / max(float(np.abs(values).max(initial=0.0)), 1e-30)
    section.points = section.points + forward[:, None] * facing
    return boundary.clip(normal=ACROSS, origin=origin).append_polydata(section)


def _outline(mesh: "pyvista.UnstructuredGrid", tip_mm: Array) -> "list[pyvista.PolyData]":
    """Return the outline of an inclusion in the section at the tool; empty if there is none."""
    corners = np.asarray(mesh.points)[mesh.cell_connectivity.reshape(mesh.n_cells, -1)]
    inside = inclusions(corners, np.asarray(mesh.cell_data["layer"]))
    body = mesh.extract_cells(inside.tolist()).extract_surface(algorithm="dataset_surface")
    line = body.slice(normal=ACROSS, origin=tuple(tip_mm + NUDGE))
    if not line.n_cells:
        return []
    # 0.25 % of the organ's diagonal, about two pixels of the picture
    tube = with_normals(line.tube(radius=0.0025 * mesh.length).triangulate())
    return [paint(tube, np.tile(INCLUSION, (tube.n_points, 1)))]


def _displacement(frame: Frame) -> str:
    lengths = (name for name in frame.points if name.startswith("displacement_"))
    return next((name for name in lengths if name.rpartition("_")[2] in IN_MM), "")


def _largest(frame: Frame) -> float:
    name = _displacement(frame)
    return float(np.linalg.norm(frame.points[name], axis=1).max(initial=0.0)) if name else 0.0


MARKS = {
    "free": (0.93, 0.91, 0.87),
    "may be touched": (0.0, 0.447, 0.698),
    "held": (0.902, 0.624, 0.0),
}
"""Colours (red, green, blue) of the parts of an organ's boundary, keyed by legend text."""
SETS = {"may be touched": "touchable", "held": "held"}
"""Name of the node set of each marked part of a boundary; later parts are drawn on top."""
EYES = {"from above": (0.25, -0.75, 0.62), "from below": (0.25, -0.75, -0.62)}
HELD_HEIGHTS_PX = 110, 80


def draw_held(run: Run, path: Path) -> str | None:
    """Draw the surface of an organ; colours mark where it is fixed and where the tool can touch it.

    A triangle is coloured if all its nodes are fixed, or if the tool can touch all its nodes.

    Returns
    -------
    None, or the reason why the picture could not be drawn.
    """
    import pyvista

    series = run.parts.fields
    assert series is not None
    kind = CELL_TYPES[series.cells.shape[1]]
    grid = pyvista.UnstructuredGrid({kind: series.cells}, 1e3 * series.nodes_m)
    nodes = np.arange(len(series.nodes_m))
    sets = [series.node_sets.get(name, ()) for name in SETS.values()]
    members = np.column_stack([np.isin(nodes, each) for each in sets])
    surface = drawn_surface(grid, members.astype(np.float32))
    whole = np.asarray(surface.point_data[SHOWN])[surface.regular_faces].min(axis=1) == 1.0
    colours = np.tile(MARKS["free"], (surface.n_cells, 1))
    for name, members in zip(SETS, whole.T, strict=True):
        colours[members] = MARKS[name]
    paint(surface, colours)

    def make() -> "list[tuple[pyvista.PolyData, Camera]]":
        return [
            (surface, Camera.seeing(surface.points, eye, (0.0, 0.0, 1.0))) for eye in EYES.values()
        ]

    def annotate(shaded: Shaded) -> None:
        """Draw a legend of the parts."""
        from matplotlib.patches import Patch

        handles = [
            Patch(facecolor=colour, label=name, **EDGE)
            for name, colour in MARKS.items()
            if (colours == colour).all(axis=1).any()
        ]
        shaded.chart.legend(handles=handles, loc="lower center", ncols=3, frameon=False)

    title = f"{run.scene.name}: supports of the organ"
    return draw_shaded(
        make, path, annotate, margins_px=HELD_HEIGHTS_PX, title=title, names=list(EYES)
    )
