"""Periodontal ligament as a bed of springs on the roots."""

import numpy as np
from scipy.ndimage import gaussian_filter

from meshes.base.arrays import Array, Flags
from tissue.models.tooth.supports import PointSprings

__all__ = ["bed_springs", "bed_stiffness"]


def bed_stiffness(
    modulus_Pa: float, poisson_ratio: float, thickness_m: float
) -> tuple[float, float]:
    """Return the stiffness of a thin layer bonded on both sides, across it and along it [N/m3].

    A layer much thinner than it is wide cannot bulge. Across it the confined modulus E (1 - v) /
    ((1 + v) (1 - 2 v)) acts, along it the shear modulus. This is a Winkler bed; its error is of the
    order of thickness over width.
    """
    confined = (
        modulus_Pa * (1.0 - poisson_ratio) / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    )
    return confined / thickness_m, modulus_Pa / (2.0 * (1.0 + poisson_ratio)) / thickness_m


def bed_springs(
    tooth: Flags,
    bed: Flags,
    *,
    origin_m: Array,
    spacing_m: float,
    across_N_m3: float,
    along_N_m3: float,
) -> tuple[PointSprings, float]:
    """Return springs where a tooth's voxels border on the bed.

    They act at the centres of the tooth's voxels. A face of area A and normal n has ``A (k_t I +
    (k_n - k_t) n n^T)``, k_n and k_t the stiffness across and along it.

    A border's faces form a staircase. Each face is weighed by the component of the smooth normal
    along it, so that the weights sum to the area of the surface and not of the staircase.

    Parameters
    ----------
    tooth, bed
        Voxels of the tooth and of its bed, shape (nx, ny, nz).
    origin_m, spacing_m
        Corner of voxel (0, 0, 0) and edge of a voxel [m].
    across_N_m3, along_N_m3
        Stiffness of the bed, see `bed_stiffness`.

    Returns
    -------
    The springs, and the area that the bed carries [m2].
    """
    smooth = gaussian_filter(tooth.astype(np.float32), 1.5)
    slope = np.stack(np.gradient(smooth), axis=-1)
    positions = [np.zeros((0, 3))]
    matrices = [np.zeros((0, 3, 3))]
    total = 0.0
    for axis in range(3):
        low = tuple(slice(None, -1) if a == axis else slice(None) for a in range(3))
        high = tuple(slice(1, None) if a == axis else slice(None) for a in range(3))
        for inner, outer in ((low, high), (high, low)):
            faces = np.argwhere(tooth[inner] & bed[outer])
            if len(faces) == 0:
                continue
            # The mean of both sides is the normal at the face; the tooth's side alone loses 3 % of
            # a sphere's area.
            leans = slope[low][tuple(faces.T)] + slope[high][tuple(faces.T)]
            normal = leans / np.maximum(np.linalg.norm(leans, axis=1, keepdims=True), 1e-9)
            area = spacing_m**2 * np.abs(normal[:, axis])
            total += float(area.sum())
            across = np.einsum("ki,kj->kij", normal, normal)
            matrices.append(
                area[:, None, None] * (along_N_m3 * np.eye(3) + (across_N_m3 - along_N_m3) * across)
            )
            if inner is high:
                faces[:, axis] += 1
            positions.append(origin_m + spacing_m * (faces + 0.5))
    return PointSprings(np.concatenate(positions), np.concatenate(matrices)), total
