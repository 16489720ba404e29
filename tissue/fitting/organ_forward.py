"""Loads of a probe on an organ by its constants: proportional to all moduli together, of second order in the others."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.parameter import Parameter

__all__ = ["OrganForward"]


@dataclass(frozen=True, eq=False)
class OrganForward:
    """Loads about the constants of a run.

    Where every stiffness of an organ is free, its force on a given path is proportional to all moduli together, with
    Poisson's ratio, friction, relaxation and the ratios of moduli kept. So runs are made with the first modulus as it
    is cited, and with the others in proportion.

    Attributes
    ----------
    parameters, channels, times_s
        See `tissue.fitting.forward.Forward`.
    moduli
        Places of the moduli to which loads are proportional together; empty where something else is as stiff as it is.
    at
        Constants of the run, shape (p,).
    base
        Its loads, shape (n, channels).
    slopes, curvatures
        Coefficients of the distance of each constant from there and of its square, shape (n, channels, p); zero of the
        first of the moduli. The distance of a relaxation time is that of its logarithm.
    mixed
        Coefficients of the products of two distances, half of each in either order, shape (n, channels, p, p).
    """

    parameters: tuple[Parameter, ...]
    channels: tuple[str, ...]
    times_s: Array
    moduli: tuple[int, ...]
    at: Array
    base: Array
    slopes: Array
    curvatures: Array
    mixed: Array

    def reduced(self, x: Array) -> tuple[float, Array]:
        """By how much loads are scaled, and the constants that a run has in place of x, shape (p,)."""
        x = np.asarray(x, dtype=float)
        if not self.moduli:
            return 1.0, x
        first, others = self.moduli[0], list(self.moduli)
        scale = float(x[first] / self.at[first])
        same = x.copy()
        same[others] = x[others] / scale
        same[first] = self.at[first]
        return scale, same

    def loads(self, x: Array) -> Array:
        """See `tissue.fitting.forward.Forward`."""
        scale, same = self.reduced(x)
        return scale * self._of_run(self.distance(same))

    def jacobian(self, x: Array) -> Array:
        """See `tissue.fitting.forward.Forward`."""
        scale, same = self.reduced(x)
        distance = self.distance(same)
        found = self._slopes_at(distance) / np.where(self._logarithmic, same, 1.0)
        if not self.moduli:
            return found
        first, others = self.moduli[0], list(self.moduli[1:])
        of_others = found[..., others] @ same[others]
        found *= scale
        found[..., others] /= scale
        found[..., first] = (self._of_run(distance) - of_others) / self.at[first]
        return found

    def moved(self, at: Array, base: Array, *, learnt: float) -> "OrganForward":
        """With the loads of another run as base, and slopes that explain them from the last one (Broyden 1965).

        Parameters
        ----------
        at, base
            Constants of that run, and its loads.
        learnt
            Step from the last run, in standard deviations of the priors, below which slopes are not corrected: they are
            not to explain single nodes that come into contact.
        """
        distance = self.distance(at)
        middle = np.array([each.prior.value for each in self.parameters])
        widths = np.array([float(each.prior.slope(0.0)) for each in self.parameters])
        step = distance / np.where(self._logarithmic, widths / middle, widths)
        slopes = self._slopes_at(distance)
        if float(np.linalg.norm(step)) >= learnt:
            missed = base - self._of_run(distance)
            along = np.divide(step**2, distance, out=np.zeros_like(step), where=distance != 0.0)
            slopes = slopes + missed[..., None] * along / float(step @ step)
        return replace(self, at=at, base=base, slopes=slopes)

    def distance(self, x: Array) -> Array:
        """From the constants of the run to others, shape (p,)."""
        return np.asarray(np.where(self._logarithmic, np.log(x / self.at), x - self.at))

    @cached_property
    def _logarithmic(self) -> Array:
        return np.array([each.name.endswith("_s") for each in self.parameters])

    def _of_run(self, distance: Array) -> Array:
        together = (self.mixed @ distance) @ distance
        return np.asarray(self.base + self.slopes @ distance + self.curvatures @ distance**2 + together)

    def _slopes_at(self, distance: Array) -> Array:
        return np.asarray(self.slopes + 2.0 * self.curvatures * distance + 2.0 * (self.mixed @ distance))
