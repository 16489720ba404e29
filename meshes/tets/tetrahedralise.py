"""A closed surface filled with tetrahedra by fTetWild (Hu et al., 2020), once, and kept.

fTetWild keeps the surface within an envelope and takes the inside from the winding number, so a surface that
crosses itself is filled as the union of what it encloses. Two runs give meshes that differ slightly, also on one
thread: a mesh is reproducible through the cache, which holds it by the content of the surface.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError, require_length
from meshes.base.progress import Progress, silent
from meshes.surfaces.repair import edge_counts
from meshes.surfaces.surface import Surface
from meshes.tets.crossings import crossing_triangles
from meshes.tets.quality import repair_tets
from meshes.tets.report import millimetres, place
from meshes.tets.tetrahedra import TetMesh
from meshes.tets.volume import with_volume

__all__ = ["FILL_EDGES", "tetrahedralise"]

FILL_EDGES = 14.0
"""Edges along the longest side of an organ where no edge is given."""
_CELLS = 30_000
_EDGE_PER_CELL = 2.7
"""Target edge over the cube root of the mean cell volume, as fTetWild came out on a liver."""
_ENVELOPE, _FARTHEST_M = 0.1, 4e-4
"""Distance that the surface may move, over the edge, and at most [m]: less than the voxels of the scans behind it."""
_VOLUME_OFF = 0.005
"""Share by which the volume of the mesh may differ before a sentence states it."""


def tetrahedralise(
    surface: Surface, *, edge_m: float | None = None, report: Progress = silent
) -> tuple[TetMesh, tuple[str, ...]]:
    """Fill a closed surface with tetrahedra, from the cache where it has been done before.

    Parameters
    ----------
    surface
        Closed, wound outward, as `meshes.read_surface` makes it.
    edge_m
        Target edge [m]; None: about 30,000 tetrahedra.
    report
        Called with what is being done and the share of it that is done (0 to 1).

    Returns
    -------
    The mesh in the frame of the surface, and notes, a sentence each.

    Raises
    ------
    InputError
        If the edge does not suit the surface, or nothing can be meshed.
    """
    volume = surface.report.volume_mm3 * 1e-9
    longest = 1e-3 * max(surface.report.size_mm)
    edge = _EDGE_PER_CELL * (volume / _CELLS) ** (1.0 / 3.0) if edge_m is None else edge_m
    edge = require_length("edge_m", edge, longest / 200.0, longest / 2.0, longest / 20.0)
    sentences = []
    pinched = edge_counts(surface.faces)[1]
    if pinched:
        sentences.append(
            f"The surface has {pinched} edges of more than two triangles, which the mesher parts or thickens."
        )
    crossing = crossing_triangles(surface.vertices_m, surface.faces)
    if len(crossing):
        at = place(millimetres(surface.vertices_m[surface.faces[crossing[0]]]))
        sentences.append(
            f"{len(crossing)} triangles of the surface cross others, the first at {at} mm: what they enclose together "
            "was filled; mend the surface in a mesh editor if that is not meant."
        )

    envelope = min(_ENVELOPE * edge, _FARTHEST_M)

    def make() -> dict[str, np.ndarray]:
        report(f"filling {surface.report.source} with tetrahedra (once; a minute or two)", 0.0)
        nodes, cells = _filled(surface, edge, envelope)
        return {"nodes": nodes, "cells": cells}

    arrays = cached_arrays("tetwild-3", (surface.vertices_m, surface.faces, edge, envelope), make)
    report(f"filling {surface.report.source} with tetrahedra", 1.0)
    if len(arrays["cells"]) == 0:
        raise InputError(f"surface must enclose a solid, got none of edge {edge:g} m: use a smaller edge_m")
    mesh, repaired = repair_tets(arrays["nodes"], arrays["cells"])
    if not len(crossing):
        mesh = with_volume(mesh, volume, within_m=envelope)
        repaired = replace(repaired, mesh=mesh)
    off = float(mesh.volumes_m3.sum()) / volume - 1.0
    if abs(off) > _VOLUME_OFF:
        sentences.append(f"The mesh encloses {100.0 * off:+.1f} % of volume against the surface: use smaller edges.")
    return mesh, (*sentences, *repaired.sentences())


def _filled(surface: Surface, edge: float, envelope: float) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [m] and cells by fTetWild."""
    from pytetwild import tetrahedralize  # type: ignore[attr-defined]

    left_behind = Path("__tracked_surface.stl")  # fTetWild writes it where it runs
    there_before = left_behind.exists()
    nodes, cells = tetrahedralize(
        surface.vertices_m,
        surface.faces.astype(np.int32),
        edge_length_abs=edge,
        epsilon=max(envelope / float(np.linalg.norm(np.ptp(surface.vertices_m, axis=0))), 1e-4),
        quiet=True,
        vtk_ordering=True,
    )
    if not there_before:
        left_behind.unlink(missing_ok=True)
    return np.asarray(nodes, dtype=np.float64), np.asarray(cells, dtype=np.int64)
