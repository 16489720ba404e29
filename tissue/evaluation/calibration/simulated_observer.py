"""Observers whose thresholds and intensities are known, to hold calibrations and experiments against."""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.arrays import Array
from tissue.materials.constants import constants
from tissue.perception.population import population
from tissue.perception.psychometric import D_PRIME_75

__all__ = ["SimulatedObservers", "draw_observers"]


@dataclass(frozen=True, kw_only=True)
class SimulatedObservers:
    """People of known truth who answer side by side; arrays of shape (n,).

    Each of two intervals is felt with noise of unit variance on a scale on which the threshold kappa (F + offset) is
    0.954 long, so that 75 % of the answers there are right. A force is given the number alpha (F / 1 N)^beta, with a
    noise of its logarithm.

    Attributes
    ----------
    alpha, beta
        Stevens' factor and exponent.
    kappa, offset_N
        Weber's fraction and its term for low forces [N].
    lapse
        Share of strong stimuli that is answered wrongly; twice as many are answered blindly.
    sigma
        Standard deviation of the logarithm of a number that is given.
    freedom
        Degrees of freedom of Student's t for all noise, above 2; infinite for a normal one. The variance stays one.
    fatigue
        Share by which thresholds have grown after a hundred trials.
    """

    alpha: Array
    beta: Array
    kappa: Array
    offset_N: Array
    lapse: Array
    sigma: Array
    freedom: float = np.inf
    fatigue: float = 0.0

    def __len__(self) -> int:
        return len(self.kappa)

    def correct(
        self, base_N: ArrayLike, step_N: ArrayLike, rng: np.random.Generator, *, trial: int = 0
    ) -> NDArray[np.bool_]:
        """Whether each discriminates `base_N + step_N` from `base_N` [N], shape (n,); a step of 0 has no right answer.

        Parameters
        ----------
        base_N, step_N
            Smaller force and difference, one or one for each observer, shape (n,).
        rng
            Draws the noise; equal generators give the same noise whatever the forces.
        trial
            How many trials went before, by which people tire.
        """
        tired = max(1.0 + self.fatigue * trial / 100.0, 0.1)
        threshold = tired * self.kappa * (np.asarray(base_N) + self.offset_N)
        return self.discriminate(D_PRIME_75 * np.asarray(step_N) / threshold, rng)

    def discriminate(self, distance: ArrayLike, rng: np.random.Generator) -> NDArray[np.bool_]:
        """Whether each discriminates two intervals that lie a distance d' from each other, shape (n,)."""
        first, second = self._noise(rng), self._noise(rng)
        blind, guess = rng.random((2, len(self)))
        return np.where(blind < 2.0 * self.lapse, guess < 0.5, np.asarray(distance) + second > first)

    def number(self, force_N: ArrayLike, rng: np.random.Generator) -> Array:
        """Number that each gives to a force [N], shape (n,)."""
        return self.alpha * np.asarray(force_N) ** self.beta * np.exp(self.sigma * self._noise(rng))

    def _noise(self, rng: np.random.Generator) -> Array:
        """Noise of unit variance, shape (n,)."""
        if np.isinf(self.freedom):
            return rng.standard_normal(len(self))
        return rng.standard_t(self.freedom, len(self)) * sqrt((self.freedom - 2.0) / self.freedom)


def draw_observers(
    group: str, count: int, rng: np.random.Generator, *, freedom: float = np.inf, fatigue: float = 0.0
) -> SimulatedObservers:
    """Observers of a group (novice, intermediate, expert), drawn from ``observers.toml`` and ``perception.toml``."""
    people = replace(population(), kappa=constants("observers", group)["kappa"].value)
    return SimulatedObservers(**people.draws(count, rng), freedom=freedom, fatigue=fatigue)
