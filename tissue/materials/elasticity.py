"""Stiffness of linear elastic materials: isotropic, transversely isotropic, orthotropic, rotated.

The Voigt order is xx, yy, zz, yz, xz, xy. Shear strains are engineering shear strains, twice the
tensor components, so that stress = D strain. The material axes 1, 2, 3 are x, y, z until they are
rotated. The fibre of a transversely isotropic material is axis 3.
"""

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError

VOIGT = np.array([[0, 0], [1, 1], [2, 2], [1, 2], [0, 2], [0, 1]])
"""Row and column of the tensor component at each Voigt index."""

SYMMETRIC = 1e-9
"""Allowed asymmetry of a stiffness matrix, relative to its largest entry.

The value exceeds the rounding errors of an inverted compliance matrix in which moduli differ by a
factor of up to a million.
"""


def lame(young_Pa: ArrayLike, poisson_ratio: ArrayLike) -> Array:
    """Return the Lamé constants lambda, mu [Pa], shape (..., 2).

    Young's modulus [Pa] and Poisson's ratio are broadcast against each other.

    Raises
    ------
    InputError
        If a modulus is not positive and finite, or a Poisson's ratio lies outside (-1, 0.5).
    """
    young = _positive("young_Pa", young_Pa)
    ratio = np.asarray(poisson_ratio, np.float64)
    outside = ~((ratio > -1.0) & (ratio < 0.5))
    if outside.any():
        raise InputError(
            "poisson_ratio",
            "be in (-1, 0.5)",
            f"{ratio[outside].flat[0]:g}",
            "use at most 0.499, with quadratic elements",
        )
    shear = young / (2.0 * (1.0 + ratio))
    return np.stack(np.broadcast_arrays(2.0 * shear * ratio / (1.0 - 2.0 * ratio), shear), axis=-1)


def stiffness_of_lame(lame_Pa: ArrayLike) -> Array:
    """Convert Lamé constants [Pa] to stiffness matrices [Pa].

    The constants have the shape (..., 2), and the matrices have the shape (..., 6, 6).
    """
    pair = np.asarray(lame_Pa, np.float64)
    matrix = np.zeros((*pair.shape[:-1], 6, 6))
    matrix[..., :3, :3] = pair[..., 0, None, None]
    place = np.arange(6)
    matrix[..., place, place] += pair[..., 1, None] * np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    return matrix


def orthotropic(*, young_Pa: ArrayLike, shear_Pa: ArrayLike, poisson_ratio: ArrayLike) -> Array:
    """Return the stiffness matrix [Pa], shape (6, 6), of an orthotropic material.

    Parameters
    ----------
    young_Pa
        E1, E2, E3 [Pa].
    shear_Pa
        G12, G13, G23 [Pa].
    poisson_ratio
        nu12, nu13, nu23. The ratio nu12 is the contraction along axis 2 divided by the extension
        along axis 1, for tension along axis 1. The reverse ratio is nu21 = nu12 E2 / E1.

    Raises
    ------
    InputError
        If a modulus is not positive, or the matrix is not positive definite.
    """
    young = _positive("young_Pa", young_Pa)
    shear = _positive("shear_Pa", shear_Pa)
    ratio = np.asarray(poisson_ratio, np.float64)
    compliance = np.zeros((6, 6))
    compliance[range(3), range(3)] = 1.0 / young
    for (i, j), value in zip(((0, 1), (0, 2), (1, 2)), ratio, strict=True):
        compliance[i, j] = compliance[j, i] = -value / young[i]
    compliance[range(3, 6), range(3, 6)] = 1.0 / shear[::-1]
    if not np.linalg.eigvalsh(compliance[:3, :3])[0] > 0.0:
        raise InputError(
            "poisson_ratio",
            "leave the stiffness positive definite",
            f"{ratio.tolist()} with moduli {young.tolist()} Pa",
            (
                "reduce the ratios: each |nu_ij| must be below sqrt(E_i / E_j), and "
                "several ratios together must be smaller"
            ),
        )
    stiffness = np.linalg.inv(compliance)
    return checked_stiffness(0.5 * (stiffness + stiffness.T))


def transversely_isotropic(
    *,
    young_fibre_Pa: float,
    young_across_Pa: float,
    shear_fibre_Pa: float,
    poisson_fibre: float,
    poisson_across: float,
) -> Array:
    """Return the stiffness matrix [Pa], shape (6, 6), of a transversely isotropic material.

    The fibre is axis 3.

    Parameters
    ----------
    young_fibre_Pa, young_across_Pa
        Young's modulus along and across the fibre [Pa].
    shear_fibre_Pa
        Shear modulus in planes that contain the fibre [Pa].
    poisson_fibre
        Contraction across the fibre divided by extension along it, under tension along the fibre.
    poisson_across
        Poisson's ratio in the plane normal to the fibre, in (-1, 1).

    Raises
    ------
    InputError
        As in `orthotropic`.
    """
    across = float(_positive("young_across_Pa", young_across_Pa))
    fibre = float(_positive("young_fibre_Pa", young_fibre_Pa))
    if not -1.0 < poisson_across < 1.0:
        raise InputError("poisson_across", "be in (-1, 1)", poisson_across, "use about 0.4")
    back = poisson_fibre * across / fibre
    shear_across = across / (2.0 * (1.0 + poisson_across))
    return orthotropic(
        young_Pa=(across, across, fibre),
        shear_Pa=(shear_across, shear_fibre_Pa, shear_fibre_Pa),
        poisson_ratio=(poisson_across, back, back),
    )


def volume_preserving_ratio(*, poisson_ratio: float, modulus_ratio: float) -> float:
    """Compute the transverse Poisson's ratio for which fibres leave the bulk modulus unchanged.

    The Young's modulus of the material is E across the fibres and r E along the fibres. Its
    Poisson's ratio is nu under tension along the fibres, and nu_across under tension across the
    fibres. The bulk modulus K follows from the sum of the compliances of the normal components::

        1 / K = (2 (1 - nu_across) + (1 - 4 nu) / r) / E

    1 / K is equal to the isotropic value 3 (1 - 2 nu) / E if nu_across = 3 nu - 1/2 + (1 - 4 nu) /
    (2 r).

    Parameters
    ----------
    poisson_ratio
        Poisson's ratio nu of the material without fibres. It is also the ratio under tension along
        the fibres.
    modulus_ratio
        Ratio of the Young's modulus along the fibres to the Young's modulus across the fibres.
    """
    return 3.0 * poisson_ratio - 0.5 + (1.0 - 4.0 * poisson_ratio) / (2.0 * modulus_ratio)


def fibre_ratio_range(poisson_ratio: float) -> tuple[float, float]:
    """Compute the open range of modulus ratios for which a fibre material is stable.

    The material has the Poisson's ratio nu, the modulus ratio r, and nu_across from
    `volume_preserving_ratio`. Stability requires two conditions. The first, 1 - nu_across > 2 nu^2
    / r, is equivalent to r > (1 - 2 nu) / 3. The second, nu_across > -1, gives a lower bound of r
    if nu > 1/4, and an upper bound if nu < -1/6.
    """
    low = (1.0 - 2.0 * poisson_ratio) / 3.0
    high = np.inf
    slope = 1.0 + 6.0 * poisson_ratio
    if poisson_ratio > 0.25:
        low = max(low, (4.0 * poisson_ratio - 1.0) / slope)
    if slope < 0.0:
        high = (1.0 - 4.0 * poisson_ratio) / -slope
    return low, high


def checked_stiffness(stiffness_Pa: ArrayLike) -> Array:
    """Validate and return stiffness matrices [Pa], shape (6, 6) or (m, 6, 6).

    Raises
    ------
    InputError
        If a matrix is not finite, symmetric and positive definite.
    """
    matrix = np.asarray(stiffness_Pa, np.float64)
    if matrix.ndim not in (2, 3) or matrix.shape[-2:] != (6, 6) or not np.isfinite(matrix).all():
        raise InputError(
            "stiffness_Pa",
            "be finite, with the shape (6, 6) or (m, 6, 6)",
            f"shape {matrix.shape}" if np.isfinite(matrix).all() else "NaN or infinity",
            "use Voigt matrices",
        )
    each = matrix.reshape(-1, 6, 6)
    skew = np.abs(each - each.transpose(0, 2, 1)).max(axis=(1, 2))
    off = skew / np.abs(each).max(axis=(1, 2)).clip(min=1e-300)
    try:
        np.linalg.cholesky(each)  # takes a tenth of the time of eigenvalues
        is_definite = True
    except np.linalg.LinAlgError:
        is_definite = False
    if off.max() > SYMMETRIC or not is_definite:
        raise InputError(
            "stiffness_Pa",
            "be symmetric and positive definite",
            f"an asymmetry of {off.max():.1e}, lowest eigenvalue "
            f"{np.linalg.eigvalsh(each).min():.3g} Pa",
            "check moduli and Poisson's ratios",
        )
    return matrix


def rotated(stiffness_Pa: ArrayLike, axes: ArrayLike) -> Array:
    """Rotate stiffness matrices from material axes to global axes (Bond 1943).

    The result has the unit Pa and the shape (m, 6, 6).

    Parameters
    ----------
    stiffness_Pa
        Stiffness in material axes [Pa], shape (6, 6) or (m, 6, 6).
    axes
        Fibre directions, shape (m, 3), for a material that is transversely isotropic about axis 3.
        For other materials, matrices with the material axes 1, 2, 3 as columns, shape (m, 3, 3),
        orthonormal and right-handed.

    Raises
    ------
    InputError
        If a direction is a zero vector.
    """
    matrix = np.asarray(stiffness_Pa, np.float64)
    frame = np.asarray(axes, np.float64)
    if frame.ndim == 2:
        frame = _frames(frame)
    return _turned(matrix.reshape(-1, 6, 6), frame)


def elasticity_rows(elasticity: ArrayLike, cell_count: int) -> Array:
    """Return elastic constants as rows: one row for all cells, or one row per cell.

    The rows are Lamé constants [Pa], shape (1, 2) or (m, 2), or stiffness matrices [Pa], shape (1,
    6, 6) or (m, 6, 6), for m cells.

    Raises
    ------
    InputError
        If `elasticity` has another shape, or is not positive definite.
    """
    given = np.asarray(elasticity, np.float64)
    if given.ndim in (1, 2) and given.shape[-1] == 2:
        rows: Array = given.reshape(-1, 2)
        stable = (
            np.isfinite(rows).all(axis=1)
            & (rows[:, 1] > 0.0)
            & (3.0 * rows[:, 0] + 2.0 * rows[:, 1] > 0.0)
        )
        if not stable.all():
            raise InputError(
                "elasticity",
                "be positive definite",
                f"Lame constants {rows[~stable][0].tolist()} Pa",
                "use lame(young_Pa, poisson_ratio)",
            )
    else:
        rows = checked_stiffness(given).reshape(-1, 6, 6)
    if len(rows) not in (1, cell_count):
        raise InputError(
            f"elasticity must be one row for all cells or one for each of {cell_count} "
            f"cells, got {len(rows)} rows"
        )
    return rows


def _positive(name: str, value: ArrayLike) -> Array:
    numbers = np.asarray(value, np.float64)
    if not (np.isfinite(numbers) & (numbers > 0.0)).all():
        raise InputError(
            name, "be positive and finite", numbers.tolist(), "use pascals, about 5e3 for liver"
        )
    return numbers


def _frames(fibre: Array) -> Array:
    """Return right-handed frames whose third column is the fibre."""
    length = np.linalg.norm(fibre, axis=1)
    if not (length > 0.0).all():
        raise InputError(
            "axes",
            "be directions of non-zero length",
            "an axis of length zero",
            "give non-zero directions",
        )
    third = fibre / length[:, None]
    least = np.eye(3)[np.abs(third).argmin(axis=1)]
    first = np.cross(least, third)
    first /= np.linalg.norm(first, axis=1)[:, None]
    return np.stack([first, np.cross(third, first), third], axis=2)


def _turned(matrix: Array, rotation: Array) -> Array:
    """Return D' = M D M^T, where M rotates stresses in Voigt order.

    The result is symmetrised to remove rounding errors of the products.
    """
    i, j = VOIGT.T[:, :, None]
    k, n = VOIGT.T[:, None]
    bond = rotation[:, i, k] * rotation[:, j, n]
    bond[:, :, 3:] += (rotation[:, i, n] * rotation[:, j, k])[:, :, 3:]
    turned = bond @ matrix @ bond.transpose(0, 2, 1)
    return 0.5 * (turned + turned.transpose(0, 2, 1))
