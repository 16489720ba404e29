"""Nodes of a tetrahedral mesh chosen by place, by direction or by part: where a body is held or loaded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive, require_range
from meshes.tets.tetrahedra import TetMesh

__all__ = [
    "faces_of",
    "nodes_behind_plane",
    "nodes_facing",
    "nodes_in_box",
    "nodes_in_sphere",
    "nodes_of_part",
    "surface_normals",
]

Nodes = NDArray[np.int64]


def nodes_behind_plane(mesh: TetMesh, *, point_m: Sequence[float], normal: Sequence[float]) -> Nodes:
    """Surface nodes behind the plane through `point_m` [m] with outward `normal`, in rising order.

    Raises
    ------
    InputError
        If none is, naming how far the nearest is.
    """
    point, axis = _three("point_m", point_m), _direction("normal", normal)
    return _chosen(mesh, (mesh.nodes_m[mesh.surface_nodes] - point) @ axis, f"the plane through {_mm(point)}")


def nodes_in_box(mesh: TetMesh, *, lower_m: Sequence[float], upper_m: Sequence[float]) -> Nodes:
    """Surface nodes in the box between two corners [m], its faces included; raises as `nodes_behind_plane`."""
    lower, upper = _three("lower_m", lower_m), _three("upper_m", upper_m)
    if not (upper >= lower).all():
        raise InputError(f"upper_m must not lie below lower_m {lower.tolist()}, got {upper.tolist()}: swap them")
    points = mesh.nodes_m[mesh.surface_nodes]
    outside = np.maximum(np.maximum(lower - points, points - upper), 0.0)
    return _chosen(mesh, np.linalg.norm(outside, axis=1), f"the box from {_mm(lower)} to {_mm(upper)}")


def nodes_in_sphere(mesh: TetMesh, *, centre_m: Sequence[float], radius_m: float) -> Nodes:
    """Surface nodes within `radius_m` [m] of `centre_m` [m]; raises as `nodes_behind_plane`."""
    centre, radius = _three("centre_m", centre_m), require_positive("radius_m", radius_m, "use about 0.02")
    away = np.linalg.norm(mesh.nodes_m[mesh.surface_nodes] - centre, axis=1) - radius
    return _chosen(mesh, away, f"the sphere of {1e3 * radius:.3g} mm about {_mm(centre)}")


def nodes_facing(mesh: TetMesh, *, direction: Sequence[float], within_deg: float = 60.0) -> Nodes:
    """Nodes of the surface triangles whose outward normal is within an angle of `direction`.

    Raises
    ------
    InputError
        If no triangle faces that direction, naming how far the nearest turns away.
    """
    axis = _direction("direction", direction)
    within = require_range("within_deg", within_deg, 1.0, 180.0, "use 60")
    angle = np.degrees(np.arccos(np.clip(surface_normals(mesh) @ axis, -1.0, 1.0)))
    faces = mesh.surface[angle <= within]
    if not len(faces):
        raise InputError(
            f"support must touch the body, got no surface within {within:g} degrees of {axis.tolist()}: the nearest is "
            f"{angle.min():.3g} degrees away"
        )
    return np.unique(faces)


def nodes_of_part(mesh: TetMesh, name: str) -> Nodes:
    """All nodes of the part's cells, inside and on the surface.

    Raises
    ------
    InputError
        If the mesh has no such part, or no cell of it.
    """
    if name not in mesh.part_names:
        raise InputError(f"part must be one of {', '.join(mesh.part_names)}, got {name}: use one of them")
    cells = mesh.cells[mesh.part == mesh.part_names.index(name)]
    if not len(cells):
        raise InputError(f"part must have cells, got none of {name}: use a finer mesh or another part")
    return np.unique(cells)


def faces_of(mesh: TetMesh, nodes: Nodes) -> NDArray[np.int64]:
    """Surface triangles with all three corners among the nodes, shape (k, 3)."""
    chosen = np.zeros(len(mesh.nodes_m), dtype=bool)
    chosen[nodes] = True
    return mesh.surface[chosen[mesh.surface].all(axis=1)]


def surface_normals(mesh: TetMesh) -> NDArray[np.float64]:
    """Outward unit normal of each surface triangle, shape (f, 3)."""
    a, b, c = (mesh.nodes_m[mesh.surface[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    return normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _chosen(mesh: TetMesh, away_m: NDArray[np.float64], region: str) -> Nodes:
    """Surface nodes at a distance not above zero, with a margin for rounding."""
    slack = 1e-9 * float(np.ptp(mesh.nodes_m, axis=0).max())
    chosen = mesh.surface_nodes[away_m <= slack]
    if not len(chosen):
        nearest = int(away_m.argmin())
        at = mesh.nodes_m[mesh.surface_nodes[nearest]]
        raise InputError(
            f"support must touch the body, got {region} with no surface node inside: the nearest, at {_mm(at)}, is "
            f"{1e3 * away_m[nearest]:.3g} mm away"
        )
    return chosen


def _mm(point_m: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{1e3 * x:.3g}" for x in point_m) + ") mm"


def _three(name: str, value: Sequence[float]) -> NDArray[np.float64]:
    vector = np.asarray(value, dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InputError(f"{name} must be three finite numbers, got {value}: use for example (0, 0, 0)")
    return vector


def _direction(name: str, value: Sequence[float]) -> NDArray[np.float64]:
    vector = _three(name, value)
    length = float(np.linalg.norm(vector))
    if length == 0.0:
        raise InputError(f"{name} must not be zero, got {tuple(value)}: use for example (0, 0, 1)")
    return vector / length
