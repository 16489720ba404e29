"""Displacement spaces on tetrahedra: linear (P1) and quadratic (P2).

Linear spaces have nodes at corners, quadratic spaces also in the middles of edges.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import warp as wp

from kernels.launcher import SplitLaunch
from kernels.tetrahedra import cell_gradients
from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.pattern import Pattern, grouped
from tissue.fem.shapes import EDGES, TRIANGLE_EDGES

__all__ = ["Space"]


@dataclass(frozen=True, eq=False)
class Space:
    """Continuous displacements, linear or quadratic in each cell; three unknowns x, y, z a node.

    Attributes
    ----------
    mesh
        The cells, with straight edges.
    order
        1 or 2. Linear cells lock as Poisson's ratio nears 0.5; quadratic ones do not.
    device
        Warp device name.

    Raises
    ------
    InputError
        If the order is neither 1 nor 2.
    """

    mesh: TetMesh
    order: int = 1
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.order not in (1, 2):
            raise InputError(
                "order", "be 1 or 2", self.order, "use 2 where Poisson's ratio is above 0.45"
            )

    @property
    def node_count(self) -> int:
        """Number of nodes."""
        return len(self.mesh.nodes_m) + (len(self._edges[0]) if self.order == 2 else 0)

    @property
    def unknown_count(self) -> int:
        """Number of unknowns, three a node."""
        return 3 * self.node_count

    @property
    def cell_count(self) -> int:
        """Number of cells."""
        return len(self.mesh.cells)

    @cached_property
    def nodes_m(self) -> Array:
        """Node positions [m]: nodes of the mesh, then middles of its edges, shape (n, 3)."""
        corners = self.mesh.nodes_m
        if self.order == 1:
            return corners
        a, b = self._edges[0].T
        return np.concatenate([corners, 0.5 * (corners[a] + corners[b])])

    @cached_property
    def cell_nodes(self) -> Ints:
        """Nodes of each cell, shape (m, 4) or (m, 10).

        Corners come first, then the middles of `EDGES` in VTK's order.
        """
        if self.order == 1:
            return self.mesh.cells
        return np.concatenate([self.mesh.cells, len(self.mesh.nodes_m) + self._edges[1]], axis=1)

    @cached_property
    def faces(self) -> Ints:
        """Nodes of each face of the surface, shape (f, 3) or (f, 6).

        Corners as in the mesh come first, then middles.
        """
        return self.with_middles(self.mesh.surface)

    def with_middles(self, triangles: Ints) -> Ints:
        """Return triangles with their middle nodes where the space is quadratic.

        The triangles are faces of cells, shape (f, 3).
        """
        if self.order == 1:
            return triangles
        ends = np.sort(triangles[:, TRIANGLE_EDGES], axis=2)
        count = len(self.mesh.nodes_m)
        known = self._edges[0] @ np.array([count, 1])
        wanted = ends @ np.array([count, 1])
        return np.concatenate([triangles, count + np.searchsorted(known, wanted)], axis=1)

    @cached_property
    def pattern(self) -> Pattern:
        """Positions of the blocks of a matrix on this space."""
        return Pattern.of(self.cell_nodes, self.node_count)

    @cached_property
    def gradients(self) -> tuple[wp.array[object], wp.array[object]]:
        """Gradients of the barycentric coordinates [1/m] and volumes [m3] on the device.

        The gradients are vectors of shape (m, 4), the volumes have shape (m,).
        """
        count = self.cell_count
        nodes: wp.array[object] = wp.array(self.mesh.nodes_m, dtype=wp.vec3d, device=self.device)
        cells: wp.array[object] = wp.array(
            self.mesh.cells.astype(np.int32), dtype=wp.int32, device=self.device
        )
        outputs = [
            wp.empty((count, 4), dtype=wp.vec3d, device=self.device),
            wp.empty(count, dtype=wp.float64, device=self.device),
        ]
        SplitLaunch(
            cell_gradients,
            dim=count,
            inputs=[nodes, cells, 0],
            outputs=outputs,
            offset_index=2,
            device=self.device,
        )()
        return outputs[0], outputs[1]

    @cached_property
    def volumes_m3(self) -> Array:
        """Volume of each cell [m3], shape (m,)."""
        return np.asarray(self.gradients[1].numpy())

    @cached_property
    def _edges(self) -> tuple[Ints, Ints]:
        """Corners of each edge in rising order, (e, 2), and edges of each cell, (m, 6)."""
        ends = np.sort(self.mesh.cells[:, EDGES].reshape(-1, 2), axis=1).astype(np.int32)
        order, start = grouped(ends[:, 0], ends[:, 1], len(self.mesh.nodes_m))
        edge_of = np.empty(len(order), dtype=np.int64)
        edge_of[order] = np.repeat(np.arange(len(start) - 1), np.diff(start))
        return ends[order[start[:-1]]].astype(np.int64), edge_of.reshape(-1, len(EDGES))
