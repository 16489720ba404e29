"""An imported bone in 3D, from the site's own direction and from aside, coloured by the density under its surface."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.images.frame import Image
from meshes.surfaces.surface import Surface
from tissue.figures.figure import DRAWING, is_vector, save
from tissue.figures.marks import draw_axes, draw_scale
from tissue.figures.rendering import Camera, paint, render, side_by_side

if TYPE_CHECKING:
    import pyvista
    from matplotlib.figure import Figure

__all__ = ["draw_ct_bone"]

HEAD_PX, FOOT_PX, AXES_PX = 110, 150, 150
PLAIN = (0.93, 0.89, 0.81)
SITE, PATH = "#D55E00", "#CC79A7"
UNDER_MM = 2.0
"""Depth at which the density is read that a point of the surface shows."""
DENSITIES = (0.0, 1800.0)
COLOURS = "YlGnBu"
"""Light where bone is sparse, so that shading stays visible; colour-blind readers can follow it."""
FRONT = (0.3, -1.0, 0.25)
"""Direction to the eye of a bone without a site: from the patient's front left above."""


def draw_ct_bone(
    surface: Surface,
    path: Path,
    *,
    density: Image | None,
    centre_mm: NDArray[np.float64] | None,
    normal: NDArray[np.float64] | None,
    points_mm: NDArray[np.float64] | None,
    title: str,
) -> str | None:
    """Draw the bone to a file.

    Parameters
    ----------
    surface
        The bone in the frame of its image.
    density
        Apparent density [kg/m3]; None where it is unknown.
    centre_mm, normal
        The site [mm, LPS]; None where there is none yet.
    points_mm
        Corners of a path [mm, LPS], shape (n, 3).

    Returns
    -------
    None, or why it could not be drawn.
    """
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(1e3 * surface.vertices_m, surface.faces.astype(int))
    mesh = mesh.compute_normals(split_vertices=False)
    mesh = paint(mesh, _colours(mesh, density))
    eyes = _eyes(normal)
    cameras = [Camera.seeing(mesh.points, eye, up) for eye, up in eyes.values()]
    pictures = render(lambda: [(mesh, camera) for camera in cameras], fine=is_vector(path))
    if isinstance(pictures, str):
        return pictures
    with DRAWING:
        chart, panels, (wide, tall) = side_by_side(pictures, head_px=HEAD_PX, foot_px=FOOT_PX, fine=is_vector(path))
        chart.text(0.5, 1.0 - 35 / tall, title, ha="center", va="center", size=11)
        for axes, name, camera in zip(panels, eyes, cameras, strict=True):
            axes.set_title(name, size=10)
            draw_scale(axes, camera)
            if points_mm is not None:
                axes.plot(*camera.pixels(points_mm).T, color=PATH, linewidth=1.5)
            if centre_mm is not None and normal is not None:
                one, other = camera.pixels(np.stack([centre_mm, centre_mm + 15.0 * normal]))
                arrow = {"arrowstyle": "-|>", "color": SITE, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
                axes.annotate("", other, one, arrowprops=arrow)
                axes.plot(*one, "o", color=SITE, markersize=5)
        for left, camera in zip((0.06, 0.84), cameras, strict=True):
            small = chart.add_axes((left, 0.02, AXES_PX / wide, 0.9 * FOOT_PX / tall))
            draw_axes(small, ("left", "back", "head"), camera)
        if density is not None:
            _scale(chart, FOOT_PX / tall)
        save(chart, path)
    return None


def _eyes(normal: NDArray[np.float64] | None) -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Directions to the eye and upward of each panel, by its title."""
    head = np.array([0.0, 0.0, 1.0])
    if normal is None:
        front = np.array(FRONT)
        return {"from the front": (front, head), "from the back": (front * [1.0, -1.0, 1.0], head)}
    upright = head if abs(normal[2]) < 0.9 else np.array([0.0, -1.0, 0.0])
    aside = np.cross(upright, normal)
    return {"along the site's axis": (normal, upright), "from aside": (aside + 0.25 * upright, upright)}


def _colours(mesh: "pyvista.PolyData", density: Image | None) -> NDArray[np.float64]:
    """Colour of each point by the density under it."""
    if density is None:
        return np.tile(PLAIN, (mesh.n_points, 1))
    from matplotlib import colormaps
    from scipy.ndimage import map_coordinates

    points = np.asarray(mesh.points) - UNDER_MM * np.asarray(mesh.point_data["Normals"])
    at = (points - np.array(density.origin_mm)) / np.array(density.spacing_mm)
    found = map_coordinates(density.values.astype(np.float32), at.T, order=1, mode="nearest")
    low, high = DENSITIES
    return np.asarray(colormaps[COLOURS](np.clip((found - low) / (high - low), 0.0, 1.0)))[:, :3]


def _scale(chart: "Figure", foot: float) -> None:
    """The scale of densities below the panels."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    bar = chart.add_axes((0.32, 0.62 * foot, 0.36, 0.13 * foot))
    chart.colorbar(ScalarMappable(Normalize(*DENSITIES), COLOURS), cax=bar, orientation="horizontal", extend="max")
    bar.set_xlabel(f"apparent density {UNDER_MM:g} mm under the surface [kg/m³]")
