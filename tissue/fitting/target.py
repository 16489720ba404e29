"""Log density that a fit maximises.

The density is a product of the density of the log, given all numbers of the fit, and of the priors
of these numbers: constants, clock offset, biases and noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.special import digamma, gammaln, polygamma

from meshes.base.arrays import Array
from tissue.fitting.problem import SD_PER_MAD, Forward, MeasuredLoads, shift_operators

__all__ = [
    "OFFSET_S",
    "NoiseTerms",
    "Restricted",
    "Target",
    "Unpacked",
    "freedom_information",
    "innovations",
    "noise_terms",
    "place_information",
]


@dataclass(frozen=True)
class NoiseTerms:
    """Log density of residuals and its derivatives for an optimiser.

    Attributes
    ----------
    log_density
        Log density, summed over samples and channels.
    by_residuals
        Derivative by each residual, shape (m, channels). It is 0 where there is no residual.
    by_log_scale, by_correlation, by_freedom
        Derivatives by the logarithm of the scale, the correlation and the degrees of freedom of
        each channel, shape (channels,).
    weights
        Weight of each squared innovation in reweighted least squares [1/unit²], shape (m,
        channels).
    """

    log_density: float
    by_residuals: Array
    by_log_scale: Array
    by_correlation: Array
    by_freedom: Array
    weights: Array


def innovations(residuals: Array, correlation: Array) -> Array:
    """Return the innovations e_t = r_t - phi r_(t-1) of residuals, shape (m, channels).

    The factor phi is `correlation`. The first innovation after a gap (NaN) is sqrt(1 - phi²) r_t,
    because the chain starts stationary. Innovations are NaN at gaps. Innovations are linear in the
    residuals, so `residuals` may also be derivatives of residuals, shape (m, channels, k).
    """
    previous, starts = _previous(residuals)
    phi = correlation.reshape(1, -1, *[1] * (residuals.ndim - 2))
    return np.where(starts, np.sqrt(1.0 - phi**2) * residuals, residuals - phi * previous)


def noise_terms(residuals: Array, scale: Array, correlation: Array, freedom: Array) -> NoiseTerms:
    """Compute the log density of residuals and its gradient.

    Parameters
    ----------
    residuals
        Residuals at one rate, shape (m, channels), NaN where missing.
    scale
        Scale of the innovations, shape (channels,). At four degrees of freedom, the standard
        deviation is sqrt(2) times the scale.
    correlation
        Correlation of neighbouring residuals, in (-1, 1), shape (channels,).
    freedom
        Degrees of freedom of the innovations, shape (channels,). With fewer degrees of freedom,
        outliers have less influence.
    """
    previous, starts = _previous(residuals)
    here = np.isfinite(residuals)
    e = np.where(here, innovations(residuals, correlation), 0.0)
    spread = freedom * scale**2 + e**2
    weights = np.where(here, (freedom + 1.0) / spread, 0.0)
    pull = weights * e
    stationary = 1.0 - correlation**2
    count = here.sum(axis=0)
    begun = starts.sum(axis=0)
    # logarithm of the density of Student's law, and below its derivatives
    constant = (
        gammaln(0.5 * (freedom + 1.0)) - gammaln(0.5 * freedom) - 0.5 * np.log(freedom * np.pi)
    )
    density = count * (constant - np.log(scale)) + 0.5 * begun * np.log(stationary)
    tails = np.log1p(e**2 / (freedom * scale**2)).sum(axis=0)
    density -= 0.5 * (freedom + 1.0) * tails
    pulled = np.sum(pull * e, axis=0)
    by_freedom = digamma(0.5 * (freedom + 1.0)) - digamma(0.5 * freedom) - 1.0 / freedom
    by_freedom = 0.5 * (count * by_freedom - tails + pulled / freedom)
    by_residuals = -pull * np.where(starts, np.sqrt(stationary), 1.0)
    follows = here[1:] & np.logical_not(starts[1:])
    by_residuals[:-1] += np.where(follows, correlation * pull[1:], 0.0)
    moved = np.where(starts, -correlation / np.sqrt(stationary) * residuals, -previous)
    by_correlation = (
        -np.sum(pull * np.where(here, moved, 0.0), axis=0) - begun * correlation / stationary
    )
    return NoiseTerms(
        float(density.sum()), by_residuals, pulled - count, by_correlation, by_freedom, weights
    )


def place_information(freedom: Array) -> Array:
    """Return the Fisher information of the location of an innovation of scale 1.

    The result has the shape of `freedom`. The formula is from Lange, Little and Taylor (1989).
    """
    return (freedom + 1.0) / (freedom + 3.0)


def freedom_information(freedom: Array) -> tuple[Array, Array]:
    """Return the Fisher information of the degrees of freedom, and a cross term.

    The cross term is the information of the degrees of freedom and of the logarithm of the scale.

    The formulas are from Lange, Little and Taylor (1989). Both results have the shape of
    `freedom`.
    """
    curved = 0.25 * (polygamma(1, 0.5 * freedom) - polygamma(1, 0.5 * (freedom + 1.0)))
    of_freedom = curved - 0.5 * (freedom + 5.0) / (freedom * (freedom + 1.0) * (freedom + 3.0))
    return of_freedom, -2.0 / ((freedom + 1.0) * (freedom + 3.0))


def _previous(residuals: Array) -> tuple[Array, Array]:
    """Return the previous residual of each residual (0 without one), and a mask of chain starts."""
    previous = np.concatenate([np.full_like(residuals[:1], np.nan), residuals[:-1]])
    starts = np.isfinite(residuals) & np.isnan(previous)
    return np.where(np.isfinite(previous), previous, 0.0), starts


OFFSET_S = 0.02
"""Standard deviation of the prior of the time between force clock and pose clock [s].

The value describes two instruments that are started by hand on one computer. Logs of one
instrument have an offset of zero.
"""
BIAS_SHARE = 0.5
"""Standard deviation of a sensor's bias relative to the size of the log's loads."""
NOISE_SHARE = 0.05
NOISE_SPREAD = 1.5
"""Spread of the prior of the noise, whose median is `NOISE_SHARE` relative to the log's loads.

The spread is the standard deviation of the logarithm of the noise. 90 % of the values lie within a
factor of 12 of the median.
"""
LEAST_NOISE = 1e-3
"""Smallest noise relative to the size of the log's loads.

This noise covers the rounding of loads in a file, and the error of the velocity of a replayed tool
within a tick.
"""
CORRELATION_SPREAD = 1.5
MOST_CORRELATED = 0.9995
"""Largest absolute correlation of neighbours.

`CORRELATION_SPREAD` is the standard deviation of artanh of the correlation in the prior: 90 % of
the correlations lie within +-0.986.
"""
LEAST_FREEDOM = 2.0
FREEDOM = 4.0
FREEDOM_SPREAD = 1.0
"""Spread of the logarithm of the noise's degrees of freedom above their minimum.

`LEAST_FREEDOM` is the minimum, at which the variance becomes finite. `FREEDOM` is the median above
this minimum. 90 % of the values lie between 3 and 23. This range covers noise with heavy tails, and
comes close enough to normal noise. If 4 degrees of freedom were assumed for normal noise, 90 %
intervals would contain the true value in only 87 % of cases.
"""


@dataclass(frozen=True)
class Unpacked:
    """Numbers of a fit, separated by their meaning.

    Attributes
    ----------
    z
        Standard normal numbers of the constants, see `Prior`, shape (p,).
    offset_s
        Offset of the force clock from the pose clock [s].
    bias
        Bias of each channel [N, N m], shape (channels,).
    scale, correlation, freedom
        Noise parameters of each channel, see `tissue.fitting.target`, shape (channels,).
    """

    z: Array
    offset_s: float
    bias: Array
    scale: Array
    correlation: Array
    freedom: Array


class Target:
    """Log density of constants and nuisance parameters (clock offset, biases and noise).

    All numbers are scaled so that their priors are standard normal.

    Parameters
    ----------
    forward
        Function from the constants to the loads.
    log
        Measured loads.
    """

    def __init__(self, forward: Forward, log: MeasuredLoads) -> None:
        self.forward = forward
        self.log = log
        self._priors = [each.prior for each in forward.parameters]
        self._places = [forward.channels.index(name) for name in log.channels]
        self._sizes = log.sizes()
        self.constants = len(self._priors)
        self.sides = np.array([each.side for each in forward.parameters])
        """Side of each constant, shape (p,), see `tissue.fitting.problem.Parameter.side`."""
        # constants, the offset, and for each channel bias, noise, correlation and freedom
        self.size = self.constants + 1 + 4 * len(log.channels)
        self._linearised: tuple[Array, Array, Array] | None = None
        self._last_shift: tuple[float, tuple[csr_array, csr_array]] | None = None

    def unpacked(self, u: Array) -> Unpacked:
        """Split the vector `u` of a fit, shape (size,), into numbers in their own units."""
        p = self.constants
        c = len(self.log.channels)
        # in the order of `size`
        bias, noise, correlation, freedom = u[p + 1 :].reshape(4, c)
        scale = self._sizes * (LEAST_NOISE + NOISE_SHARE * np.exp(NOISE_SPREAD * noise))
        return Unpacked(
            u[:p],
            OFFSET_S * float(u[p]),
            BIAS_SHARE * self._sizes * bias,
            scale,
            MOST_CORRELATED * np.tanh(CORRELATION_SPREAD * correlation),
            LEAST_FREEDOM + FREEDOM * np.exp(FREEDOM_SPREAD * freedom),
        )

    def x(self, z: Array) -> Array:
        """Return the constants in their own units."""
        return np.array([prior.x(each) for prior, each in zip(self._priors, z, strict=True)])

    def slopes(self, z: Array) -> Array:
        """Return the derivative of each constant with respect to its standard normal number."""
        return np.array([prior.slope(each) for prior, each in zip(self._priors, z, strict=True)])

    def simulated(self, u: Array) -> Array:
        """Return loads at the times of the log with offset and bias, shape (m, channels)."""
        each = self.unpacked(u)
        return self.loads(self.x(each.z), each.offset_s) + each.bias

    def loads(self, x: Array, offset_s: float) -> Array:
        """Return loads at the times of the log without bias, shape (m, channels).

        The constants are given in their own units.
        """
        values, _ = self._shifted(offset_s)
        return values @ self.forward.loads(x)[:, self._places]

    def linearised(self, u: Array) -> tuple[Array, Array]:
        """Return the loads `simulated(u)` and their derivatives, shape (m, channels, p + 1 + c).

        The derivatives are by z, the scaled offset and the scaled biases of the c channels.
        """
        each = self.unpacked(u)
        c = len(self.log.channels)
        place = u[: self.constants + 1]
        # the last place is kept, since gradient and information need the slopes of one place
        if self._linearised is None or not np.array_equal(self._linearised[0], place):
            self._linearised = (place.copy(), *self._by_place(each))
        loads, by_place = self._linearised[1:]
        by_bias = np.broadcast_to(np.diag(BIAS_SHARE * self._sizes), (len(loads), c, c))
        return loads + each.bias, np.concatenate([by_place, by_bias], axis=2)

    def _by_place(self, each: Unpacked) -> tuple[Array, Array]:
        """Return loads without bias, shape (m, channels), and their derivatives.

        The derivatives are by z and the scaled offset.
        """
        values, rates = self._shifted(each.offset_s)
        x = self.x(each.z)
        c = len(self.log.channels)
        loads = self.forward.loads(x)[:, self._places]
        jacobian = self.forward.jacobian(x)[:, self._places] * self.slopes(each.z)
        by_z = (values @ jacobian.reshape(len(jacobian), -1)).reshape(-1, c, self.constants)
        by_offset = OFFSET_S * (rates @ loads)
        return values @ loads, np.concatenate([by_z, by_offset[:, :, None]], axis=2)

    def whitened(self, moved: Array, noise: Unpacked) -> Array:
        """Return derivatives, shape (m, channels, k), as whitened rows, shape (m * channels, k).

        The transposed matrix of rows times the matrix of rows is the expected information.
        """
        known = np.isfinite(self.log.values)[:, :, None]
        each = innovations(np.where(known, moved, np.nan), noise.correlation) / noise.scale[:, None]
        rows = np.sqrt(place_information(noise.freedom))[:, None] * np.nan_to_num(each)
        return rows.reshape(-1, moved.shape[2])

    def information(self, u: Array) -> Array:
        """Return the expected information of the log and the priors about all numbers.

        The result has shape (size, size) and is positive definite. The information about constants,
        offset and biases follows from the sensitivities. The cross terms with the noise are zero.
        The information about the noise of a channel follows from Student's law (Lange, Little and
        Taylor 1989) and a stationary chain.
        """
        each = self.unpacked(u)
        free = self.constants + 1 + len(self.log.channels)
        columns = self.whitened(self.linearised(u)[1], each)
        samples = np.isfinite(self.log.values).sum(axis=0)
        nu = each.freedom
        place = place_information(each.freedom)
        # derivative of the scaled hyperbolic tangent in `unpacked`
        flat = MOST_CORRELATED - each.correlation**2 / MOST_CORRELATED
        of_correlation = place * nu / (nu - 2.0) / (1.0 - each.correlation**2)
        of_freedom, crossed = freedom_information(nu)
        by_noise = self._by_noise(each)
        by_u = FREEDOM_SPREAD * (nu - LEAST_FREEDOM)
        found = np.eye(self.size)
        found[:free, :free] += columns.T @ columns
        noise, chain, tails = np.arange(free, self.size).reshape(3, -1)
        found[noise, noise] += samples * by_noise**2 * 2.0 * nu / (nu + 3.0)
        found[chain, chain] += samples * of_correlation * (CORRELATION_SPREAD * flat) ** 2
        found[tails, tails] += samples * of_freedom * by_u**2
        found[noise, tails] += samples * crossed * by_noise * by_u
        found[tails, noise] = found[noise, tails]
        return found

    def _shifted(self, offset_s: float) -> tuple[csr_array, csr_array]:
        """Return the interpolation matrices for a clock offset, see `shift_operators`.

        The last result is kept, because a search needs loads and slopes at the same offset.
        """
        if self._last_shift is None or self._last_shift[0] != offset_s:
            operators = shift_operators(
                self.forward.times_s, self.log.times_s, offset_s, self.log.within_s
            )
            self._last_shift = offset_s, operators
        return self._last_shift[1]

    def value_and_gradient(self, u: Array) -> tuple[float, Array]:
        """Return the log density, up to a constant, and its gradient, shape (size,)."""
        each = self.unpacked(u)
        p = self.constants
        c = len(self.log.channels)
        simulated, sensitivities = self.linearised(u)
        residuals = self.log.values - simulated
        terms = self.terms(residuals, each)
        gradient = -u.copy()
        moved = -np.where(np.isfinite(residuals), terms.by_residuals, 0.0)
        gradient[: p + 1 + c] += moved.ravel() @ sensitivities.reshape(moved.size, -1)
        gradient[p + 1 + c :] += self.noise_gradient(
            each, terms.by_log_scale, terms.by_correlation, terms.by_freedom
        )
        return terms.log_density - 0.5 * float(u @ u), gradient

    def value(self, u: Array) -> float:
        """Return the log density, up to a constant.

        This takes less time than `value_and_gradient`.
        """
        each = self.unpacked(u)
        residuals = self.log.values - self.loads(self.x(each.z), each.offset_s) - each.bias
        return self.terms(residuals, each).log_density - 0.5 * float(u @ u)

    @staticmethod
    def terms(residuals: Array, each: Unpacked) -> NoiseTerms:
        """Return the log density of residuals, shape (m, channels), for some noise."""
        return noise_terms(residuals, each.scale, each.correlation, each.freedom)

    def noise_gradient(
        self, each: Unpacked, by_log_scale: Array, by_correlation: Array, by_freedom: Array
    ) -> Array:
        """Convert derivatives by noise parameters to derivatives by the numbers `u` of the fit.

        The noise parameters are the logarithm of the scale, the correlation and the degrees of
        freedom.

        The result has shape (3 * channels,).
        """
        flat = MOST_CORRELATED - each.correlation**2 / MOST_CORRELATED
        grown = FREEDOM_SPREAD * (each.freedom - LEAST_FREEDOM)
        return np.concatenate(
            [
                self._by_noise(each) * by_log_scale,
                CORRELATION_SPREAD * flat * by_correlation,
                grown * by_freedom,
            ]
        )

    def _by_noise(self, each: Unpacked) -> Array:
        """Return the derivative of the log of each channel's scale by u, shape (channels,)."""
        return NOISE_SPREAD * (1.0 - LEAST_NOISE * self._sizes / each.scale)

    def start(self, offset_s: float) -> Array:
        """Return the numbers at which an optimiser starts.

        The constants follow from linear least squares, starting from the middle of their priors.
        """
        u = np.zeros(self.size)
        u[self.constants] = offset_s / OFFSET_S
        free = self.constants + 1 + len(self.log.channels)
        # the second step starts from slopes at the first result
        for _ in range(2):
            simulated, sensitivities = self.linearised(u)
            residuals = self.log.values - simulated
            known = np.isfinite(residuals)
            # robust least squares (Huber): residuals beyond two standard deviations get less
            # weight. A thousandth of the loads keeps the scale of a log without noise above zero
            scale = SD_PER_MAD * np.nanmedian(np.abs(residuals), axis=0) + 1e-3 * self._sizes
            weights = np.where(
                known, 1.0 / np.maximum(scale, np.abs(np.where(known, residuals, 0.0)) / 2.0), 0.0
            )
            columns = (sensitivities * weights[:, :, None]).reshape(-1, free)
            wanted = (weights * np.where(known, residuals, 0.0)).ravel()
            normal = columns.T @ columns / MOST_WEIGHT + np.eye(free)
            step = np.linalg.solve(normal, columns.T @ wanted / MOST_WEIGHT - u[:free])
            # farther from the middle of the priors, loads are not linear in the constants
            u[:free] = np.clip(u[:free] + step, -4.0, 4.0)
        residuals = self.log.values - self.simulated(u)
        e = residuals[1:] - CORRELATED * residuals[:-1]
        spread = (
            SD_PER_MAD * np.nanmedian(np.abs(e - np.nanmedian(e, axis=0)), axis=0)
            + LEAST_NOISE * self._sizes
        )
        noise = slice(free, free + len(self._sizes))
        c = len(self._sizes)
        u[noise] = np.log(spread / (NOISE_SHARE * self._sizes)) / NOISE_SPREAD
        u[free + c : free + 2 * c] = np.arctanh(CORRELATED) / CORRELATION_SPREAD
        return u


MOST_WEIGHT = 10.0
"""Number of neighbouring samples that count as one while the correlation of the noise is unknown.

With a correlation of 0.8, nine samples hold as much information as one independent sample.
"""
CORRELATED = 0.5
"""Correlation of neighbours at the start of an optimiser, between white noise and a slow drift."""


class Restricted:
    """Log density of `Target` with the restricted likelihood of the noise.

    Parameters
    ----------
    target
        Log density of constants and nuisances.
    u
        Numbers at which the sensitivities are evaluated, shape (size,). The sensitivities are then
        fixed.
    """

    def __init__(self, target: Target, u: Array) -> None:
        self.target = target
        _, moved = target.linearised(u)
        known = np.isfinite(target.log.values)[:, :, None]
        follows = known[1:] & known[:-1]
        starts = known & ~np.concatenate([np.zeros_like(known[:1]), known[:-1]])
        now = np.where(follows, moved[1:], 0.0)
        before = np.where(follows, moved[:-1], 0.0)
        first = np.where(starts, moved, 0.0)
        products = _products(first, first)
        crossed = _products(now, before)
        # Information of a channel for correlation phi and scale s: (constant + linear phi + square
        # phi²) times that of a place over s².
        self._constant = products + _products(now, now)
        self._linear = -crossed - np.swapaxes(crossed, 1, 2)
        self._square = _products(before, before) - products

    def information(self, u: Array) -> Array:
        """Return `Target.information`."""
        return self.target.information(u)

    def value_and_gradient(self, u: Array) -> tuple[float, Array]:
        """Return the log density, up to a constant, and its gradient, shape (size,)."""
        value, gradient = self.target.value_and_gradient(u)
        each = self.target.unpacked(u)
        p = self.target.constants
        c = len(self.target.log.channels)
        nu = each.freedom
        phi = each.correlation[:, None, None]
        precision = (place_information(nu) / each.scale**2)[:, None, None]
        information = (self._constant + phi * self._linear + phi**2 * self._square) * precision
        whole = information.sum(axis=0) + np.eye(information.shape[1])
        inverse = np.linalg.inv(whole)
        by_phi = np.einsum(
            "ij,cji->c", inverse, (self._linear + 2.0 * phi * self._square) * precision
        )
        by_size = np.einsum("ij,cji->c", inverse, information)
        gradient[p + 1 + c :] -= self.target.noise_gradient(
            each, -by_size, 0.5 * by_phi, by_size / ((nu + 1.0) * (nu + 3.0))
        )
        return value - 0.5 * float(np.linalg.slogdet(whole)[1]), gradient


def _products(left: Array, right: Array) -> Array:
    """Return products of sensitivities, shape (m, channels, k), summed over times.

    The result has one matrix for each channel, shape (channels, k, k).
    """
    return np.einsum("tci,tcj->cij", left, right, optimize=True)
