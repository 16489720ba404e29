"""What was found in a tetrahedral mesh and done to it, in sentences."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import by, in_brackets
from meshes.tets.checks import mean_ratio, pieces, pinched_edges
from meshes.tets.tetrahedra import TetMesh

__all__ = ["FLAT", "SLIVER", "TetReport", "millimetres", "place"]

FLAT = 1e-6
"""Six volumes over the longest edge cubed below which a tetrahedron is flat (0.71: regular)."""
SLIVER = 0.1
"""Mean ratio below which a tetrahedron is a sliver (1: regular)."""
_UNEVEN = 1e-3


@dataclass(frozen=True, eq=False)
class TetReport:
    """What was found in a tetrahedral mesh and done to it; places in mm in the frame of the mesh, empty if nowhere.

    Attributes
    ----------
    mesh
        The mesh returned.
    joined_nodes, repeated_cells
        Coincident nodes joined, cells dropped because another has the same nodes.
    inverted, inverted_at_mm, flat_dropped, flat_moved
        Cells turned and where the first was, flat cells dropped, flat cells given volume.
    debris_mm3
        Volume of each piece dropped.
    slivers, sliver_at_mm, nodes_moved
        Slivers found, where the worst was, inner nodes moved.
    """

    mesh: TetMesh
    joined_nodes: int
    repeated_cells: int
    inverted: int
    inverted_at_mm: tuple[float, ...]
    flat_dropped: int
    flat_moved: int
    debris_mm3: tuple[float, ...]
    slivers: int
    sliver_at_mm: tuple[float, ...]
    nodes_moved: int

    @property
    def slivers_left(self) -> int:
        """Slivers in the mesh returned."""
        return int((mean_ratio(self.mesh.nodes_m, self.mesh.cells) < SLIVER).sum())

    def sentences(self) -> tuple[str, ...]:
        """What was found and done, a sentence each; the first describes the mesh itself."""
        nodes, cells, volumes = self.mesh.nodes_m, self.mesh.cells, self.mesh.volumes_m3
        quality, pinched, bodies = mean_ratio(nodes, cells), pinched_edges(self.mesh.surface), pieces(cells).max() + 1
        worst, smallest = (place(millimetres(nodes[cells[each.argmin()]])) for each in (quality, volumes))
        share = float(volumes.min() / volumes.max())
        found = [
            (
                True,
                f"{len(cells)} tetrahedra on {len(nodes)} nodes, {1e6 * volumes.sum():.4g} ml, "
                f"{by(1e3 * np.ptp(nodes, axis=0), '.3g')} mm, lowest mean ratio {quality.min():.2g} at {worst} mm.",
            ),
            (
                share < _UNEVEN,
                f"The smallest tetrahedron, at {smallest} mm, has 1/{1.0 / share:.0f} of the volume of the largest.",
            ),
            (
                self.inverted,
                f"Turned {self.inverted} inverted tetrahedra, the first at {place(self.inverted_at_mm)} mm.",
            ),
            (self.joined_nodes, f"Joined or dropped {self.joined_nodes} nodes that coincide or are unused."),
            (self.repeated_cells, f"Dropped {self.repeated_cells} tetrahedra that repeat another."),
            (self.flat_dropped, f"Dropped {self.flat_dropped} flat tetrahedra at the surface."),
            (self.flat_moved, f"Gave volume to {self.flat_moved} flat tetrahedra inside by moving their nodes."),
            (
                self.debris_mm3,
                f"Dropped {len(self.debris_mm3)} loose pieces of {sum(self.debris_mm3):.3g} mm3 together, the largest "
                f"{max(self.debris_mm3, default=0.0):.3g} mm3.",
            ),
            (bodies > 1, f"The mesh is {bodies} bodies not linked by faces: each needs its own support."),
            (
                self.slivers,
                f"Found {self.slivers} slivers (mean ratio below {SLIVER:g}), the worst at "
                f"{place(self.sliver_at_mm)} mm; moving {self.nodes_moved} inner nodes left {self.slivers_left}.",
            ),
        ]
        notes = [sentence for is_so, sentence in found if is_so]
        if len(pinched):
            notes.append(
                f"Kept {len(pinched)} surface edges of more than two triangles (pinched, as at "
                f"{place(millimetres(nodes[pinched[0]]))} mm): stresses there mean little."
            )
        return tuple(notes)


def millimetres(points_m: NDArray[np.float64]) -> tuple[float, float, float]:
    """Mean of points [m], shape (n, 3), in mm."""
    x, y, z = 1e3 * points_m.mean(axis=0)
    return float(x), float(y), float(z)


def place(at_mm: tuple[float, ...]) -> str:
    """Place [mm] as a person reads it."""
    return in_brackets(at_mm, ".3g")
