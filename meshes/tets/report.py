"""What was found in a tetrahedral mesh and done to it, in sentences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["FLAT", "SLIVER", "TetReport", "millimetres", "place"]

FLAT = 1e-6
"""Six volumes over the longest edge cubed below which a tetrahedron is flat (0.71: regular)."""
SLIVER = 0.1
"""Mean ratio below which a tetrahedron is a sliver (1: regular)."""
_UNEVEN = 1e-3


@dataclass(frozen=True)
class TetReport:
    """What was found in a tetrahedral mesh and done to it; places in mm in the frame of the mesh.

    Attributes
    ----------
    node_count, cell_count, volume_mm3, size_mm
        Of the mesh returned.
    joined_nodes, repeated_cells
        Coincident nodes joined, cells dropped because another has the same nodes.
    inverted, inverted_at_mm, flat_dropped, flat_moved
        Cells turned and where the first was, flat cells dropped, flat cells given volume.
    debris_mm3
        Volume of each piece dropped.
    bodies
        Pieces left.
    slivers, slivers_left, sliver_at_mm, nodes_moved
        Slivers found, slivers left, where the worst was, inner nodes moved.
    smallest_share, smallest_at_mm
        Volume of the smallest cell relative to the largest, and its centre.
    worst_quality, worst_at_mm
        Lowest mean ratio left and the centre of that cell.
    pinched, pinched_at_mm
        Surface edges of more than two triangles, and the middle of the first.
    """

    node_count: int
    cell_count: int
    volume_mm3: float
    size_mm: tuple[float, float, float]
    joined_nodes: int
    repeated_cells: int
    inverted: int
    inverted_at_mm: tuple[float, float, float] | None
    flat_dropped: int
    flat_moved: int
    debris_mm3: tuple[float, ...]
    bodies: int
    slivers: int
    slivers_left: int
    sliver_at_mm: tuple[float, float, float] | None
    nodes_moved: int
    smallest_share: float
    smallest_at_mm: tuple[float, float, float]
    worst_quality: float
    worst_at_mm: tuple[float, float, float]
    pinched: int
    pinched_at_mm: tuple[float, float, float] | None

    def sentences(self) -> tuple[str, ...]:
        """What was found and done, a sentence each; the first describes the mesh itself."""
        notes = [
            f"{self.cell_count} tetrahedra on {self.node_count} nodes, {self.volume_mm3 * 1e-3:.4g} ml, "
            f"{' x '.join(f'{s:.3g}' for s in self.size_mm)} mm, lowest mean ratio {self.worst_quality:.2g} "
            f"at {place(self.worst_at_mm)} mm."
        ]
        if self.smallest_share < _UNEVEN:
            notes.append(
                f"The smallest tetrahedron, at {place(self.smallest_at_mm)} mm, has 1/{1.0 / self.smallest_share:.0f} "
                "of the volume of the largest."
            )
        if self.inverted_at_mm is not None:
            notes.append(f"Turned {self.inverted} inverted tetrahedra, the first at {place(self.inverted_at_mm)} mm.")
        if self.joined_nodes:
            notes.append(f"Joined or dropped {self.joined_nodes} nodes that coincide or are unused.")
        if self.repeated_cells:
            notes.append(f"Dropped {self.repeated_cells} tetrahedra that repeat another.")
        if self.flat_dropped:
            notes.append(f"Dropped {self.flat_dropped} flat tetrahedra at the surface.")
        if self.flat_moved:
            notes.append(f"Gave volume to {self.flat_moved} flat tetrahedra inside by moving their nodes.")
        if self.debris_mm3:
            notes.append(
                f"Dropped {len(self.debris_mm3)} loose pieces of {sum(self.debris_mm3):.3g} mm3 together, the largest "
                f"{max(self.debris_mm3):.3g} mm3."
            )
        if self.bodies > 1:
            notes.append(f"The mesh is {self.bodies} bodies not linked by faces: each needs its own support.")
        if self.sliver_at_mm is not None:
            notes.append(
                f"Found {self.slivers} slivers (mean ratio below {SLIVER:g}), the worst at "
                f"{place(self.sliver_at_mm)} mm; moving {self.nodes_moved} inner nodes left {self.slivers_left}."
            )
        if self.pinched_at_mm is not None:
            notes.append(
                f"Kept {self.pinched} surface edges of more than two triangles (pinched, as at "
                f"{place(self.pinched_at_mm)} mm): stresses there mean little."
            )
        return tuple(notes)


def millimetres(points_m: NDArray[np.float64]) -> tuple[float, float, float]:
    """Mean of points [m], shape (n, 3), in mm."""
    x, y, z = 1e3 * points_m.mean(axis=0)
    return float(x), float(y), float(z)


def place(at_mm: tuple[float, float, float]) -> str:
    """Place [mm] as a person reads it."""
    return "(" + ", ".join(f"{x:.3g}" for x in at_mm) + ")"
