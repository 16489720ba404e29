"""Selection of nodes of a tetrahedral mesh by position, direction or part.

The selected nodes can be used to support or load a body.
"""

from collections.abc import Sequence

import numpy as np

from meshes.base.arrays import Array, Ints, cross_products
from meshes.base.errors import (
    InputError,
    enumerated,
    in_brackets,
    require_direction,
    require_range,
    require_vector,
)
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import nearest_on_triangles

Nodes = Ints


def nodes_behind_plane(
    mesh: TetMesh, *, point_m: Sequence[float], normal: Sequence[float]
) -> Nodes:
    """Return surface nodes behind a plane, in ascending order.

    The plane passes through `point_m` [m] and has the outward normal `normal`.

    Raises
    ------
    InputError
        If no node is behind the plane. The message states the distance of the nearest node.
    """
    point = require_vector("point_m", point_m)
    axis = require_direction("normal", normal)
    points = mesh.nodes_m[mesh.surface_nodes]
    away = (points - point) @ axis
    # tolerance for rounding
    chosen = mesh.surface_nodes[away <= 1e-9 * float(np.ptp(mesh.nodes_m, axis=0).max())]
    if not len(chosen):
        nearest = int(away.argmin())
        at, found = (in_brackets(1e3 * each, ".3g") for each in (point, points[nearest]))
        raise InputError(
            "support",
            "touch the body",
            f"the plane through {at} mm with no surface node behind it",
            (
                f"move the plane: the nearest surface node, at {found} mm, is "
                f"{1e3 * away[nearest]:.3g} mm away"
            ),
        )
    return chosen


def nodes_facing(mesh: TetMesh, *, direction: Sequence[float], within_deg: float = 60.0) -> Nodes:
    """Return the nodes of the surface triangles that face a direction.

    The angle between the outward normals of these triangles and `direction` is at most
    `within_deg`.

    Raises
    ------
    InputError
        If no triangle faces the direction. The message states the smallest angle between a
        triangle's normal and the direction.
    """
    axis = require_direction("direction", direction)
    within = require_range("within_deg", within_deg, 1.0, 180.0, "use a value such as 60")
    angle = np.degrees(np.arccos(np.clip(surface_normals(mesh) @ axis, -1.0, 1.0)))
    faces = mesh.surface[angle <= within]
    if not len(faces):
        raise InputError(
            "support",
            "touch the body",
            f"no surface within {within:g} degrees of {axis.tolist()}",
            (
                f"change the direction or the angle: the nearest face is {angle.min():.3g} "
                "degrees away"
            ),
        )
    return np.unique(faces)


def nodes_of_part(mesh: TetMesh, name: str) -> Nodes:
    """Return all nodes of a part's cells, inside and on the surface.

    Raises
    ------
    InputError
        If the mesh has no such part, or the part has no cells.
    """
    if name not in mesh.part_names:
        raise InputError(
            "part", f"be one of {enumerated(mesh.part_names, 'or')}", name, "use one of them"
        )
    cells = mesh.cells[mesh.part == mesh.part_names.index(name)]
    if not len(cells):
        raise InputError(
            "part",
            "contain cells of the mesh",
            f"{name}, which has no cells",
            "use a finer mesh or another part",
        )
    return np.unique(cells)


def faces_of(mesh: TetMesh, nodes: Nodes) -> Ints:
    """Return the surface triangles, shape (k, 3), whose corners are all in `nodes`."""
    return mesh.surface[np.isin(mesh.surface, nodes).all(axis=1)]


def surface_normals(mesh: TetMesh) -> Array:
    """Compute the outward unit normal of each surface triangle, shape (f, 3)."""
    normal = cross_products(mesh.nodes_m, mesh.surface)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def place_on_surface(mesh: TetMesh, point_m: Array, around_m: float) -> tuple[Array, Array]:
    """Return the surface point nearest to a point [m], and the outward normal there, shapes (3,).

    The normal is a weighted mean over the triangles whose centroids lie within `around_m` [m] of
    the surface point. Large and near triangles have larger weights. The normal therefore changes
    smoothly from facet to facet. If no centroid lies within `around_m`, the normal of the nearest
    triangle is returned.
    """
    nearest = nearest_on_triangles(mesh.nodes_m, mesh.surface, point_m[None])[0]
    normals = cross_products(mesh.nodes_m, mesh.surface)  # length: twice the area
    away = np.linalg.norm(mesh.nodes_m[mesh.surface].mean(axis=1) - nearest, axis=1)
    # 1.01 gives the nearest triangle a weight even if its centroid lies outside the radius.
    near = np.maximum(1.0 - (away / max(around_m, 1.01 * float(away.min()))) ** 2, 0.0) ** 2
    mean = near @ normals
    return nearest, mean / np.linalg.norm(mean)
