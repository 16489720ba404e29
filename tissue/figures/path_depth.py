"""A toolpath on the bone, coloured by how deep below the surface it leads, and the depth along it."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.paths.toolpath import PathDepth
from meshes.surfaces.surface import Surface
from tissue.figures.figure import DRAWING, is_vector, save
from tissue.figures.marks import draw_axes, draw_scale
from tissue.figures.rendering import Camera, paint, render, side_by_side

__all__ = ["draw_path_depth"]

HEAD_PX, FOOT_PX, AXES_PX = 110, 330, 150
PLAIN = (0.93, 0.89, 0.81)
OUTSIDE, COLOURS = "0.45", "inferno_r"
AROUND_MM = 40.0
"""Half of the width of bone that is shown around the path at least."""


def draw_path_depth(
    surface: Surface, found: PathDepth, path: Path, *, normal: NDArray[np.float64], title: str
) -> str | None:
    """Draw the bone around a path, seen along the site's axis and from aside, with the path over it.

    Parameters
    ----------
    surface
        The bone in the frame of its image.
    found
        Points of the path and their depth, see `meshes.paths.toolpath.depth_along`.
    path
        File to write.
    normal
        Outward direction at the site, shape (3,).

    Returns
    -------
    None, or why it could not be drawn.
    """
    import pyvista

    points = found.points_mm
    mesh = pyvista.PolyData.from_regular_faces(1e3 * surface.vertices_m, surface.faces.astype(int))
    mesh = mesh.compute_normals(split_vertices=False)
    mesh = paint(mesh, np.tile(PLAIN, (mesh.n_points, 1)))
    upright = np.array([0.0, 0.0, 1.0]) if abs(normal[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    aside = np.cross(upright, normal)
    eyes = {"along the site's axis": normal, "from aside": aside + 0.25 * upright}
    half = max(AROUND_MM, 0.7 * float(np.ptp(points, axis=0).max()))
    corners = points.mean(axis=0) + half * (np.stack(np.meshgrid(*[[-1, 1]] * 3), axis=-1).reshape(-1, 3) * 0.6)
    cameras = [Camera.seeing(corners, eye, upright) for eye in eyes.values()]
    pictures = render(lambda: [(mesh, camera) for camera in cameras], fine=is_vector(path))
    if isinstance(pictures, str):
        return pictures
    with DRAWING:
        from matplotlib import colormaps
        from matplotlib.collections import LineCollection

        chart, panels, (wide, tall) = side_by_side(pictures, head_px=HEAD_PX, foot_px=FOOT_PX, fine=is_vector(path))
        chart.text(0.5, 1.0 - 35 / tall, title, ha="center", va="center", size=11)
        middle, deepest = 0.5 * (found.depth_mm[1:] + found.depth_mm[:-1]), max(found.deepest_mm, 1e-6)
        shades = colormaps[COLOURS](0.15 + 0.85 * np.clip(middle / deepest, 0.0, 1.0))
        inside = middle > 0.0
        for axes, name, camera in zip(panels, eyes, cameras, strict=True):
            axes.set_title(name, size=10)
            draw_scale(axes, camera)
            pixels = camera.pixels(points)
            pieces = np.stack([pixels[:-1], pixels[1:]], axis=1)
            axes.add_collection(LineCollection(list(pieces[~inside]), colors=OUTSIDE, linewidths=1.0))
            axes.add_collection(LineCollection(list(pieces[inside]), colors=shades[inside], linewidths=2.2))
        small = chart.add_axes((0.02, 0.02, AXES_PX / wide, AXES_PX / tall))
        draw_axes(small, ("left", "back", "head"), cameras[0])
        along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        low = chart.add_axes((0.2, 0.32 * FOOT_PX / tall, 0.75, 0.55 * FOOT_PX / tall))
        curve = np.stack([along, found.depth_mm], axis=1)
        pieces = np.stack([curve[:-1], curve[1:]], axis=1)
        low.axhline(0.0, color="0.3", linewidth=0.8)
        low.add_collection(LineCollection(list(pieces[~inside]), colors=OUTSIDE, linewidths=1.2))
        low.add_collection(LineCollection(list(pieces[inside]), colors=shades[inside], linewidths=2.0))
        low.autoscale_view()
        low.margins(x=0.0)
        low.invert_yaxis()
        low.set_xlabel("path length [mm]")
        low.set_ylabel("depth [mm]")
        low.set_title(f"deepest {found.deepest_mm:.1f} mm", loc="right", size=9)
        save(chart, path)
    return None
