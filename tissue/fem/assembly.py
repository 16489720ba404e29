"""Assembled stiffness and loads of tetrahedra and of a capsule on their surface.

Assembled stiffness of tetrahedra: 3x3 blocks, each pair of nodes summed once and mirrored.

Stiffness of a capsule: a thin elastic membrane on the surface, in plane stress.

The membrane resists stretch but not bending. Bending of a capsule, for example around a needle, is
not modelled.

With P = I - n n^T the projection on a face and g_c its gradients, the strain is ``P sym(grad u)
P``. The block of a pair of nodes is ``t (lambda' S + mu S^T + mu tr(S) P)`` with lambda' = E nu /
(1 - nu^2). It is the membrane's counterpart of the formula for cells in `kernels.tetrahedra`.

Prefer linear cells under a stiff capsule on a curved body. Quadratic cells with straight edges have
nodes in the middle of flat pieces of membrane. These pieces carry no pressure, so the corners are
pulled in too far: by 8 % where capsule and body are equally stiff, at 7 cells a quadrant. The mean
displacement is off by 2 %.
"""

from functools import cache

import numpy as np
import warp as wp
from numpy.typing import ArrayLike
from scipy.sparse import bsr_array

from kernels.launcher import SplitLaunch
from kernels.mirror import put
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

__all__ = [
    "STANDARD_GRAVITY_M_S2",
    "assemble",
    "capsule_stiffness",
    "gravity",
    "pair_tables",
    "traction",
]


SOFTENED_RATIO = 1.0
"""Part of the first Lame constant that acts everywhere in softened cells, over the shear modulus.

Errors over the nodule of `palpation` with edges of 4 mm: excess 2.5 % with 1, 3.5 % with 2; force
-0.1 and +0.4 %. Not softened, 5 mm: 10 and 3.6 % (`python tests/bench/bench_nodule.py --parts
meshes`). With 0 the displacement under Hertz's pressure is up to 5 % too large at 5 mm.
"""


def assemble(space: Space, elasticity: ArrayLike, *, softened: bool = False) -> bsr_array:
    """Return the stiffness matrix [N/m] of linear elastic cells, in blocks of 3x3.

    Its shape is (unknowns, unknowns). Both triangles are stored and are bitwise equal, on any
    number of cores. Integrals are exact.

    Quadratic cells with straight edges lock as Poisson's ratio nears 0.5. Softened cells do not:
    the part of the first Lame constant beyond `SOFTENED_RATIO` times the shear modulus resists the
    mean change of the volume of a cell (mean dilatation: Nagtegaal, Parks and Rice 1974, Comput.
    Methods Appl. Mech. Eng. 4:153). Cells are not changed up to a Poisson's ratio of 1/4.

    Parameters
    ----------
    space
        Nodes and cells; it stores the positions of the blocks after the first call.
    elasticity
        Lame constants [Pa], shape (2,) or (m, 2), or stiffness matrices [Pa], shape (6, 6) or (m,
        6, 6), as `tissue.materials.elasticity` makes them.
    softened
        Whether quadratic cells of nearly incompressible tissue are softened.

    Raises
    ------
    InputError
        If the elasticity has another shape or is not positive definite.
    """
    rows = elasticity_rows(elasticity, space.cell_count)
    device = space.device
    pattern = space.pattern

    corners, weights, means = pair_tables(space.order)
    less = _softening(rows) if softened else np.zeros(1)
    blocks = wp.empty(len(pattern.column), wp.mat33d, device)
    inputs = [
        *(
            put(part, wp.int32, device)
            for part in (pattern.pair_start, pattern.contribution, pattern.place, pattern.mirror)
        ),
        put(corners, wp.int32, device),
        put(weights, wp.float64, device),
        put(means, wp.float64, device),
        *space.gradients,
        put(rows, wp.float64, device),
        put(less, wp.float64, device),
    ]
    SplitLaunch(
        pair_stiffness_isotropic if rows.ndim == 2 else pair_stiffness,
        dim=len(pattern.place),
        inputs=inputs,
        outputs=[blocks],
    )()
    return bsr_array(
        (blocks.numpy(), pattern.column, pattern.row_start), shape=(space.unknown_count,) * 2
    )


def _softening(rows: Array) -> Array:
    """Return the part of the first Lame constant that resists a mean change of volume [Pa].

    The shape is (rows,). Stiffness matrices have the bulk modulus of a uniform stress, 1 / (1 C^-1
    1), and their largest shear modulus in place of the constants. They stay positive definite.
    """
    if rows.ndim == 2:
        return np.maximum(rows[:, 0] - SOFTENED_RATIO * rows[:, 1], 0.0)
    uniform = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    bulk = 1.0 / np.linalg.solve(rows, uniform[:, None])[..., 0].dot(uniform)
    shear = np.diagonal(rows, axis1=1, axis2=2)[:, 3:].max(axis=1)
    return np.asarray(np.maximum(bulk - (SOFTENED_RATIO + 2.0 / 3.0) * shear, 0.0))


@cache
def pair_tables(order: int) -> tuple[Int32s, Array, Array]:
    """Return the corners of the shape functions of each pair in a cell, and weights, (p, 4) each.

    The corners of A are i, j and those of B k, n; weights belong to the products ik, in, jk, jn of
    the gradients. The first weights give the mean of the product, the second the product of means.
    """
    products = gradient_products(4, order)
    # Four functions of corners; those of quadratic cells on edges follow.
    ends = np.concatenate([np.stack([np.arange(4)] * 2, axis=1), EDGES[: len(products) - 4]])
    a, b = local_pairs(len(products)).T
    corners = np.concatenate([ends[a], ends[b]], axis=1)
    i, j, k, n = corners.T
    # A corner has one gradient: counted once.
    once = np.stack([np.ones(len(i)), k != n, i != j, (i != j) & (k != n)], axis=1)

    def weights(of: Array) -> Array:
        each = [of[a, b, p, q] for p, q in ((i, k), (i, n), (j, k), (j, n))]
        return np.asarray(np.stack(each, axis=1) * once)

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

    Add it to the stiffness matrix of the cells.

    Shape (unknowns, unknowns), in blocks of 3x3. It equals its transpose bitwise, and so does its
    sum with the matrix of the cells.

    Parameters
    ----------
    space
        Nodes and cells.
    thickness_m
        Thickness [m].
    young_Pa, poisson_ratio
        Young's modulus [Pa] and Poisson's ratio of the membrane.
    faces
        Nodes of the faces that carry it, shape (f, 3) or (f, 6); default all of `Space.faces`.

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
    """Return the blocks summed over faces in their order, then mirrored."""
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
    """Return the weight of the cells on the nodes [N], shape (n, 3), along -z.

    The density [kg/m3] is one for all cells or one a cell, shape (m,).
    """
    mass = np.asarray(density_kg_m3, np.float64) * space.volumes_m3
    force = mass[:, None] * np.array([0.0, 0.0, -STANDARD_GRAVITY_M_S2])
    return _spread(space, space.cell_nodes, force, mean_shape(4, space.order))


def traction(space: Space, traction_Pa: ArrayLike, *, faces: Ints | None = None) -> Array:
    """Return traction on faces of the surface as forces on nodes [N], shape (n, 3).

    Parameters
    ----------
    space
        Nodes and cells.
    traction_Pa
        Force per area [Pa], shape (3,) or one a face, shape (f, 3).
    faces
        Nodes of the faces, shape (f, 3) or (f, 6); default all of `Space.faces`.
    """
    nodes = space.faces if faces is None else faces
    a, b, c = (space.nodes_m[nodes[:, i]] for i in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    force = area[:, None] * np.asarray(traction_Pa)
    return _spread(space, nodes, force, mean_shape(3, space.order))


def _spread(space: Space, nodes: Ints, force: Array, share: Array) -> Array:
    """Sum each row's force, shape (r, 3), times the share of each of its nodes, shape (k,)."""
    each = (force[:, None, :] * share[:, None]).reshape(-1, 3)
    rows = nodes.ravel()
    return np.stack(
        [np.bincount(rows, weights=each[:, i], minlength=space.node_count) for i in range(3)],
        axis=1,
    )
