"""Stiffness of a capsule: a thin elastic membrane on the surface, in plane stress.

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

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import bsr_array

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, require_positive
from tissue.fem.pattern import Pattern, local_pairs
from tissue.fem.shapes import gradient_products
from tissue.fem.space import Space
from tissue.materials.elasticity import lame

__all__ = ["capsule_stiffness"]


def capsule_stiffness(
    space: Space,
    *,
    thickness_m: ArrayLike,
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
        Thickness [m], one or one a face, shape (f,).
    young_Pa, poisson_ratio
        Young's modulus [Pa] and Poisson's ratio of the membrane.
    faces
        Nodes of the faces that carry it, shape (f, 3) or (f, 6); default all of `Space.faces`.

    Raises
    ------
    InputError
        If a constant or the thickness is out of range.
    """
    require_positive("young_Pa", young_Pa, "use about 8e6 for Glisson's capsule")
    shear = float(lame(young_Pa, poisson_ratio)[1])
    first = young_Pa * poisson_ratio / (1.0 - poisson_ratio**2)
    nodes = space.faces if faces is None else faces
    thickness = np.broadcast_to(np.asarray(thickness_m, dtype=np.float64), len(nodes))
    if not (np.isfinite(thickness) & (thickness > 0.0)).all():
        raise InputError(
            "thickness_m", "be positive and finite", thickness.min(), "leave bare faces out"
        )
    corners = space.nodes_m[nodes[:, :3]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normal, axis=1)
    normal /= double_area[:, None]
    opposite = np.roll(corners, 1, axis=1) - np.roll(corners, -1, axis=1)  # c - b, a - c, b - a
    gradient = np.cross(normal[:, None], opposite) / double_area[:, None, None]
    a, b = local_pairs(nodes.shape[1]).T
    weight = gradient_products(3, space.order)[a, b]
    size = 0.5 * double_area * thickness
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
