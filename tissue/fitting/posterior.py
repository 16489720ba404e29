"""Posterior of constants given a log: maximum, and normal approximation about it (Laplace).

The covariance is the inverse of the expected information. It is not computed from differences of
gradients, because small jumps of a load would dominate these differences. A jump occurs, for
example, if the tool leaves an element of the mesh one sample earlier, or a shaft begins to slide
one sample earlier.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated
from tissue.fitting.marginal import Marginal, marginal
from tissue.fitting.problem import Forward, MeasuredLoads
from tissue.fitting.target import OFFSET_S, Target, Unpacked
from tissue.materials.constants import Prior

OFFSETS_S = OFFSET_S * np.concatenate(
    [np.arange(-10.0, -3.0), np.linspace(-3.0, 3.0, 25), np.arange(4.0, 11.0)]
)
"""Clock offsets from which the search begins [s].

A force may rise at several times, so there may be several maxima. Offsets beyond three standard
deviations of the prior are included to detect clocks that contradict the prior.
"""
STARTS = 2
"""Number of searches, which begin at the best first guesses over all clock offsets.

For a milled block, 1, 2 and 5 searches find the same maximum.
"""
NEARBY = np.linspace(-2.5, 2.5, 101)
REFINED = 3
"""Number of searches for a higher maximum at nearby offsets.

`NEARBY` holds the distances of these offsets from a maximum, in samples of the log.
"""
ROUNDS = 30
"""Largest number of times that the noise is estimated in one search.

The expected information has no cross terms between the noise and the other numbers, so a few rounds
are usually enough.
"""
STEEP = 1e-3
"""Increase of the log density in a round, below which a maximum counts as found.

The estimated constants are then closer to the maximum than a tenth of a standard deviation. This is
small compared with an interval, which is 3.3 standard deviations wide.
"""


@dataclass(frozen=True, eq=False)
class Posterior:
    """Normal approximation of the posterior of constants given a measured log.

    The constants are transformed so that their priors are standard normal.

    Attributes
    ----------
    target
        Log density of the constants and of the nuisance parameters (clock offset, biases and
        noise).
    maximum
        Most probable values of the transformed parameters, shape (size,), in the order constants,
        offset, biases, noise.
    covariance
        Covariance of the constants, the offset and the biases, shape (q, q), where q is their
        number.
    converged
        True if a maximum was found.
    mesh_z
        Shift of the transformed constants due to the mesh error of the runs, shape (p,). The
        credible intervals of the constants are widened by this shift. None if the loads are
        computed without a mesh.
    """

    target: Target
    maximum: Array
    covariance: Array
    converged: bool
    mesh_z: Array | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the p constants."""
        return tuple(each.name for each in self.target.forward.parameters)

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Priors of the constants."""
        return tuple(each.prior for each in self.target.forward.parameters)

    @property
    def mean_z(self) -> Array:
        """Most probable values of the transformed constants, shape (p,)."""
        return self.maximum[: self.target.constants]

    @property
    def covariance_z(self) -> Array:
        """Posterior covariance of the transformed constants, shape (p, p).

        The uncertainty of the clock offset and of the sensor biases is included. The mesh error is
        included.
        """
        p = self.target.constants
        found = self.covariance[:p, :p]
        return found if self.mesh_z is None else found + np.outer(self.mesh_z, self.mesh_z)

    @property
    def nuisances(self) -> Unpacked:
        """Clock offset, sensor biases and noise at the maximum."""
        return self.target.unpacked(self.maximum)

    @cached_property
    def offset_interval_s(self) -> tuple[float, float]:
        """90 % interval of the offset between the two clocks [s]."""
        found = marginal(self.target, self.maximum, self.covariance, self.target.constants)
        low, _, high = (OFFSET_S * found.quantiles).tolist()
        return low, high

    @cached_property
    def marginals(self) -> tuple[Marginal, ...]:
        """Marginal distribution of each of the p constants."""
        found = tuple(
            marginal(self.target, self.maximum, self.covariance, at)
            for at in range(self.target.constants)
        )
        if self.mesh_z is None:
            return found
        return tuple(
            each.widened(abs(shift))
            for each, shift in zip(found, self.mesh_z.tolist(), strict=True)
        )

    def with_mesh(
        self, whole: "Posterior", parts: Sequence["Posterior"], factor: float
    ) -> "Posterior":
        """Return the posterior, widened by the mesh error estimated from fits on a finer mesh.

        In the value of a constant, the mesh errors of different parts of the log may cancel by
        chance. The error of a constant is therefore at least the root sum of squares of its errors
        from the parts.

        Parameters
        ----------
        whole
            Fit of the same log on a finer mesh.
        parts
            Fits of the same log. Each fit uses the finer mesh in one part of the log only.
        factor
            Ratio of the error on the present mesh to the difference between the results on the two
            meshes.
        """
        shifts = np.array([each.mean_z - self.mean_z for each in parts])
        least = np.sqrt(np.sum(shifts**2, axis=0))
        change = whole.mean_z - self.mean_z
        sign = np.where(change < 0.0, -1.0, 1.0)
        return replace(self, mesh_z=factor * sign * np.maximum(np.abs(change), least))

    @property
    def spreads(self) -> Array:
        """Posterior standard deviation of each constant divided by the prior one, shape (p,)."""
        return np.array([each.spread for each in self.marginals])

    def interval(self, at: int) -> tuple[float, float, float]:
        """Return the 5, 50 and 95 % quantiles of the constant with index `at`, in its unit."""
        low, middle, high = self.priors[at].x(self.marginals[at].quantiles).tolist()
        return low, middle, high

    @property
    def simulated(self) -> Array:
        """Loads at the most probable constants, clock offset and biases, shape (m, channels)."""
        return self.target.simulated(self.maximum)


def maximum_posterior(forward: Forward, log: MeasuredLoads) -> Posterior:
    """Find the most probable constants and their normal approximation.

    The covariance follows from the expected information at the maximum. The noise follows from the
    restricted likelihood (see `tissue.fitting.target`).
    """
    return maximum_of(Target(forward, log))


def maximum_of(target: Target) -> Posterior:
    """Find the maximum of a log density, see `maximum_posterior`."""
    best = max((_settled(target, u) for _, u in starts(target)[:STARTS]), key=lambda each: each[0])
    for _ in range(REFINED):
        # If a load jumps, the samples at the jump are outliers for all offsets except the true one.
        # The density then has no slope towards this offset, so nearby offsets are tried.
        nearby = [
            _with_offset(target, best[1], offset_s)
            for offset_s in NEARBY * np.median(np.diff(target.log.times_s))
        ]
        higher = _settled(target, max(nearby, key=target.value))
        # the neighbourhood holds no better maximum
        if higher[0] <= best[0] + STEEP:
            break
        best = higher
    _, maximum, converged = best
    covariance = np.linalg.inv(target.information(maximum))
    return Posterior(target, maximum, np.asarray(covariance, dtype=np.float64), converged)


def _settled(target: Target, u: Array) -> tuple[float, Array, bool]:
    """Find the maximum near `u`: its restricted log density, its numbers and a convergence flag.

    Two searches alternate: constants, offset and biases for fixed noise, and the noise for fixed
    constants, offset and biases.
    """
    last = -np.inf
    for _ in range(ROUNDS):
        _, u = target.climbed(u)
        density, u = target.with_noise(u)
        if density < last + STEEP:
            return density, u, True
        last = density
    return last, u, False


def _with_offset(target: Target, u: Array, added_s: float) -> Array:
    """Return a copy of the numbers `u` with a changed clock offset."""
    moved = u.copy()
    moved[target.constants] += added_s / OFFSET_S
    return moved


def starts(target: Target) -> list[tuple[float, Array]]:
    """Return first guesses at several clock offsets, each with its log density, best first."""
    guesses = [target.start(float(offset_s)) for offset_s in OFFSETS_S]
    return sorted(((target.value(u), u) for u in guesses), key=lambda each: -each[0])


# Constants of a fit have a known sign, so they cannot explain a channel of opposite sign. The fit
# would treat it as a bias with noise and return wrong constants without a message. Each channel,
# all forces, all torques and all loads are therefore fitted with their signs reversed as well.
GAIN = 10.0
"""Increase of the log density (10: odds of 2e4) above which a channel's sign counts as reversed."""
SCREENED = 50.0
"""Distance below the wanted log density up to which a first guess starts a search.

The search tests reversed signs. It also changes the noise, so the first guess alone does not
decide.
"""
EXPLAINED = 0.5
"""Share of a channel's variance that the model must explain after its sign is reversed.

A channel that holds only noise has no sign.
"""


def require_signs(forward: Forward, log: MeasuredLoads) -> None:
    """Refuse a log with channels that the model explains better with reversed signs.

    Raises
    ------
    InputError
        If there are such channels. The message gives their names.
    """
    if wrong := reversed_channels(forward, log):
        raise InputError(
            "measured",
            "contain the loads that act on the tool, in the scene's frame",
            (
                f"{enumerated(wrong)} with a sign that seems reversed, because the scene "
                "fits the opposite sign better"
            ),
            f"reverse the sign with --column {wrong[0]}=-COLUMN, or remove the column",
        )


def reversed_channels(forward: Forward, log: MeasuredLoads) -> tuple[str, ...]:
    """Return the channels that the model explains better with reversed signs.

    Parameters
    ----------
    forward
        Function that computes the loads from the constants.
    log
        Measured loads.
    """
    signs = np.ones(len(log.channels))
    best, _ = _search(forward, log, signs, -np.inf)
    groups = [[at] for at in range(len(signs))]
    # all forces, all torques, and all loads
    for kind in ("force_", "torque_", ""):
        places = [at for at, name in enumerate(log.channels) if name.startswith(kind)]
        if len(places) > 1 and places not in groups:
            groups.append(places)
    while True:
        found = signs
        for places in groups:
            tried = signs.copy()
            tried[places] *= -1.0
            density, explained = _search(forward, log, tried, best + GAIN)
            if density > best + GAIN and (explained[places] > EXPLAINED).any():
                best = density
                found = tried
        if found is signs:
            return tuple(np.array(log.channels)[signs < 0.0].tolist())
        signs = found


def _search(
    forward: Forward, log: MeasuredLoads, signs: Array, wanted: float
) -> tuple[float, Array]:
    """Return the largest log density of a log with the given signs, and the explained shares.

    The second result holds the share of the variance that the model explains in each channel. If
    the log density of the first guess is far below `wanted`, the results of the first guess are
    returned.
    """
    target = Target(forward, replace(log, values=log.values * signs))
    density, u = starts(target)[0]
    # the search takes most of the time: it is left out where the first guess is far worse
    if density > wanted - SCREENED:
        _, u, _ = _settled(target, u)
        density = target.value(u)
    left = np.nanvar(target.log.values - target.simulated(u), axis=0)
    whole = np.nanvar(target.log.values, axis=0)
    return density, 1.0 - np.divide(left, whole, out=np.ones_like(whole), where=whole > 0.0)
