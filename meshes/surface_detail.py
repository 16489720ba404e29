"""A surface of very many triangles: as it is where the tool goes, of few triangles elsewhere.

Far vertices of a body are joined on a lattice. Joining vertices keeps closed what is closed and leaves open what is
open, so the surface still divides space, and its large holes are still found. The site takes its axes from all
triangles.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import InputError
from meshes.repair import vertex_bodies
from meshes.site import Site
from meshes.surface import Surface, surface_from_triangles

__all__ = ["surface_at_site"]

_CELLS = 100
_SAME = 1e-6
"""Vertices within this share of the longest side are one, as in `meshes.surface`."""
_BETWEEN_SITES_M = 2e-3
_AROUND_SITE_M = 1e-3
_FARTHEST = 1e100

Box = tuple[NDArray[np.float64], NDArray[np.float64]]


def surface_at_site(
    vertices: NDArray[Any],
    faces: NDArray[Any],
    find: Callable[[Surface], Site],
    region_m: Box,
    *,
    source: str,
    scale_mm: float | None = None,
    cut_off: bool = False,
    most: int = 150_000,
) -> tuple[Surface, Site]:
    """Make triangles enclose a solid, and find the site on it.

    Above `most` triangles, those outside the region are replaced by larger ones, of 1/100 of the longest side.

    Parameters
    ----------
    vertices, faces, source, scale_mm, cut_off
        As in `meshes.surface.surface_from_triangles`.
    find
        Finds the site on a surface.
    region_m
        Lowest and highest corner [m], in the frame of the site, of the box in which the surface has to be right.

    Raises
    ------
    InputError
        As `surface_from_triangles` and `find`.
    """

    def made(points: NDArray[Any], triangles: NDArray[Any]) -> Surface:
        return surface_from_triangles(points, triangles, source=source, scale_mm=scale_mm, cut_off=cut_off)

    if len(faces) > most and (np.abs(vertices) < _FARTHEST).all():
        try:
            return _thinned(np.asarray(vertices), np.asarray(faces), made, find, region_m)
        except (InputError, _NeedsAllError):
            pass  # a refusal must speak of the surface as it is
    surface = made(vertices, faces)
    return surface, find(surface)


class _NeedsAllError(Exception):
    """The surface cannot be judged by a part of its triangles."""


def _thinned(
    vertices: NDArray[Any],
    faces: NDArray[Any],
    made: Callable[[NDArray[Any], NDArray[Any]], Surface],
    find: Callable[[Surface], Site],
    region_m: Box,
) -> tuple[Surface, Site]:
    """Surface that is fine in the region around the site, which is found on a coarse one first."""
    number, coarse, pitch = _joined(vertices, faces)
    rough = made(coarse, _whole_triangles(number[faces]))
    first = find(rough)
    scale = 1e-3 * rough.report.scale_mm
    margin = _BETWEEN_SITES_M + 2.0 * pitch * scale  # a corner moves within its cell
    around = np.array([np.minimum(region_m[0], -_AROUND_SITE_M), np.maximum(region_m[1], _AROUND_SITE_M)])
    low, high = first.rotation.T @ first.centre_m + around + margin * np.array([[-1.0], [1.0]])
    x, y, z = vertices.T  # summed, where a matrix product would round equal vertices in different ways
    own = np.stack([scale * (x * a[0] + y * a[1] + z * a[2]) for a in first.rotation.T], axis=1)
    corners = np.stack([own[faces[:, k]] for k in range(3)])
    near = ((corners.min(axis=0) <= high) & (corners.max(axis=0) >= low)).all(axis=1)
    if not near.any():
        raise _NeedsAllError
    low, high = corners[:, near].min(axis=(0, 1)), corners[:, near].max(axis=(0, 1))
    kept = ((own >= low) & (own <= high)).all(axis=1)
    number[kept] = len(coarse) + np.arange(kept.sum())
    surface = made(np.concatenate([coarse, vertices[kept]]), _whole_triangles(number[faces]))
    surface = replace(surface, scanned=(scale * vertices.astype(np.float64), faces))
    site = find(surface)
    ends = np.array(np.meshgrid(*np.array(region_m).T)).reshape(3, -1)
    moved = (site.rotation @ ends).T + site.centre_m - (first.rotation @ ends).T - first.centre_m
    if rough.report.turned or surface.report.turned or np.linalg.norm(moved, axis=1).max() > _BETWEEN_SITES_M:
        raise _NeedsAllError
    said = f"Away from the tool {len(faces)} triangles were joined into {len(surface.faces)}."
    report = replace(surface.report, repairs=(*surface.report.repairs, said))
    return replace(surface, report=report), site


def _joined(vertices: NDArray[Any], faces: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.float64], float]:
    """Number of the lattice cell with vertices in it for each vertex, a point for each such cell, and the cells' edge.

    The points have the bounding box of the vertices; those of two bodies in a cell stay apart.
    """
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    points = vertices if used.all() else vertices[used]
    low, high = points.min(axis=0), points.max(axis=0)
    pitch = float((high - low).max()) / _CELLS
    if not pitch > 0.0:
        raise _NeedsAllError
    cell = ((np.clip(vertices, low, high) - low) / pitch).astype(np.int64)
    flat = (cell[:, 0] * (_CELLS + 1) + cell[:, 1]) * (_CELLS + 1) + cell[:, 2]
    body = vertex_bodies(vertices, faces, _SAME * _CELLS * pitch)
    if body.any():
        flat = np.unique(flat * (int(body.max()) + 1) + body, return_inverse=True)[1].reshape(-1)
    filled = np.zeros(int(flat.max()) + 1, dtype=bool)
    filled[flat[used]] = True
    number = (np.cumsum(filled) - 1)[flat]
    joined = np.empty((int(filled.sum()), 3))
    joined[number[used]] = points
    for axis in range(3):
        for at in (int(np.argmin(points[:, axis])), int(np.argmax(points[:, axis]))):
            joined[number[used][at], axis] = points[at, axis]
    return number, joined, pitch


def _whole_triangles(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles whose three vertices are still apart."""
    a, b, c = faces.T
    return faces[(a != b) & (b != c) & (c != a)]
