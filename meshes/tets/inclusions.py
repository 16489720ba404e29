"""What lies in an organ as a part of its mesh, bounded by faces on its own surface."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.simplices import cross_products
from meshes.shapes.sdf import Shape
from meshes.tets.bisection import Move, bisected
from meshes.tets.checks import mean_ratio
from meshes.tets.stuffing import with_part
from meshes.tets.tetrahedra import TetMesh
from meshes.voxels.mesh_sampling import triangle_distance

__all__ = ["EDGE_GROWTH", "area_of", "with_inclusion"]

EDGE_GROWTH = 0.5
"""Growth of the edges with the distance from where they are fine, as in scenes."""
_EDGES = 3.0
"""Edges across a ball, or two across a tube: quadratic ones bend with it."""
_TRIES, _CLOSE = 4, 0.01
"""Meshes of an inclusion that are tried, and the share of its volume that is close enough: of those that are the one
with the best worst cell is kept, else the nearest."""


def with_inclusion(
    mesh: TetMesh,
    name: str,
    vertices_m: NDArray[np.float64],
    triangles: NDArray[np.int64],
    *,
    volume_m3: float,
    onto: Move | None = None,
) -> tuple[TetMesh, str]:
    """The mesh with what lies in a closed surface as a part of its own, and a note on its volume.

    Edges on the surface are at most twice its volume over its area, a third of a ball's diameter. What a part before it
    has stays with that.

    Parameters
    ----------
    mesh, name
        Where it lies, and what it is called.
    vertices_m, triangles
        Its surface [m], wound outward, which may go on outside of the mesh.
    volume_m3
        Volume of what lies inside the mesh [m3].
    onto
        Nearest points of the surface that the mesh stands for; its surface nodes are moved there.

    Raises
    ------
    InputError
        If it lies outside the mesh.
    """

    def distance(points: NDArray[np.floating]) -> NDArray[np.float64]:
        return triangle_distance(vertices_m, triangles, points)

    area_m2 = area_of(vertices_m, triangles)
    edge_m = 6.0 / _EDGES * volume_m3 / area_m2
    fine = bisected(mesh, lambda points: edge_m + EDGE_GROWTH * np.abs(distance(points)), onto=onto)
    # Chords cut a round body's volume short: the surface is laid outside it by as much as makes the volume right.
    laid_m, made, share, best = 0.0, fine, 1.0, (np.inf, 0.0)
    for _ in range(_TRIES):
        tried = with_part(fine, Shape(lambda points: distance(points) - laid_m), name)  # noqa: B023
        missing_m3 = volume_m3 - float(tried.volumes_m3[tried.part == len(tried.part_names) - 1].sum())
        off = abs(missing_m3) / volume_m3
        score = max(off, _CLOSE), -float(mean_ratio(tried.nodes_m, tried.cells).min())
        if score < best:
            made, share, best = tried, off, score
        laid_m += missing_m3 / area_m2
    size = f"{1e6 * volume_m3:.3g} ml, in the mesh within {share:.1%}"
    return made, f"{size} by edges of at most {1e3 * edge_m:.2g} mm"


def area_of(vertices_m: NDArray[np.float64], triangles: NDArray[np.int64]) -> float:
    """Area of triangles [m2]."""
    return 0.5 * float(np.linalg.norm(cross_products(vertices_m, triangles), axis=1).sum())
