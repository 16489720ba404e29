"""A constant that a fit leaves free."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.materials.constants import Prior

__all__ = ["Forward", "LinearForward", "Parameter", "chosen", "fits"]


@dataclass(frozen=True)
class Parameter:
    """Free constant.

    Attributes
    ----------
    name
        Name in the files of constants, ``TABLE.MATERIAL.NAME``, such as
        ``cutting.bone.radial_chip_N_mm2``. ``density.LAYER`` is the factor on the density map of a
        layer.
    prior
        Prior of the constant before the log.
    cited
        The prior of a constant whose cited value is an end of its range, such as an axial
        coefficient of 0. The fit uses the `mirrored` prior in its linear algebra and counts values
        beyond the end as the end itself, see `tissue.fitting.marginal`. None for a constant whose
        value lies inside its range.
    """

    name: str
    prior: Prior
    cited: Prior | None = None

    @classmethod
    def of(cls, name: str, cited: Prior) -> "Parameter":
        """Return the parameter of a cited constant, its value inside its range or at an end."""
        return cls(name, cited.mirrored(), cited) if cited.is_one_sided else cls(name, cited)

    @property
    def side(self) -> float:
        """Side of the cited value on which values are possible.

        The side is 1 above the cited value, -1 below it, and 0 if values on both sides are
        possible.
        """
        if self.cited is None:
            return 0.0
        return 1.0 if self.cited.value == self.cited.low else -1.0


def fits(pattern: str, name: str, tags: Collection[str] = ()) -> bool:
    """Return whether a pattern selects a constant.

    The pattern names the table first, then parts of the name, words of it, or tags.
    """
    table, material, *rest = name.split(".")
    wanted, *parts = pattern.split(".")
    known = {
        material,
        *tags,
        *rest,
        *(word for full in rest for word in (full, *full.split("_")[:2])),
    }
    return wanted == table and known.issuperset(parts)


def chosen(
    free: Sequence[str],
    possible: Sequence[Parameter],
    tags: Mapping[str, Collection[str]] | None = None,
) -> list[Parameter]:
    """Return the parameters that patterns select, see `fits`. Without a pattern, return all.

    Parameters
    ----------
    free
        Patterns.
    possible
        Parameters to choose from.
    tags
        Further words that select a parameter, by its name.

    Raises
    ------
    InputError
        If a pattern selects no parameter.
    """
    words = tags or {}
    found = {
        each.name: [fits(pattern, each.name, words.get(each.name, ())) for pattern in free]
        for each in possible
    }
    for at, pattern in enumerate(free):
        if not any(of[at] for of in found.values()):
            raise InputError(
                "free", "name constants of this log", pattern, f"choose among {', '.join(found)}"
            )
    return [each for each in possible if not free or any(found[each.name])]


class Forward(Protocol):
    """Loads and their derivatives along the poses of a log, as functions of constants.

    Only the constants of the scene vary.

    Attributes
    ----------
    parameters
        The p free constants.
    channels
        Measured channels, such as ``force_x_N`` and ``torque_z_Nm``, on the tool in the world
        frame.
    times_s
        Increasing times on the clock of the poses, shape (n,).
    """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See the attributes."""
        ...

    @property
    def channels(self) -> tuple[str, ...]:
        """See the attributes."""
        ...

    @property
    def times_s(self) -> Array:
        """See the attributes."""
        ...

    def loads(self, x: Array) -> Array:
        """Return loads [N, N m] for the constants x, shape (n, channels).

        x has shape (p,) and is in the units of the constants.
        """
        ...

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the loads by the constants, shape (n, channels, p)."""
        ...


@dataclass(frozen=True)
class LinearForward:
    """Loads that are linear in the constants.

    Attributes
    ----------
    parameters, channels, times_s
        See `Forward`.
    basis
        Loads per unit of each constant, shape (n, channels, p).
    constant
        Loads that do not depend on the constants, shape (n, channels), or None.
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    times_s: Array
    basis: Array
    constant: Array | None = None

    def loads(self, x: Array) -> Array:
        """Return the loads, see `Forward`."""
        loads = self.basis @ np.asarray(x, dtype=float)
        return loads if self.constant is None else loads + self.constant

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of the loads, see `Forward`."""
        return self.basis
