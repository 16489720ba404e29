"""Tetrahedral bodies for tests: distorted boxes, axisymmetric wedges, supports, and plain solves through SciPy."""

import numpy as np
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import cg, splu

from meshes.tets.structured import box, mapped
from meshes.tets.tetrahedra import TetMesh
from tissue.fem.space import Space


def distorted(cells, *, amount=0.2, seed=0):
    """Unit cube whose inner nodes are moved at random, by `amount` of an edge at most."""
    mesh = box((1.0, 1.0, 1.0), (cells,) * 3)
    inner = ((mesh.nodes_m > 1e-9) & (mesh.nodes_m < 1.0 - 1e-9)).all(axis=1)
    step = np.random.default_rng(seed).uniform(-amount, amount, mesh.nodes_m.shape) / cells
    return TetMesh(mesh.nodes_m + inner[:, None] * step, mesh.cells)


def slab(across, into, thickness):
    """One brick thick in z: the unit square, cut into `across` bricks, moved by `into` from (n, 2) to (n, 2)."""
    return mapped((*across, 1), lambda unit: np.column_stack([into(unit[:, :2]), thickness * unit[:, 2]]))


def wedge(radii, depths, angle):
    """Wedge of `angle` about the z axis: planes at `radii` from 0, and z at `depths`; the bricks at the axis are prisms."""
    shape = (len(radii) - 1, 1, len(depths) - 1)
    unit = box((1.0, 1.0, 1.0), shape)
    place = np.rint(unit.nodes_m * shape).astype(int)
    r, turn = np.asarray(radii)[place[:, 0]], angle * place[:, 1]
    nodes = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.asarray(depths)[place[:, 2]]])
    label = np.arange(len(nodes))
    axis = (place[:, 0] == 0) & (place[:, 1] == 1)
    label[axis] -= len(depths)  # nodes run along z fastest, then around
    cells = label[unit.cells]
    whole = np.array([len(set(cell)) == 4 for cell in cells])
    used, cells = np.unique(cells[whole], return_inverse=True)
    return TetMesh(nodes[used], cells.reshape(-1, 4))


def solve(matrix, load, held, moved=None, *, frame=None):
    """Displacement, shape (n, 3), where `held` components of nodes are moved as `moved` says, or not at all.

    `frame`, shape (n, 3, 3), turns the components held: its rows are each node's own axes.
    """
    load = np.asarray(load, dtype=float).ravel()
    turn = None
    if frame is not None:
        count = len(frame)
        rows, columns = (np.broadcast_to(i, (count, 3, 3)).ravel() for i in np.indices((3, 3)))
        start = np.repeat(3 * np.arange(count), 9)
        turn = csr_array((frame.ravel(), (start + rows, start + columns)))
        matrix, load = turn @ matrix.tocsr() @ turn.T, turn @ load
    found = np.zeros(held.size) if moved is None else np.where(held, moved, 0.0).ravel()
    free = np.flatnonzero(~held.ravel())
    rows = matrix.tocsr()
    right = (load - rows @ found)[free]
    inner = csc_array(rows[free][:, free])
    found[free] = splu(inner, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}, diag_pivot_thresh=0.0).solve(
        right
    )
    return (found if turn is None else turn.T @ found).reshape(-1, 3)


def solve_iteratively(matrix, load, held, moved=None, *, tolerance=1e-8):
    """As `solve`, by conjugate gradients preconditioned with the diagonal: for large bodies that are well conditioned."""
    found = np.zeros(held.size) if moved is None else np.where(held, moved, 0.0).ravel()
    free = np.flatnonzero(~held.ravel())
    rows = matrix.tocsr()
    right = (np.asarray(load, dtype=float).ravel() - rows @ found)[free]
    inner = csr_array(rows[free][:, free])
    found[free], failed = cg(inner, right, rtol=tolerance, maxiter=5000, M=diags_array(1.0 / inner.diagonal()))
    assert failed == 0
    return found.reshape(-1, 3)


def planes(space, **where):
    """Which components are held, shape (n, 3): `planes(space, x=0.0)` holds x on the plane x = 0, and so on."""
    held = np.zeros((space.node_count, 3), dtype=bool)
    size = np.ptp(space.nodes_m, axis=0).max()
    for name, at in where.items():
        axis = "xyz".index(name)
        held[np.abs(space.nodes_m[:, axis] - at) < 1e-9 * size, axis] = True
    return held


def faces_where(space: Space, inside):
    """Faces of the surface all of whose corners satisfy `inside`, a function of positions (n, 3)."""
    return space.faces[inside(space.nodes_m)[space.faces[:, :3]].all(axis=1)]


def slope(sizes, errors):
    """Order of convergence: the fitted slope of log error over log size."""
    return float(np.polyfit(np.log(sizes), np.log(errors), 1)[0])
