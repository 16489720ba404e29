"""Meshing of closed surfaces with tetrahedra by fTetWild (Hu et al., 2020), with a cache.

fTetWild moves the surface only within a thin envelope. It determines the inside from the winding
number, so a surface that crosses itself is filled as the union of the enclosed regions. The results
of two runs of fTetWild differ slightly, even on one thread. The cache makes results reproducible,
because equal surfaces get the same stored mesh.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError, require_length
from meshes.base.progress import Progress, silent
from meshes.surfaces.repair import edge_counts
from meshes.surfaces.surface import Surface
from meshes.tets.quality import describe, repair_tets
from meshes.tets.tetrahedra import TetMesh, signed_volumes

FILL_EDGES = 14.0
"""Number of tetrahedron edges along an organ's longest side if no edge length is given."""
_CELLS = 30_000
"""Number of tetrahedra in a mesh if no edge length is given.

With this number, computing the compliance of 500 nodes takes 10 s.
"""
_EDGE_PER_CELL = 2.7
"""Ratio of target edge to cube root of the mean cell volume, measured for fTetWild on a liver."""
_ENVELOPE = 0.1
_FARTHEST_M = 4e-4
"""Largest distance [m] by which fTetWild may move the surface.

The distance is `_ENVELOPE` times the edge if this product is smaller.

The upper limit is smaller than the voxels of scans from which surfaces are made.
"""
_VOLUME_OFF = 0.005
"""Relative difference between the volumes of mesh and surface above which a note is added."""
_STEPS = 8
"""Largest number of moves of the surface in `with_volume`.

Each move squares the remaining relative error of the volume. If a move would flatten tetrahedra,
their nodes are held fixed instead.
"""
_OFF = 1e-6
"""Relative volume error accepted after the moves. With a larger error, moves are discarded."""
_LEAST_KEPT = 0.2
"""Smallest accepted volume of a tetrahedron after a move, relative to its original volume."""


def tetrahedralise(
    surface: Surface, *, edge_m: float | None = None, report: Progress = silent
) -> tuple[TetMesh, tuple[str, ...]]:
    """Fill a closed surface with tetrahedra, or read this mesh from the cache if it is there.

    Parameters
    ----------
    surface
        Closed surface with outward normals, for example from `meshes.read_surface`.
    edge_m
        Target edge [m]. If None, an edge that gives about 30,000 tetrahedra is chosen.
    report
        Function that is called with the current task's name and finished fraction (0 to 1).

    Returns
    -------
    Mesh in the frame of the surface, and notes, one sentence each.

    Raises
    ------
    InputError
        If the edge is too short or too long for the surface, or the surface cannot be meshed.
    """
    volume = surface.report.volume_mm3 * 1e-9
    longest = 1e-3 * max(surface.report.size_mm)
    edge = _EDGE_PER_CELL * (volume / _CELLS) ** (1.0 / 3.0) if edge_m is None else edge_m
    # Shorter edges give millions of tetrahedra, and longer edges a solid with one cell.
    edge = require_length("edge_m", edge, longest / 200.0, longest / 2.0, longest / 20.0)
    sentences = []
    pinched = edge_counts(surface.faces)[1]
    if pinched:
        sentences.append(
            f"The surface has {pinched} edges of more than two triangles, which the mesher "
            "separates or thickens."
        )
    envelope = min(_ENVELOPE * edge, _FARTHEST_M)

    def make() -> dict[str, np.ndarray]:
        report(f"filling {surface.report.source} with tetrahedra (once; a minute or two)", 0.0)
        nodes, cells = _filled(surface, edge, envelope)
        return {"nodes": nodes, "cells": cells}

    arrays = cached_arrays("tetwild-3", (surface.vertices_m, surface.faces, edge, envelope), make)
    report(f"filling {surface.report.source} with tetrahedra", 1.0)
    if len(arrays["cells"]) == 0:
        raise InputError(
            "edge_m",
            "be short enough to fill the surface",
            f"{1e3 * edge:.4g}",
            "use a shorter edge",
            "mm",
        )
    mesh, repairs = repair_tets(arrays["nodes"], arrays["cells"])
    mesh = with_volume(mesh, volume, within_m=envelope)
    off = float(mesh.volumes_m3.sum()) / volume - 1.0
    if abs(off) > _VOLUME_OFF:
        sentences.append(
            f"The volume of the mesh differs by {100.0 * off:+.1f} % from the volume of the "
            "surface: use smaller edges."
        )
    return mesh, (*sentences, *describe(mesh), *repairs)


def _filled(surface: Surface, edge: float, envelope: float) -> tuple[np.ndarray, np.ndarray]:
    """Compute nodes [m] and cells by fTetWild."""
    from pytetwild import tetrahedralize  # type: ignore[attr-defined]

    left_behind = Path("__tracked_surface.stl")  # fTetWild writes this file into the working folder
    there_before = left_behind.exists()
    nodes, cells = tetrahedralize(
        surface.vertices_m,
        surface.faces.astype(np.int32),
        edge_length_abs=edge,
        # The envelope is relative to the diagonal of the box. It is at least a tenth of fTetWild's
        # default of 1e-3, because a smaller envelope takes more time.
        epsilon=max(envelope / float(np.linalg.norm(np.ptp(surface.vertices_m, axis=0))), 1e-4),
        quiet=True,
        vtk_ordering=True,
    )
    if not there_before:
        left_behind.unlink(missing_ok=True)
    return np.asarray(nodes, dtype=np.float64), np.asarray(cells, dtype=np.int64)


def with_volume(mesh: TetMesh, volume_m3: float, *, within_m: float) -> TetMesh:
    """Move the mesh's surface along its normals so that the mesh has a given volume.

    All surface nodes move by the same distance, except nodes of tetrahedra that would become too
    small.

    Parameters
    ----------
    mesh
        Mesh of a body. The volumes of mesh and body differ slightly, because the facets of the mesh
        are flat.
    volume_m3
        Required volume of the mesh [m3].
    within_m
        Largest distance by which the surface may move [m]. If a larger distance is needed, the
        surface is not moved.
    """
    moved = mesh
    free = np.ones(len(mesh.nodes_m))
    for _ in range(_STEPS):
        corners = moved.nodes_m[moved.surface]
        areas = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        # 1e-300 avoids divisions by zero at inner nodes and if all nodes are fixed.
        normals = np.zeros_like(mesh.nodes_m)
        np.add.at(normals, moved.surface.ravel(), np.repeat(areas, 3, axis=0))
        normals *= (free / (np.linalg.norm(normals, axis=1) + 1e-300))[:, None]
        gained = float((areas * normals[moved.surface].mean(axis=1)).sum())
        off = volume_m3 - float(moved.volumes_m3.sum())
        nodes = moved.nodes_m + off / (gained + 1e-300) * normals
        if np.linalg.norm(nodes - mesh.nodes_m, axis=1).max() > within_m:
            return mesh
        flat = signed_volumes(nodes, mesh.cells) < _LEAST_KEPT * mesh.volumes_m3
        if flat.any():
            free[mesh.cells[flat]] = 0.0
        else:
            moved = replace(moved, nodes_m=nodes)
    return moved if abs(off) < _OFF * volume_m3 else mesh
