"""Drawable surfaces of tools and of infinite faces, such as a wall, and poses of tools."""

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.surfaces.triangle_files import read_triangles
from tissue.scene.organ import LayersAnatomy
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene
from tissue.scene.tool import Blade, Needle, Probe, Tool
from tissue.simulation.builders.parts import motion_of

if TYPE_CHECKING:
    import pyvista

    from tissue.simulation.trace import Table

NEEDLE_MM = 80.0
"""Length [mm] with which needles are drawn, longer than insertions in a study (60 mm)."""
BLADE_MM = 40.0
"""Length [mm] with which a blade is drawn above its edge."""
POINT = 2.0
"""Ratio of the length to the diameter of a drawn needle's point."""
SIDES = 72
"""Number of sides of a drawn round body; steps of 5 degrees look round."""
ARC = np.radians(270.0)
"""Angle of the arc that shows the sense of rotation of a tool [rad]."""
ROD_MM = 40.0
"""Length [mm] with which rod-shaped probes are drawn."""
ABOVE = 0.6
"""Width of the rotation arc above a tool, relative to the width of an arc around the tool."""


def tool_surface(tool: Tool | Probe | Needle | Blade | None) -> "pyvista.PolyData | None":
    """Return the surface of a tool in the frame of the tool [mm], or None.

    The tip is at the origin, and z points from tip to shank. The result is None if there is no
    tool, or the geometry file of the tool cannot be read.
    """
    import pyvista

    match tool:
        case Tool():
            from tissue.simulation.builders.cutting import cutter_of

            outline = 1e3 * cutter_of(tool).profile.outline
            return _turned(np.column_stack([outline[:, 0], np.zeros(len(outline)), outline[:, 1]]))
        case Probe(kind="sphere-probe"):
            radius = 0.5 * tool.size_mm
            # from pole to pole is half a turn: the same 5 degrees a step
            return pyvista.Sphere(
                radius=radius, center=(0.0, 0.0, radius), theta_resolution=SIDES, phi_resolution=36
            )
        case Probe() if tool.file_name:
            with suppress(InputError):
                vertices, faces = read_triangles(Path(tool.file_name))
                return pyvista.PolyData.from_regular_faces(tool.scale * vertices, faces.astype(int))
        case Probe():
            return _rod(0.5 * tool.size_mm, getattr(tool, "length_mm", ROD_MM))
        case Needle():
            return _rod(0.5 * tool.diameter_mm, NEEDLE_MM, point_mm=POINT * tool.diameter_mm)
        case Blade():
            return _plate(tool)
    return None


def turning_tool(tool: Tool | Probe | Needle | Blade | None) -> "pyvista.PolyData | None":
    """Return the surface of a tool, with an arrow above a rotating tool.

    The arrow shows the sense of rotation.
    """
    import pyvista

    surface = tool_surface(tool)
    if surface is None or not isinstance(tool, Tool) or tool.spin_rpm == 0.0:
        return surface
    arc = ABOVE * spin_arc_mm(tool) + [0.0, 0.0, surface.bounds[5]]
    # radius of the line; the head is three times as long as the line is thick, and 2.5 times as
    # wide
    thick = 0.02 * tool.diameter_mm
    head = pyvista.Cone(
        center=arc[-1],
        direction=arc[-1] - arc[-2],
        height=6.0 * thick,
        radius=2.5 * thick,
        resolution=SIDES // 3,
    )
    return surface.append_polydata(pyvista.MultipleLines(arc).tube(radius=thick), head)


def spin_arc_mm(tool: Tool) -> Array:
    """Return points [mm], shape (n, 3), of an arc around the tip of a rotating tool.

    The points are in the frame of the tool, and their order follows the rotation.
    """
    turned = -np.sign(tool.spin_rpm) * np.linspace(0.0, ARC, SIDES)
    # 15 % outside of the tool
    radius = 0.575 * tool.diameter_mm
    return np.column_stack([radius * np.cos(turned), radius * np.sin(turned), np.zeros(SIDES)])


def pose(tip_mm: ArrayLike, quaternion: ArrayLike) -> Array:
    """Return the matrix, shape (4, 4), that maps points [mm] from the tool's frame to the world.

    The pose is given by the position of the tip and a quaternion (x, y, z, w).
    """
    from scipy.spatial.transform import Rotation

    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    matrix[:3, 3] = tip_mm
    return matrix


def row_at(trace: "Table", time_s: float) -> int:
    """Return the index of the first row of a trace at or after a time.

    If the time is after the last row, the index of the last row is returned.
    """
    times = trace["time_s"]
    # times from files are rounded: a tick at the moment itself counts
    return int(np.clip(np.searchsorted(times, time_s - 1e-9), 0, len(times) - 1))


def _rod(radius_mm: float, length_mm: float, *, point_mm: float = 0.0) -> "pyvista.PolyData":
    around = [
        [0.0, 0.0, 0.0],
        [radius_mm, 0.0, point_mm],
        [radius_mm, 0.0, length_mm],
        [0.0, 0.0, length_mm],
    ]
    return _turned(np.array(around))


def _plate(blade: Blade) -> "pyvista.PolyData":
    """Return the surface of a blade in the half plane x > 0."""
    import pyvista

    end_mm = blade.width_mm / np.tan(np.radians(blade.edge_deg))
    outline = np.array(
        [
            [0.0, 0.0],
            [blade.width_mm, end_mm],
            [blade.width_mm, end_mm + BLADE_MM],
            [0.0, end_mm + BLADE_MM],
        ]
    )
    at = np.insert(outline, 1, -0.5 * blade.thickness_mm, axis=1)
    side = pyvista.PolyData.from_regular_faces(at, [[0, 1, 2, 3]]).triangulate()
    plate = side.extrude((0.0, blade.thickness_mm, 0.0), capping=True)
    return plate.triangulate()


def _turned(line_mm: Array) -> "pyvista.PolyData":
    """Return the surface that a line in the half plane y = 0 sweeps around z."""
    import pyvista

    return pyvista.lines_from_points(line_mm).extrude_rotate(resolution=SIDES, capping=False)


FACE_MM = 30.0
"""Edge [mm] of a drawn layer face; a drawn wall is at least this much longer than the path."""
WALL_MESH_MM = 5.0
"""Width of the squares of a drawn wall [mm]."""


def faces_of(scene: Scene | None) -> "dict[str, pyvista.PolyData]":
    """Return the drawn part [mm] of each infinite face in a scene, keyed by name.

    Infinite faces are the face of a virtual wall, or the faces of the layers that a needle passes.
    A scene with voxels or a mesh has no infinite faces.
    """
    if scene is None:
        return {}
    built_in = {"layers": layer_faces, "wall": path_face, "soft-tissue": path_face}
    make = ANATOMIES[scene.anatomy.kind].faces or built_in.get(scene.anatomy.kind)
    return {} if make is None else make(scene)


def path_face(scene: Scene) -> "dict[str, pyvista.PolyData]":
    """Return the drawn part [mm] of the infinite face of a wall or a tissue, keyed by name.

    The part covers all positions that the tool can reach.
    """
    import pyvista

    path_mm = 1e3 * motion_of(scene).sweep_m()[:, :2]
    low = path_mm.min(axis=0)
    high = path_mm.max(axis=0)
    # without a device, the tool stays on its path
    roam_mm = (scene.device and scene.device.coupling.roam_mm) or 0.0
    middle = 0.5 * (low + high)
    # a hand may roam beyond the path on all sides
    (wide, deep) = high - low + max(FACE_MM, 2.0 * roam_mm)
    return {
        getattr(scene.anatomy, "material", scene.anatomy.kind): pyvista.Plane(
            center=(*middle, 0.0),
            direction=(0.0, 0.0, 1.0),
            i_size=wide,
            j_size=deep,
            i_resolution=max(round(wide / WALL_MESH_MM), 1),
            j_resolution=max(round(deep / WALL_MESH_MM), 1),
        )
    }


def layer_faces(scene: Scene) -> "dict[str, pyvista.PolyData]":
    """Return the drawn part [mm] of the face of each layer that a needle passes, keyed by layer."""
    import pyvista

    assert isinstance(scene.anatomy, LayersAnatomy)
    depths = {"capsule": 0.0} | dict(scene.anatomy.membranes)
    return {
        name: pyvista.Plane(
            center=(0.0, 0.0, -depth), direction=(0.0, 0.0, 1.0), i_size=FACE_MM, j_size=FACE_MM
        )
        for name, depth in depths.items()
    }
