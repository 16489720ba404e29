"""Body with a hyperelastic region; all other cells are linear.

Cells of the region follow a hyperelastic law. The other cells are linear, so their unknowns are
eliminated once (static condensation, Guyan 1965, AIAA J. 3:380). The border between region and
other cells is restricted to a few displacement modes, ``u_b = P q`` (reduced interface coordinates,
Craig and Chang 1976, NASA CP-2001, 2:393). With the displacement u of the region's inner nodes::

    energy(u, q) = hyperelastic energy of the region's cells + q^T P^T S P q / 2

S is the stiffness of the other cells and of the supports, condensed onto the border. The modes are
the principal displacements of the border under random forces on inner nodes of the linear body
(randomised range, Halko, Martinsson and Tropp 2011, SIAM Rev. 53:217). These modes span the border
displacements of a linear body. The energy is exact if the other cells behave linearly and the modes
span the border displacement. A membrane on the surface is linear everywhere. Membrane faces on the
region's cells contribute to the first term, and other membrane faces contribute to S.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.sparse import bsr_array, coo_array

from meshes.base.arrays import Array, Flags, Ints
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import components_of
from tissue.fem.space import Pattern, Space
from tissue.materials.hyperelasticity import Hyperelastic

MODES = 48
"""Largest number of modes of a border, a multiple of three.

With 24 to 96 modes the forces of `liver-press` differ by at most 0.2 % (`python
tests/bench/bench_law_region.py --modes 24 48 96`).
"""
LOADS = 80
"""Number of random loads from which the modes are computed: `MODES` plus 32."""
SMALLEST = 1e-6
"""Singular value, relative to the largest value, below which a mode is a rounding error."""
SEED = 0
"""Seed of the random loads."""


class RegionBody:
    """Body with a hyperelastic region and linear cells outside this region.

    The unknowns are the displacements of the region's inner nodes, and the amplitudes of the modes
    in which the region's border moves. Three amplitudes are stored in one row, like the
    displacement of a node.

    Parameters
    ----------
    space
        Nodes and cells of the body.
    rest
        Factorised stiffness of the supported body at rest.
    cells
        Indices of the cells of the region.
    loaded
        Sets of body nodes near a contact, each of shape (l,). One set holds the nodes on which
        forces may act. Another set holds the nodes where the law may differ from the linear law.
        The modes are computed from random loads, which are divided equally among the sets. Nodes on
        the border get no load, because such loads would need many modes.
    law, cell_factors
        Hyperelastic law, and the factor on its moduli in each cell of the body, shape (m,).
    membrane
        Function that returns the stiffness of a membrane on given faces of a space [N/m]. None if
        there is no membrane. The stiffness in `rest` must include the membrane on the whole
        surface.

    Attributes
    ----------
    nodes
        Inner nodes of the region, numbered as in the body, shape (n,).
    all_nodes
        All nodes of the region, numbered as in the body, shape (r,).
    body
        Body that consists of the region alone.
    cells
        Indices of the region's cells in the whole body.
    nodes_m, fixed
        Positions [m], and mask of components with zero displacement, each of shape (n + p, 3). Each
        of the last p rows represents three modes. The positions in these rows are not used.
    """

    def __init__(
        self,
        space: Space,
        rest: DirectSolver,
        cells: Ints,
        *,
        loaded: Sequence[Ints],
        law: Hyperelastic,
        cell_factors: Array,
        membrane: Callable[[Space, Ints], bsr_array] | None = None,
    ) -> None:
        corners, places = np.unique(space.mesh.cells[cells], return_inverse=True)
        mesh = TetMesh(space.mesh.nodes_m[corners], places.reshape(-1, 4))
        part = Space(mesh, space.order, device=space.device)
        numbers = np.zeros(part.node_count, np.int64)
        numbers[part.cell_nodes.ravel()] = space.cell_nodes[cells].ravel()
        # There is no membrane on the faces between the region and the other cells.
        skin = part.faces[_are_among(numbers[part.faces[:, :3]], space.faces[:, :3])]
        self.cells = cells
        self.body = NonlinearBody(
            part,
            law=law,
            cell_factors=cell_factors[cells],
            membrane=membrane(part, skin) if membrane is not None and len(skin) else None,
        )
        others = np.setdiff1d(np.arange(space.cell_count), cells)
        is_border = np.isin(numbers, space.cell_nodes[others])
        self._inner = np.flatnonzero(~is_border)
        self._border = np.flatnonzero(is_border)
        self.all_nodes = numbers
        self.nodes = numbers[self._inner]
        self._modes, self._outside = self._reduced(rest, loaded)
        extra = self._modes.shape[1] // 3
        self.nodes_m = np.vstack(
            [part.nodes_m[self._inner], np.tile(part.nodes_m.mean(axis=0), (extra, 1))]
        )
        self.fixed = np.vstack([rest.body.fixed[self.nodes], np.zeros((extra, 3), np.bool_)])
        self._assembly = _Assembly(part.pattern, self._inner, self._border, extra)

    def _reduced(self, rest: DirectSolver, loaded: Sequence[Ints]) -> tuple[Array, Array]:
        """Return the border modes, shape (3b, 3p), and a stiffness in these modes, shape (3p, 3p).

        The stiffness is that of all cells outside the region, condensed onto the border.
        """
        if not len(self._border):
            return np.zeros((0, 0)), np.zeros((0, 0))
        random = np.random.default_rng(SEED)
        loads = np.zeros((rest.body.fixed.size, LOADS))
        for nodes, columns in zip(
            loaded, np.array_split(np.arange(LOADS), len(loaded)), strict=True
        ):
            unknowns = components_of(self.nodes[np.isin(self.nodes, nodes)])
            loads[np.ix_(unknowns, columns)] = random.normal(size=(len(unknowns), len(columns)))
        loads[rest.body.fixed.ravel()] = 0.0
        moved = rest.displacements_m(loads)
        moved = moved[components_of(self.all_nodes)]
        stiffness = self.body.stiffness(np.zeros((len(self.all_nodes), 3)))
        border = components_of(self._border)
        # No load acts on the border. The forces of the other cells therefore balance those of the
        # region there.
        pulls = -(stiffness @ moved)[border]
        pulls[rest.body.fixed[self.all_nodes[self._border]].ravel()] = 0.0
        left, sizes, right = np.linalg.svd(moved[border], full_matrices=False)
        count = min(MODES, 3 * (int((sizes > SMALLEST * sizes[0]).sum()) // 3))
        modes = left[:, :count]
        outside = modes.T @ (pulls @ right[:count].T / sizes[:count])
        return np.ascontiguousarray(modes), 0.5 * (outside + outside.T)

    def gathered(self, nodal_m: Array) -> Array:
        """Return the unknowns [m], shape (n + p, 3), that best fit given nodal displacements."""
        border = nodal_m[self.all_nodes[self._border]].ravel()
        return np.vstack([nodal_m[self.nodes], (self._modes.T @ border).reshape(-1, 3)])

    def nodal_m(self, unknowns_m: Array) -> Array:
        """Return the displacements of `all_nodes` [m], shape (r, 3)."""
        moved = np.empty((len(self.all_nodes), 3))
        count = len(self._inner)
        moved[self._inner] = unknowns_m[:count]
        moved[self._border] = (self._modes @ unknowns_m[count:].ravel()).reshape(-1, 3)
        return moved

    def linear_difference_N(self, unknowns_m: Array) -> Array:
        """Return forces of the linear law minus forces of `law` on `all_nodes` [N], shape (r, 3).

        Under these additional forces, a linear body has the same displacement as this body.
        """
        moved = self.nodal_m(unknowns_m)
        linear = self.body.stiffness(np.zeros_like(moved)) @ moved.ravel()
        return linear.reshape(-1, 3) - self.body.energy_and_force(moved)[1]

    def energy_and_force(self, unknowns_m: Array) -> tuple[float, Array]:
        """Return the energy [J] and the generalised forces [N], shape (n + p, 3).

        The forces are the derivative of the energy with respect to the unknowns.
        """
        energy, nodal = self.body.energy_and_force(self.nodal_m(unknowns_m))
        shares = unknowns_m[len(self._inner) :].ravel()
        pull = self._outside @ shares
        force = np.empty_like(unknowns_m)
        force[: len(self._inner)] = nodal[self._inner]
        on_modes = self._modes.T @ nodal[self._border].ravel() + pull
        force[len(self._inner) :] = on_modes.reshape(-1, 3)
        return energy + 0.5 * float(shares @ pull), force

    def stiffness(self, unknowns_m: Array, *, definite: bool = False) -> bsr_array:
        """Return the tangent stiffness [N/m], shape (3n + 3p, 3n + 3p), see `NonlinearBody`."""
        tangent = self.body.stiffness(self.nodal_m(unknowns_m), definite=definite)
        return self._assembly.assembled(tangent, self._modes, self._outside)


class _Assembly:
    """Block positions of a tangent matrix in which modes replace the nodes on the border.

    Parameters
    ----------
    pattern
        Block pattern of the tangent for all nodes of the region.
    inner, border
        Indices of the inner nodes and of the nodes on the border, in rising order.
    extra
        Number of modes divided by three.
    """

    def __init__(self, pattern: Pattern, inner: Ints, border: Ints, extra: int) -> None:
        nodes = len(inner) + len(border)
        place = np.full(nodes, -1)
        place[inner] = np.arange(len(inner))
        row = np.repeat(np.arange(nodes), np.diff(pattern.row_start))
        column = pattern.column
        is_border = place < 0
        self._kept = np.flatnonzero(~is_border[row] & ~is_border[column])
        self._coupled = np.flatnonzero(is_border[column])
        position = np.zeros(nodes, np.int64)
        position[border] = np.arange(len(border))
        self._border_column = position[column[self._coupled]]
        near = np.unique(row[self._coupled])
        self._starts = np.append(np.searchsorted(row[self._coupled], near), len(self._coupled))
        self._border_rows = np.flatnonzero(is_border[near])
        self._inner_rows = np.flatnonzero(~is_border[near])
        added = len(inner) + np.arange(extra)
        coupling = np.repeat(place[near[self._inner_rows]], extra)
        modes = np.tile(added, len(self._inner_rows))
        rows = [place[row[self._kept]], coupling, modes, np.repeat(added, extra)]
        columns = [place[column[self._kept]], modes, coupling, np.tile(added, extra)]
        size = len(inner) + extra
        places = np.concatenate(rows), np.concatenate(columns)
        numbered = coo_array((np.arange(len(places[0])), places), shape=(size, size)).tocsr()
        numbered.sort_indices()
        self._order = numbered.data
        self._indices = numbered.indices
        self._indptr = numbered.indptr
        self._size = 3 * size

    def assembled(self, tangent: bsr_array, modes: Array, outside: Array) -> bsr_array:
        """Return the tangent of inner nodes and modes, shape (3n + 3p, 3n + 3p)."""
        blocks = tangent.data
        count = modes.shape[1]
        if not count:
            kept = blocks[self._kept][self._order]
            return bsr_array((kept, self._indices, self._indptr), shape=(self._size, self._size))
        rows = len(self._starts) - 1
        to_border = bsr_array(
            (blocks[self._coupled], self._border_column, self._starts),
            shape=(3 * rows, len(modes)),
        )
        product = (to_border @ modes).reshape(rows, 3, count)
        coupling = product[self._inner_rows].reshape(-1, 3, count // 3, 3).transpose(0, 2, 1, 3)
        on_modes = modes.T @ product[self._border_rows].reshape(-1, count) + outside
        on_modes = 0.5 * (on_modes + on_modes.T)
        square = on_modes.reshape(count // 3, 3, count // 3, 3).transpose(0, 2, 1, 3)
        flat = coupling.reshape(-1, 3, 3)
        data = np.concatenate(
            [blocks[self._kept], flat, flat.transpose(0, 2, 1), square.reshape(-1, 3, 3)]
        )
        return bsr_array(
            (data[self._order], self._indices, self._indptr), shape=(self._size, self._size)
        )


def _are_among(faces: Ints, others: Ints) -> Flags:
    """Return a mask of the triangles in `faces` that are also in `others`, shape (f,)."""
    rows = np.vstack([np.sort(faces, axis=1), np.sort(others, axis=1)])
    places = np.unique(rows, axis=0, return_inverse=True)[1].ravel()
    return np.isin(places[: len(faces)], places[len(faces) :])
