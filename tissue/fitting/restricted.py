"""Noise estimated as if constants and biases were summed over, not fixed at their best values.

Constants fit themselves to the noise of one log and take its slowest part with them, so that the most probable noise
together with the most probable constants is too small and too little correlated. The cure is old: the noise is found
from the restricted likelihood (Patterson and Thompson 1971), in Laplace's approximation the density at the best
constants less half the logarithm of the determinant of their information.
"""

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.noise import place_information
from tissue.fitting.target import Target

__all__ = ["Restricted"]


class Restricted:
    """A `Target` with the restricted likelihood of its noise; sensitivities are those at one place.

    Parameters
    ----------
    target
        The density of constants and nuisances.
    u
        Where its sensitivities are taken, shape (size,).
    """

    def __init__(self, target: Target, u: Array) -> None:
        self.target = target
        _, moved = target.linearised(u)
        known = np.isfinite(target.log.values)[:, :, None]
        follows = known[1:] & known[:-1]
        starts = known & ~np.concatenate([np.zeros_like(known[:1]), known[:-1]])
        now, before = np.where(follows, moved[1:], 0.0), np.where(follows, moved[:-1], 0.0)
        first = np.where(starts, moved, 0.0)
        products = _products(first, first)
        crossed = _products(now, before)
        # Information of a channel for correlation phi and scale s: (constant + linear phi + square phi²)
        # times that of a place over s².
        self._constant = products + _products(now, now)
        self._linear = -crossed - np.swapaxes(crossed, 1, 2)
        self._square = _products(before, before) - products

    def value_and_gradient(self, u: Array) -> tuple[float, Array]:
        """Log density, up to a constant, and its gradient, shape (size,)."""
        value, gradient = self.target.value_and_gradient(u)
        each, p, c = self.target.unpacked(u), self.target.constants, len(self.target.log.channels)
        nu, phi = each.freedom, each.correlation[:, None, None]
        precision = (place_information(nu) / each.scale**2)[:, None, None]
        information = (self._constant + phi * self._linear + phi**2 * self._square) * precision
        whole = information.sum(axis=0) + np.eye(information.shape[1])
        inverse = np.linalg.inv(whole)
        by_phi = np.einsum("ij,cji->c", inverse, (self._linear + 2.0 * phi * self._square) * precision)
        by_size = np.einsum("ij,cji->c", inverse, information)
        gradient[p + 1 + c :] -= self.target.noise_gradient(
            each, -by_size, 0.5 * by_phi, by_size / ((nu + 1.0) * (nu + 3.0))
        )
        return value - 0.5 * float(np.linalg.slogdet(whole)[1]), gradient


def _products(left: Array, right: Array) -> Array:
    """Products of sensitivities (m, channels, k), summed over times, for each channel, shape (channels, k, k)."""
    return np.asarray(np.einsum("tci,tcj->cij", left, right, optimize=True))
