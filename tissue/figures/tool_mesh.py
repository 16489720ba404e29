"""The surface of a scene's tool, to be shown."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError
from meshes.surfaces.triangle_files import read_triangles
from tissue.scene.tool import Needle, Probe, Tool

if TYPE_CHECKING:
    import pyvista

__all__ = ["pose", "tool_surface"]

NEEDLE_MM = 80.0
POINT = 2.0
"""Length of a needle's point, in diameters."""
SIDES = 72


def tool_surface(tool: Tool | Probe | Needle | None) -> "pyvista.PolyData | None":
    """The surface of a tool in its own frame [mm], tip at the origin, z from tip to shank.

    None without a tool, or for one whose file cannot be read any more.
    """
    import pyvista

    match tool:
        case Tool():
            from tissue.builders.cutting import cutter_of

            outline = 1e3 * cutter_of(tool).profile.outline
            return _turned(np.column_stack([outline[:, 0], np.zeros(len(outline)), outline[:, 1]]))
        case Probe(kind="sphere-probe"):
            radius = 0.5 * tool.diameter_mm
            return pyvista.Sphere(radius=radius, center=(0.0, 0.0, radius), theta_resolution=SIDES, phi_resolution=36)
        case Probe(file=str(file)):
            with suppress(InputError):
                vertices, faces = read_triangles(Path(file))
                return pyvista.PolyData.from_regular_faces(tool.scale_mm * vertices, faces.astype(int))
        case Probe():
            return _rod(0.5 * tool.diameter_mm, tool.length_mm)
        case Needle():
            return _rod(0.5 * tool.diameter_mm, NEEDLE_MM, point_mm=POINT * tool.diameter_mm)
    return None


def pose(tip_mm: ArrayLike, quaternion: ArrayLike) -> NDArray[np.float64]:
    """From a tool's own frame to the world [mm] by its tip and its turn (x, y, z, w), shape (4, 4)."""
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), tip_mm
    return matrix


def _rod(radius_mm: float, length_mm: float, *, point_mm: float = 0.0) -> "pyvista.PolyData":
    around = [[0.0, 0.0, 0.0], [radius_mm, 0.0, point_mm], [radius_mm, 0.0, length_mm], [0.0, 0.0, length_mm]]
    return _turned(np.array(around))


def _turned(line_mm: NDArray[np.float64]) -> "pyvista.PolyData":
    """A line in the half plane y = 0, turned around z."""
    import pyvista

    return pyvista.lines_from_points(line_mm).extrude_rotate(resolution=SIDES, capping=False)
