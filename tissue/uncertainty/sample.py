"""Constants that vary, and samples of them by quasi-Monte Carlo."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtri
from scipy.stats import qmc

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from tissue.materials.prior import Prior

__all__ = ["LEAST", "MOST", "Ranges", "normals", "rounded"]

LEAST, MOST = 16, 65536
"""Samples of a band: with fewer than 16 no sample lies outside 90 %."""


@dataclass(frozen=True, eq=False)
class Ranges:
    """Constants that vary.

    Attributes
    ----------
    names
        Such as ``cutting.bone.radial_chip_N_mm2``.
    priors
        Law of each; none of them fixed.
    correlation
        Of the standard normal numbers behind the constants, shape (p, p).
    """

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    correlation: Array

    @classmethod
    def independent(cls, priors: dict[str, Prior]) -> "Ranges":
        """Constants of which each varies by itself, those without a range left out."""
        kept = {name: prior for name, prior in priors.items() if not prior.fixed}
        return cls(tuple(kept), tuple(kept.values()), np.eye(len(kept)))

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Places of the constants that are correlated with each other, directly or through others."""
        labels = connected_components(self.correlation != 0.0, directed=False)[1]
        return tuple(tuple(np.flatnonzero(labels == label).tolist()) for label in range(labels.max(initial=-1) + 1))

    @cached_property
    def group_names(self) -> tuple[str, ...]:
        """Names of each group, joined by `` + ``."""
        return tuple(" + ".join(self.names[at] for at in group) for group in self.groups)

    def x(self, free: Array) -> Array:
        """Values of the constants for independent standard normal numbers, both of shape (n, p)."""
        z = free @ self._factor.T
        return np.column_stack([prior.x(z[:, at]) for at, prior in enumerate(self.priors)])

    @cached_property
    def _factor(self) -> Array:
        return np.asarray(np.linalg.cholesky(self.correlation))


def rounded(asked: int) -> int:
    """Samples for a number asked for: the power of two at or above it, for a Sobol sequence is balanced at those alone.

    Raises
    ------
    InputError
        If it is none of 16 to 65536.
    """
    count = int(require_range("band", asked, LEAST, MOST, "use 200"))
    return 1 << (count - 1).bit_length()


def normals(count: int, width: int, *, seed: int) -> Array:
    """Independent standard normal numbers of a scrambled Sobol sequence, shape (count, width); count a power of two.

    Raises
    ------
    InputError
        If there are more columns than the sequence has.
    """
    if width > qmc.Sobol.MAXDIM:
        raise InputError(f"constants must be at most {qmc.Sobol.MAXDIM} of a Sobol sequence, got {width}: fix some")
    points = qmc.Sobol(width, scramble=True, seed=seed).random(count)
    return np.asarray(ndtri(np.clip(points, 1e-12, 1.0 - 1e-12)))
