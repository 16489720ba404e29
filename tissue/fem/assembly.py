"""Assembled stiffness and loads of tetrahedra, and stiffness of a capsule on the surface.

The stiffness of tetrahedra is stored in 3x3 blocks. For each pair of nodes one block is summed. Its
transpose is copied to the mirrored position.

A capsule is a thin elastic membrane on the surface, in plane stress.

The membrane resists stretch but not bending. Bending of a capsule, for example around a needle, is
not modelled.

Let P = I - n n^T be the projection onto a face. The strain is ``P sym(grad u) P``. The block of a
pair of nodes is ``t (lambda' S + mu S^T + mu tr(S) P)``, with the thickness t and lambda' = E nu /
(1 - nu^2). S is the sum of products of shape gradients, as in the formula for cells in
`kernels.tetrahedra`.

Prefer linear cells under a stiff capsule on a curved body. Quadratic cells with straight edges have
nodes in the middle of flat pieces of membrane. Flat pieces carry no pressure, so the corners are
displaced inwards too far. With 7 cells per quadrant, and a capsule as stiff as the body, the
displacement of the corners has an error of 8 %. The mean displacement has an error of 2 %.
"""

from functools import cache

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from scipy.sparse import bsr_array

from kernels.launcher import SplitLaunch
from kernels.tetrahedra import pair_stiffness, pair_stiffness_isotropic
from meshes.base.arrays import Array, Int32s, Ints
from tissue.fem.space import (
    EDGES,
    Pattern,
    Space,
    gradient_products,
    local_pairs,
    mean_gradient_products,
    mean_shape,
)
from tissue.materials.elasticity import elasticity_rows, lame

SOFTENED_RATIO = 1.0
"""Unsoftened part of the first Lame constant, divided by the shear modulus.

In the scene `palpation`, a probe presses above a nodule, which adds an excess force. With mesh
edges of 4 mm and a ratio of 1, the excess force has an error of 2.5 %, and the total force has an
error of -0.1 %. With a ratio of 2, the errors are 3.5 % and +0.4 %. Without softening and with mesh
edges of 5 mm, the errors are 10 % and 3.6 % (`python tests/bench/bench_nodule.py --parts meshes`).
With a ratio of 0 and mesh edges of 5 mm, the displacement under Hertz's pressure is up to 5 % too
large.
"""


def assemble(space: Space, elasticity: ArrayLike, *, softened: bool = False) -> bsr_array:
    """Return the stiffness matrix of linear elastic cells [N/m], stored in 3x3 blocks.

    The shape is (unknowns, unknowns). The matrix contains both triangles. They are bitwise equal,
    whatever the number of cores. The integrals over the cells are exact.

    Quadratic cells with straight edges lock if Poisson's ratio is near 0.5. Softened cells do not
    lock. In a softened cell, a part of the first Lame constant acts only on the cell's mean volume
    change. This part is the excess over `SOFTENED_RATIO` times the shear modulus (mean dilatation:
    Nagtegaal, Parks and Rice 1974, Comput. Methods Appl. Mech. Eng. 4:153). Cells with a Poisson's
    ratio of up to 1/4 are not softened.

    Parameters
    ----------
    space
        Nodes and cells. After the first call, the space keeps the positions of the matrix blocks
        for later calls.
    elasticity
        Lame constants [Pa], shape (2,) or (m, 2), or stiffness matrices [Pa], shape (6, 6) or (m,
        6, 6), as returned by `tissue.materials.elasticity`.
    softened
        True to soften the quadratic cells whose Poisson's ratio is near 0.5, because they would
        lock.

    Raises
    ------
    InputError
        If the elasticity has a wrong shape or is not positive definite.
    """
    rows = elasticity_rows(elasticity, space.cell_count)
    pattern = space.pattern
    less = _softening(rows) if softened else np.zeros(1)
    blocks = wp.empty(len(pattern.column), wp.mat33d, space.device)
    places = [pattern.pair_start, pattern.contribution, pattern.place, pattern.mirror]
    SplitLaunch(
        pair_stiffness_isotropic if rows.ndim == 2 else pair_stiffness,
        len(pattern.place),
        [*places, *pair_tables(space.order), *space.gradients, rows, less],
        [blocks],
    )()
    return bsr_array(
        (blocks.numpy(), pattern.column, pattern.row_start), shape=(space.unknown_count,) * 2
    )


def _softening(rows: Array) -> Array:
    """Return the part of the first Lame constant [Pa] that resists only a mean volume change.

    The result has one value for each row, shape (rows,). For a stiffness matrix C, the Lame
    constants are derived from the largest shear modulus and from the bulk modulus under hydrostatic
    stress. The bulk modulus is 1 / (v C^-1 v), with v = (1, 1, 1, 0, 0, 0). The softened matrices
    are still positive definite.
    """
    if rows.ndim == 2:
        return np.maximum(rows[:, 0] - SOFTENED_RATIO * rows[:, 1], 0.0)
    uniform = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    bulk = 1.0 / np.linalg.solve(rows, uniform[:, None])[..., 0].dot(uniform)
    shear = np.diagonal(rows, axis1=1, axis2=2)[:, 3:].max(axis=1)
    return np.maximum(bulk - (SOFTENED_RATIO + 2.0 / 3.0) * shear, 0.0)


@cache
def pair_tables(order: int) -> tuple[Int32s, Array, Array]:
    """Return corners and two sets of weights for each pair of shape functions in a cell.

    Each of the three arrays has shape (p, 4). Shape function A belongs to the corners i and j, and
    B belongs to k and n. The weights multiply the products of the gradients of the barycentric
    coordinates i and k, i and n, j and k, and j and n. With the first array, the weighted sum is
    the cell's mean of the product of A's and B's gradients. With the second array, the weighted sum
    is the product of the mean gradients of A and B.
    """
    products = gradient_products(4, order)
    # The four functions of the corners come first, then the functions of the edges of a quadratic
    # cell.
    ends = np.concatenate([np.stack([np.arange(4)] * 2, axis=1), EDGES[: len(products) - 4]])
    a, b = local_pairs(len(products)).T
    corners = np.concatenate([ends[a], ends[b]], axis=1)
    i, j, k, n = corners.T
    # The function of a corner has only one gradient, which is counted once.
    once = np.stack([np.ones(len(i)), k != n, i != j, (i != j) & (k != n)], axis=1)

    def weights(of: Array) -> Array:
        each = [of[a, b, p, q] for p, q in ((i, k), (i, n), (j, k), (j, n))]
        return np.stack(each, axis=1) * once

    return (
        corners.astype(np.int32),
        weights(products),
        weights(mean_gradient_products(4, order)),
    )


def capsule_stiffness(
    space: Space,
    *,
    thickness_m: float,
    young_Pa: float,
    poisson_ratio: float,
    faces: Ints | None = None,
) -> bsr_array:
    """Return the stiffness matrix [N/m] of a membrane on faces of the surface.

    Add the result to the stiffness matrix of the cells.

    The shape is (unknowns, unknowns), in blocks of 3x3. The matrix is bitwise symmetric. The sum of
    this matrix and the matrix of the cells is bitwise symmetric, too.

    Parameters
    ----------
    space
        Nodes and cells.
    thickness_m
        Thickness [m].
    young_Pa, poisson_ratio
        Young's modulus [Pa] and Poisson's ratio of the membrane.
    faces
        Nodes of the faces with a membrane, shape (f, 3) or (f, 6); default all of `Space.faces`.

    Raises
    ------
    InputError
        If a constant is out of range.
    """
    shear = float(lame(young_Pa, poisson_ratio)[1])
    first = young_Pa * poisson_ratio / (1.0 - poisson_ratio**2)
    nodes = space.faces if faces is None else faces
    corners = space.nodes_m[nodes[:, :3]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normal, axis=1)
    normal /= double_area[:, None]
    opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)  # c - b, a - c, b - a
    gradient = np.cross(normal[:, None], opposite) / double_area[:, None, None]
    a, b = local_pairs(nodes.shape[1]).T
    weight = gradient_products(3, space.order)[a, b]
    size = 0.5 * double_area * thickness_m
    product = np.einsum("f,xcd,fci,fdj->fxij", size, weight, gradient, gradient, optimize=True)
    plane = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    shares = first * product + shear * product.swapaxes(2, 3)
    shares += shear * np.trace(product, axis1=2, axis2=3)[..., None, None] * plane[:, None]
    return _summed(
        shares.reshape(-1, 3, 3), Pattern.of(nodes, space.node_count), space.unknown_count
    )


def _summed(shares: Array, pattern: Pattern, unknown_count: int) -> bsr_array:
    """Return the matrix of blocks that are summed in the order of the faces and then mirrored."""
    turned = pattern.contribution < 0
    ordered = shares[np.where(turned, ~pattern.contribution, pattern.contribution)]
    ordered[turned] = ordered[turned].swapaxes(1, 2)
    blocks = np.add.reduceat(ordered, pattern.pair_start[:-1], axis=0)
    diagonal = pattern.place == pattern.mirror
    blocks[diagonal] = np.triu(blocks[diagonal]) + np.triu(blocks[diagonal], 1).swapaxes(1, 2)
    values = np.empty((len(pattern.column), 3, 3))
    values[pattern.place] = blocks
    values[pattern.mirror] = blocks.swapaxes(1, 2)
    return bsr_array((values, pattern.column, pattern.row_start), shape=(unknown_count,) * 2)


STANDARD_GRAVITY_M_S2 = 9.80665
"""Standard acceleration of free fall [m/s2]."""


def gravity(space: Space, *, density_kg_m3: ArrayLike) -> Array:
    """Return the nodal forces due to the weight of the cells [N], shape (n, 3).

    The weight acts along -z. The density [kg/m3] is one number, or one number for each cell, shape
    (m,).
    """
    mass = np.asarray(density_kg_m3, np.float64) * space.volumes_m3
    force = mass[:, None] * np.array([0.0, 0.0, -STANDARD_GRAVITY_M_S2])
    return _spread(space, space.cell_nodes, force, mean_shape(4, space.order))


def traction(space: Space, traction_Pa: ArrayLike, *, faces: Ints | None = None) -> Array:
    """Return the nodal forces [N], shape (n, 3), of a traction on faces of the surface.

    Parameters
    ----------
    space
        Nodes and cells.
    traction_Pa
        Force per area [Pa], shape (3,), or one force per area for each face, shape (f, 3).
    faces
        Nodes of the faces, shape (f, 3) or (f, 6); default all of `Space.faces`.
    """
    nodes = space.faces if faces is None else faces
    a, b, c = (space.nodes_m[nodes[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    force = area[:, None] * np.asarray(traction_Pa)
    return _spread(space, nodes, force, mean_shape(3, space.order))


def _spread(space: Space, nodes: Ints, force: Array, share: Array) -> Array:
    """Distribute the force of each row, shape (r, 3), to its k nodes, and sum the nodal forces."""
    each = (force[:, None, :] * share[:, None]).reshape(-1, 3)
    rows = nodes.ravel()
    return np.stack(
        [np.bincount(rows, weights=each[:, i], minlength=space.node_count) for i in range(3)],
        axis=1,
    )
