"""Nonlinear region of a body whose remainder is linear.

Cells of the region follow a hyperelastic law. The other cells are linear, so that they can be
eliminated once (static condensation, Guyan 1965, AIAA J. 3:380). With u the displacement of the
nodes of the region and u_b those on its border::

    energy(u) = hyperelastic energy of the region's cells + u_b^T S u_b / 2

S is the stiffness of the other cells and of the supports, condensed onto the border. The energy is
exact where the other cells are linear. A membrane on the surface is linear everywhere. Its faces
on the region's cells belong to the first term, and its other faces to S.
"""

from collections.abc import Callable

import numpy as np
from scipy.sparse import bsr_array, diags_array

from meshes.base.arrays import Array, Flags, Ints
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, components_of
from tissue.fem.space import Space
from tissue.materials.hyperelasticity import Hyperelastic

__all__ = ["RegionBody"]


class RegionBody:
    """Body with a hyperelastic region in a linear remainder.

    Parameters
    ----------
    space
        Nodes and cells of the body.
    rest
        Stiffness of the body at rest, and its supports.
    cells
        Numbers of the cells of the region.
    law, cell_factors
        Law, and factors of its moduli in each cell of the body, shape (m,).
    membrane
        Function that returns the stiffness of a membrane on faces of a space [N/m]; None for no
        membrane. The stiffness at rest contains the membrane on the whole surface.

    Attributes
    ----------
    nodes
        Nodes of the region in the body, shape (n,).
    nodes_m, fixed
        Positions of these nodes [m], and components with zero displacement, shape (n, 3) both.
    """

    def __init__(
        self,
        space: Space,
        rest: HeldBody,
        cells: Ints,
        *,
        law: Hyperelastic,
        cell_factors: Array,
        membrane: Callable[[Space, Ints], bsr_array] | None = None,
    ) -> None:
        corners, places = np.unique(space.mesh.cells[cells], return_inverse=True)
        mesh = TetMesh(space.mesh.nodes_m[corners], places.reshape(-1, 4))
        part = Space(mesh, space.order, device=space.device)
        self.nodes = np.zeros(part.node_count, np.int64)
        self.nodes[part.cell_nodes.ravel()] = space.cell_nodes[cells].ravel()
        self.nodes_m = part.nodes_m
        self.fixed = rest.fixed[self.nodes]
        # The faces between the region and the other cells carry no membrane.
        skin = part.faces[_are_among(self.nodes[part.faces[:, :3]], space.faces[:, :3])]
        self._body = NonlinearBody(
            part,
            None,
            law=law,
            cell_factors=cell_factors[cells],
            membrane=membrane(part, skin) if membrane is not None and len(skin) else None,
        )
        others = np.setdiff1d(np.arange(space.cell_count), cells)
        border = np.flatnonzero(np.isin(self.nodes, space.cell_nodes[others]))
        # In the order of the body's nodes, as the condensed stiffness has them.
        self._border = border[np.argsort(self.nodes[border])]
        self._outside = self._condense(rest)
        self._outside_blocks = self._blocks_of_outside()

    def _condense(self, rest: HeldBody) -> Array:
        """Return the stiffness of the other cells, condensed onto the border [N/m]."""
        border = self.nodes[self._border]
        whole = DirectSolver(rest, last=border).stiffness_of_last()
        inner = self._body.stiffness(np.zeros_like(self.nodes_m))
        rows = components_of(self._border)
        # The region alone may be free to move. Springs on its border hold it, and are taken off.
        springs = np.zeros(self.fixed.size)
        springs[rows] = inner.diagonal().mean()
        held = bsr_array((inner + diags_array(springs)).tobsr((3, 3)))
        order = np.argsort(self._border)
        alone = DirectSolver(
            HeldBody(held, self.nodes_m, self.fixed, is_grounded=True), last=self._border[order]
        ).stiffness_of_last()
        back = components_of(np.argsort(order))
        outside: Array = whole - alone[np.ix_(back, back)] + np.diag(springs[rows])
        fixed = self.fixed[self._border].ravel()
        outside[fixed] = 0.0
        outside[:, fixed] = 0.0
        return outside

    def _blocks_of_outside(self) -> bsr_array:
        """Return the condensed stiffness as a sparse matrix of the region, shape (3n, 3n)."""
        count = len(self._border)
        blocks = self._outside.reshape(count, 3, count, 3).transpose(0, 2, 1, 3)
        order = np.argsort(self._border)
        rising = self._border[order]
        starts = np.zeros(len(self.nodes) + 1, np.int64)
        starts[rising + 1] = count
        size = self.fixed.size
        return bsr_array(
            (
                np.ascontiguousarray(blocks[np.ix_(order, order)].reshape(-1, 3, 3)),
                np.tile(rising, count),
                np.cumsum(starts),
            ),
            shape=(size, size),
        )

    def energy_and_force(self, displacement_m: Array) -> tuple[float, Array]:
        """Return the energy [J] and its derivative, shape (n, 3) [N]."""
        energy, force = self._body.energy_and_force(displacement_m)
        moved = displacement_m[self._border].ravel()
        pull = self._outside @ moved
        force[self._border] += pull.reshape(-1, 3)
        return energy + 0.5 * float(moved @ pull), force

    def stiffness(self, displacement_m: Array, *, definite: bool = False) -> bsr_array:
        """Return the tangent stiffness [N/m], shape (3n, 3n), as for `NonlinearBody`."""
        tangent = self._body.stiffness(displacement_m, definite=definite)
        return bsr_array(tangent + self._outside_blocks)


def _are_among(faces: Ints, others: Ints) -> Flags:
    """Return which triangles, by their three nodes, are among other triangles, shape (f,)."""
    rows = np.vstack([np.sort(faces, axis=1), np.sort(others, axis=1)])
    places = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    found: Flags = np.isin(places[: len(faces)], places[len(faces) :])
    return found
