"""Contact points of an organ's surface, and the arrays that the kernels of a contact use."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.contact_state import Body, Lists, Points
from meshes.base.arrays import Array, Int32s, Ints
from meshes.base.errors import InputError
from tissue.models.organ.probe import ProbeShape, ShellProbe

__all__ = ["body_arrays", "contact_points", "list_arrays", "point_arrays", "put"]

MOST_DIVISIONS = 16
"""Largest number of contact points along the edge of a triangle."""


def contact_points(nodes_m: Array, faces: Ints, spacing_m: float) -> tuple[Int32s, Array, Array]:
    """Return contact points on triangles: corners, and a lattice inside large triangles.

    A triangle whose longest edge spans n spacings, n > 1, has the centres of its n^2 equal parts.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (s, 3).
    faces
        Triangles, shape (f, 3).
    spacing_m
        Widest allowed spacing [m].

    Returns
    -------
    face
        Triangle of each point, shape (p,), rising; every node is a point of one of its triangles.
    weights
        Barycentric weights, shape (p, 3).
    areas_m2
        Area that a point represents [m2], shape (p,); 0 for corners of divided triangles.

    Raises
    ------
    InputError
        If an edge spans more than 16 spacings.
    """
    corners = nodes_m[faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    if longest.max() > MOST_DIVISIONS * spacing_m:
        raise InputError(
            "touch_edge_m",
            "be shorter under this tool",
            (
                f"an edge of {1e3 * longest.max():.4g} mm, more than {MOST_DIVISIONS} times "
                f"{1e3 * spacing_m:.4g} mm"
            ),
            "mesh the touchable surface finer, or take a larger tool",
        )
    division = np.maximum(np.ceil(longest / spacing_m - 1e-9), 1).astype(int)
    node_area = np.zeros(len(nodes_m))
    np.add.at(node_area, faces[division == 1], area[division == 1, None] / 3.0)
    named, first = np.unique(faces, return_index=True)
    face = [first // 3]
    weights = [np.eye(3)[first % 3]]
    areas = [node_area[named]]
    for n in np.unique(division[division > 1]):
        i, j = (index.ravel() for index in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
        up = np.column_stack([i, j])[i + j < n] + 1.0 / 3.0
        down = np.column_stack([i, j])[i + j < n - 1] + 2.0 / 3.0
        inner = np.vstack([up, down]) / n
        inner = np.column_stack([1.0 - inner.sum(axis=1), inner])
        wide = np.flatnonzero(division == n)
        face.append(np.repeat(wide, n * n))
        weights.append(np.tile(inner, (len(wide), 1)))
        areas.append(np.repeat(area[wide] / n**2, n * n))
    order = np.argsort(np.concatenate(face), kind="stable")
    return (
        np.concatenate(face)[order].astype(np.int32),
        np.concatenate(weights)[order],
        np.concatenate(areas)[order],
    )


def put(values: NDArray[np.generic], dtype: type, device: str) -> wp.array[object]:
    """Return a copy of an array on a device."""
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)


def body_arrays(nodes_m: Array, faces: Ints, compliance_m_N: Array, device: str) -> Body:
    """Return the touchable surface at rest, without force.

    On a CPU the compliance is used in place.
    """
    body = Body()
    body.free = put(nodes_m, wp.vec3d, device)
    body.last_free = put(nodes_m, wp.vec3d, device)
    body.scale = wp.float64(1.0)
    body.compliance = wp.array(
        compliance_m_N, dtype=wp.float64, device=device, copy=device != "cpu"
    )
    body.corners = put(faces, wp.int32, device)
    for name in ("force", "moved"):
        setattr(body, name, wp.zeros(len(nodes_m), dtype=wp.vec3d, device=device))
    return body


def point_arrays(
    nodes_m: Array, faces: Ints, probe: ProbeShape, spacing_m: float | None, device: str
) -> Points:
    """Return contact points without force, chained by triangle.

    They are a shell's own points, or points spread over the triangles.

    Parameters
    ----------
    spacing_m
        Widest spacing of points on the triangles [m]; None: the tool's spacing.
    """
    if isinstance(probe, ShellProbe):
        face = np.zeros(0, dtype=np.int32)
        weights = np.zeros((len(probe.points_m), 3))
        areas = probe.areas_m2
        following = np.full(len(weights), -1)
    else:
        face, weights, areas = contact_points(nodes_m, faces, spacing_m or probe.spacing_m)
        following = np.append(np.where(np.diff(face) == 0, np.arange(1, len(face)), -1), -1)
    first = np.full(len(faces), -1)
    first[face[::-1]] = np.arange(len(face))[::-1]
    points = Points()
    count = len(weights)
    points.first = put(first, wp.int32, device)
    points.following = put(following, wp.int32, device)
    points.weight = put(weights, wp.vec3d, device)
    points.area = put(areas, wp.float64, device)
    for name in ("tool_point", "tool_normal", "force", "anchor"):
        setattr(points, name, wp.zeros(count, dtype=wp.vec3d, device=device))
    points.response = wp.zeros((count, 5), dtype=wp.mat33d, device=device)
    points.ready = wp.zeros(count, dtype=wp.int32, device=device)
    return points


def list_arrays(triangles: int, device: str) -> Lists:
    """Return empty work lists for a number of triangles."""
    lists = Lists()
    lists.count = wp.zeros(3, dtype=wp.int32, device=device)
    for name in ("near", "working", "working_mark"):
        setattr(lists, name, wp.zeros(triangles, dtype=wp.int32, device=device))
    return lists
