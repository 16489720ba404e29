"""Pictures of an organ: its parts and supports, and its displacement by a press."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.errors import InputError
from tissue.objects.progress import quiet_without_display

if TYPE_CHECKING:
    import pyvista

    from tissue.objects.organ import Organ
    from tissue.objects.press import Press

__all__ = ["plot_organ", "plot_press"]

TOOL = (0.45, 0.48, 0.52)
TISSUE = (0.93, 0.78, 0.72)
HELD = (0.35, 0.45, 0.6)
COLOURS = "YlOrRd"
"""Colour map that is light where the displacement is small."""
MATTE: Any = {
    "show_edges": True,
    "edge_opacity": 0.2,
    "ambient": 0.35,
    "diffuse": 0.7,
    "specular": 0.0,
}


@quiet_without_display()
def plot_press(press: Press, *, scalars: str = "displacement_mm", **options: Any) -> Any:
    """Show the pressed organ, cut open at the tool, with the outline of its parts and the tool.

    Parameters
    ----------
    press
        The press.
    scalars
        Field of its mesh for the colour; for a vector its length.
    options
        Options of ``pyvista.Plotter.show``; ``off_screen``, ``notebook`` and ``window_size`` are
        passed to the plotter.

    Raises
    ------
    InputError
        If the mesh has no such field.
    """
    from matplotlib import colormaps

    from tissue.show.figures.figure import field_words

    moved = press.mesh.copy()
    known = [*moved.point_data, *moved.cell_data]
    if scalars not in known:
        raise InputError("scalars", f"be one of {', '.join(known)}", scalars, "use displacement_mm")
    moved.points = moved.points + moved.point_data["displacement_mm"]
    data = moved.point_data if scalars in moved.point_data else moved.cell_data
    values = np.asarray(data[scalars])
    title = field_words(scalars)
    data[title] = values if values.ndim == 1 else np.linalg.norm(values, axis=1)
    across = _across(press.along)
    half = _shaded(moved.clip(normal=across, origin=press.at_mm))
    plotter = _plotter(options)
    bar: Any = {
        "title": title,
        "n_labels": 3,
        "vertical": True,
        "position_x": 0.86,
        "position_y": 0.2,
        "height": 0.6,
    }
    plotter.add_mesh(half, scalars=title, cmap=colormaps[COLOURS], scalar_bar_args=bar, **MATTE)
    part = np.asarray(moved.cell_data["part"])
    for number in np.unique(part[part > 0]):
        outline = (
            moved.extract_cells(part == number)
            .extract_surface(algorithm="dataset_surface")
            .slice(normal=across, origin=press.at_mm)
        )
        if outline.n_cells:
            outline.points = outline.points + 0.1 * across  # in front of the cut
            plotter.add_mesh(outline, color="black", line_width=2)
    plotter.add_mesh(press.tool_mesh, color=TOOL, smooth_shading=True)
    middle = np.asarray(moved.center)
    size = float(np.linalg.norm(np.ptp(moved.points, axis=0)))
    plotter.camera_position = [
        middle + size * (1.9 * across - 0.5 * press.along),
        middle,
        -press.along,
    ]
    plotter.add_text(
        f"{press.force_magnitude_N:.3g} N at {press.depth_mm[-1]:.3g} mm",
        font_size=11,
        color="black",
    )
    return plotter.show(**options)


@quiet_without_display()
def plot_organ(organ: Organ, **options: Any) -> Any:
    """Show an organ with a translucent outside, its parts and its supports.

    Parameters
    ----------
    organ
        The organ.
    options
        Options of ``pyvista.Plotter.show``; ``off_screen`` and ``notebook`` are passed to the
        plotter.
    """
    from tissue.show.figures.figure import OTHER_LAYERS

    grid = organ.mesh
    names = list(organ.moduli_kPa)
    plotter = _plotter(options)
    alone = len(names) == 1
    plotter.add_mesh(_shaded(grid), color=TISSUE, opacity=1.0 if alone else 0.35, **MATTE)
    for number, name in enumerate(names[1:], 1):
        part = grid.extract_cells(np.asarray(grid.cell_data["part"]) == number)
        colour = OTHER_LAYERS[-number % len(OTHER_LAYERS)]
        plotter.add_mesh(
            _shaded(part), color=colour, label=f"{name}: {organ.moduli_kPa[name]:g} kPa"
        )
    held = np.asarray(grid.points)[np.asarray(grid.point_data["held"])]
    plotter.add_points(held, color=HELD, point_size=7, render_points_as_spheres=True, label="held")
    plotter.add_legend(loc="upper left", face="circle", size=(0.3, 0.05 * (len(names) + 1)))  # type: ignore[call-arg]
    plotter.add_axes()  # type: ignore[call-arg]
    return plotter.show(**options)


def _across(along: Any) -> Any:
    """Return a direction perpendicular to a press, as close to -y as possible."""
    first = np.array([0.0, -1.0, 0.0]) if abs(along[1]) < 0.9 else np.array([1.0, 0.0, 0.0])
    first = first - (first @ along) * along
    return first / np.linalg.norm(first)


def _shaded(body: pyvista.DataSet) -> pyvista.PolyData:
    """Return the surface of a body with outward normals that keep its edges."""
    surface = body.extract_surface(algorithm="dataset_surface").triangulate()
    return surface.compute_normals(
        auto_orient_normals=True, split_vertices=True, feature_angle=40.0
    )


def _plotter(options: dict[str, Any]) -> pyvista.Plotter:
    """Return a plotter on white, and remove the plotter's options from those given."""
    import pyvista

    mine = {
        name: options.pop(name)
        for name in ("off_screen", "notebook", "window_size")
        if name in options
    }
    plotter = pyvista.Plotter(**mine)
    plotter.background_color = pyvista.Color("white")
    return plotter
