"""Elements of a cutter's surface on a device, and their contributions to force and torque."""

import numpy as np
import warp as wp

from kernels.elements import CHUNK, LANES, Elements, lanes8, lever16
from meshes.base.arrays import Array
from tissue.cutters.cutter import Cutter, PointShell

__all__ = ["edge_lengths_m", "elements_of", "levers_of"]

LEVER = [0, 1, 3, 4, 5, 6, 7, 8, 9, 10, 11, 14, 15, 16]
"""Components of the forces and torques of element loads that are not 0 on every element.

The loads are tangential, radial and axial.
"""


def elements_of(shell: PointShell, cutter: Cutter, *, spacing_m: float, device: str) -> Elements:
    """Return the cutter's point shell on a device."""
    elements = Elements()
    elements.point = wp.array(shell.points_m, dtype=wp.vec3, device=device)
    missing = (0, -len(shell.areas_m2) % LANES), (0, 0)  # elements without a normal do not advance
    eights = (
        np.pad(np.hstack([shell.points_m, shell.normals]), missing)
        .reshape(-1, LANES, 6)
        .transpose(0, 2, 1)
    )
    elements.lanes = wp.array(np.ascontiguousarray(eights), dtype=lanes8, device=device)
    elements.normal = wp.array(shell.normals, dtype=wp.vec3, device=device)
    levers = np.hstack([levers_of(shell, cutter)[:, LEVER], np.zeros((len(shell.areas_m2), 2))])
    elements.lever = wp.array(np.pad(levers, missing), dtype=lever16, device=device)
    elements.area = wp.array(shell.areas_m2, dtype=wp.float32, device=device)
    bend = cutter.table(spacing_m=spacing_m).bend_at(
        shell.radii_m / spacing_m, shell.points_m[:, 2] / spacing_m
    )
    elements.bend = wp.array(bend, dtype=wp.float32, device=device)
    elements.edge_length = wp.array(edge_lengths_m(shell, cutter), dtype=wp.float32, device=device)
    balls, cones = _chunk_bounds(shell)
    elements.chunk_ball = wp.array(balls, dtype=wp.vec4, device=device)
    elements.chunk_cone = wp.array(cones, dtype=wp.vec4, device=device)
    return elements


def levers_of(shell: PointShell, cutter: Cutter) -> Array:
    """Return the directions of a tangential, a radial and an axial load on each element, (n, 18).

    Each direction is followed by its moment about the tip [m].
    """
    around = np.column_stack(
        [-shell.points_m[:, 1], shell.points_m[:, 0], np.zeros(len(shell.radii_m))]
    )
    around *= np.sign(cutter.spin_rad_s) / shell.radii_m[:, None]
    axis = np.broadcast_to([0.0, 0.0, 1.0], around.shape)
    parts = [
        part
        for each in (around, shell.normals, axis)
        for part in (each, np.cross(shell.points_m, each))
    ]
    return np.hstack(parts)


def edge_lengths_m(shell: PointShell, cutter: Cutter) -> Array:
    """Return the mean length of cutting edge in each element, N A / (2 pi r) [m], shape (n,)."""
    return np.asarray(cutter.flute_count * shell.areas_m2 / (2.0 * np.pi * shell.radii_m))


def _chunk_bounds(shell: PointShell) -> tuple[Array, Array]:
    """Return a bounding ball and a cone of normals for each chunk of points.

    Each array has shape (chunks, 4).    A ball is its centre and radius [m]. A cone is its axis and
    the sine of its half angle, 2 where it is wider than a half space.
    """
    balls = []
    cones = []
    for start in range(0, len(shell.areas_m2), CHUNK):
        points = shell.points_m[start : start + CHUNK]
        normals = shell.normals[start : start + CHUNK]
        middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
        balls.append([*middle, np.linalg.norm(points - middle, axis=1).max()])
        axis = normals.sum(axis=0)
        axis /= max(float(np.linalg.norm(axis)), 1e-12)
        cosine = float((normals @ axis).min())
        cones.append([*axis, np.sqrt(max(1.0 - cosine**2, 0.0)) if cosine > 0.0 else 2.0])
    return np.array(balls), np.array(cones)
