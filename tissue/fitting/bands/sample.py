"""Constants that vary, and samples of them by quasi-Monte Carlo."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtri
from scipy.stats import qmc

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from tissue.materials.constants import Constant, Prior
from tissue.materials.scene_constants import Materials
from tissue.scene.scene import Scene
from tissue.scene.used_constants import used_constants

__all__ = [
    "LEAST",
    "MOST",
    "Ranges",
    "normals",
    "ranges_of",
    "rounded",
    "sample_name",
    "sample_text",
    "sampled",
]

LEAST = 16
MOST = 65536
"""Samples of a band: with fewer than 16 no sample lies outside 90 %."""


@dataclass(frozen=True, eq=False)
class Ranges:
    """Constants that vary.

    Attributes
    ----------
    names
        Names such as ``cutting.bone.radial_chip_N_mm2``.
    priors
        Prior of each constant. No prior is fixed.
    correlation
        Correlation of the standard normal numbers behind the constants, shape (p, p).
    """

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    correlation: Array

    @classmethod
    def independent(cls, priors: dict[str, Prior]) -> "Ranges":
        """Return constants that vary independently, without the constants that have no range."""
        kept = {name: prior for name, prior in priors.items() if not prior.fixed}
        return cls(tuple(kept), tuple(kept.values()), np.eye(len(kept)))

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Indices of constants that are correlated with each other, directly or through others."""
        labels = connected_components(self.correlation != 0.0, directed=False)[1]
        return tuple(
            tuple(np.flatnonzero(labels == label).tolist())
            for label in range(labels.max(initial=-1) + 1)
        )

    @cached_property
    def group_names(self) -> tuple[str, ...]:
        """Names of each group, joined by `` + ``."""
        return tuple(" + ".join(self.names[at] for at in group) for group in self.groups)

    def x(self, free: Array) -> Array:
        """Return values of the constants for standard normal numbers, both of shape (n, p).

        The normal numbers are independent.
        """
        z = free @ self._factor.T
        return np.column_stack([prior.x(z[:, at]) for at, prior in enumerate(self.priors)])

    @cached_property
    def _factor(self) -> Array:
        return np.asarray(np.linalg.cholesky(self.correlation))


def ranges_of(
    scene: Scene,
    layers: Sequence[str],
    *,
    table: str = "",
    further: Mapping[str, Prior] | None = None,
) -> Ranges:
    """Return the constants with a range that a scene uses and does not set itself.

    Parameters
    ----------
    scene
        The scene.
    layers
        Layers of its bone that count.
    table
        Beginning of the names of the constants that count.
    further
        Priors of further numbers that vary.
    """
    priors = {
        one.full: Prior.of(one.cited, one.full)
        for one in used_constants(scene, layers, varied=True)
        if one.stated is None and one.full.startswith(table)
    } | dict(further or {})
    priors = {name: prior for name, prior in priors.items() if not prior.fixed}
    return Ranges(tuple(priors), tuple(priors.values()), scene.constants.correlation(tuple(priors)))


def rounded(asked: int) -> int:
    """Round a number of samples up to a power of two.

    A Sobol sequence is balanced only at powers of two.

    Raises
    ------
    InputError
        If the number is not between 16 and 65536.
    """
    count = int(require_range("band", asked, LEAST, MOST, "use 200"))
    return 1 << (count - 1).bit_length()


def normals(count: int, width: int, *, seed: int) -> Array:
    """Return independent standard normal numbers, shape (count, width).

    They follow a scrambled Sobol sequence. `count` is a power of two.

    `count` is a power of two.

    Raises
    ------
    InputError
        If there are more columns than the sequence has.
    """
    if width > qmc.Sobol.MAXDIM:
        raise InputError(
            "constants", f"be at most {qmc.Sobol.MAXDIM} of a Sobol sequence", width, "fix some"
        )
    points = qmc.Sobol(width, scramble=True, seed=seed).random(count)
    return np.asarray(ndtri(np.clip(points, 1e-12, 1.0 - 1e-12)))


SOURCE = "a sample of a band"


def sample_name(number: int, count: int) -> str:
    """Name of the file of a sample, such as ``sample_017.toml`` of 256."""
    return f"sample_{number:0{len(str(count - 1))}d}.toml"


def sampled(constants: Materials, names: Sequence[str], x: Array) -> Materials:
    """Return the constants with the values of a sample, shape (p,), in place.

    The values are assigned by the names ``TABLE.MATERIAL.NAME``.
    """
    values = (Constant(value, value, value, SOURCE, "L") for value in map(float, x))
    drawn = {
        name: one
        for name, one in zip(names, values, strict=True)
        if not name.startswith("density.")
    }
    return replace(constants, given={**constants.given, **drawn}, names=(), matrix=())


def sample_text(constants: Materials, names: Sequence[str], x: Array) -> str:
    """Return the TOML file of a sample.

    A factor of the density is a comment, since no scene accepts it.
    """
    lines = [
        f"# {name} = {float(value)!r}, which no file of materials holds"
        for name, value in zip(names, x, strict=True)
        if name.startswith("density.")
    ]
    for name, one in sampled(constants, names, x).given.items():
        lines += [
            "",
            f"[{name}]",
            f"value = {one.value!r}",
            f"range = [{one.low!r}, {one.high!r}]",
            f"source = {json.dumps(one.source)}",
            f"confidence = {json.dumps(one.confidence)}",
        ]
    return "\n".join(lines).lstrip("\n") + "\n"
