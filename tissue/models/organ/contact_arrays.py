"""Arrays that the kernels of a contact work on: of the body, of its contact points, and of their work lists."""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.contact_state import Body, Lists, Points
from meshes.base.arrays import Array, Ints
from tissue.models.organ.contact_points import contact_points
from tissue.models.organ.probe import ProbeShape, ShellProbe

__all__ = ["body_arrays", "list_arrays", "point_arrays", "put"]


def put(values: NDArray[np.generic], dtype: type, device: str) -> wp.array[object]:
    """Copy of an array on a device."""
    return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)


def body_arrays(nodes_m: Array, faces: Ints, compliance_m_N: Array, device: str) -> Body:
    """The touchable surface at rest, without force; on a CPU the compliance is used where it lies."""
    body = Body()
    body.free, body.last_free = put(nodes_m, wp.vec3d, device), put(nodes_m, wp.vec3d, device)
    body.scale = wp.float64(1.0)
    body.compliance = wp.array(compliance_m_N, dtype=wp.float64, device=device, copy=device != "cpu")
    body.corners = put(faces, wp.int32, device)
    for name in ("force", "moved"):
        setattr(body, name, wp.zeros(len(nodes_m), dtype=wp.vec3d, device=device))
    return body


def point_arrays(nodes_m: Array, faces: Ints, probe: ProbeShape, spacing_m: float | None, device: str) -> Points:
    """Contact points without force, chained by triangle: a shell's own, or some spread over the triangles.

    Parameters
    ----------
    spacing_m
        Widest spacing of points on the triangles [m]; None: what the tool asks for.
    """
    if isinstance(probe, ShellProbe):
        face = np.zeros(0, dtype=np.int32)
        weights, areas = np.zeros((len(probe.points_m), 3)), probe.areas_m2
        following = np.full(len(weights), -1)
    else:
        face, weights, areas = contact_points(nodes_m, faces, spacing_m or probe.spacing_m)
        following = np.append(np.where(np.diff(face) == 0, np.arange(1, len(face)), -1), -1)
    first = np.full(len(faces), -1)
    first[face[::-1]] = np.arange(len(face))[::-1]
    points, count = Points(), len(weights)
    points.first, points.following = put(first, wp.int32, device), put(following, wp.int32, device)
    points.weight, points.area = put(weights, wp.vec3d, device), put(areas, wp.float64, device)
    for name in ("tool_point", "tool_normal", "force", "anchor"):
        setattr(points, name, wp.zeros(count, dtype=wp.vec3d, device=device))
    points.response = wp.zeros((count, 5), dtype=wp.mat33d, device=device)
    points.ready = wp.zeros(count, dtype=wp.int32, device=device)
    return points


def list_arrays(triangles: int, device: str) -> Lists:
    """Empty work lists for so many triangles."""
    lists = Lists()
    lists.count = wp.zeros(3, dtype=wp.int32, device=device)
    for name in ("near", "working", "working_mark"):
        setattr(lists, name, wp.zeros(triangles, dtype=wp.int32, device=device))
    return lists
