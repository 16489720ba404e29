"""Log density that a fit maximises.

The density is the product of the likelihood of the measured log and the priors. The numbers of a
fit are the constants, the clock offset, the sensor biases and the noise.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize
from scipy.sparse import csr_array
from scipy.special import gammaln

from meshes.base.arrays import Array
from tissue.fitting.problem import SD_PER_MAD, Forward, MeasuredLoads, shift_operators

OFFSET_S = 0.02
"""Prior standard deviation of the offset between force clock and pose clock [s].

The value describes two instruments that are started by hand on one computer. Logs of one
instrument have an offset of zero.
"""
BIAS_SHARE = 0.5
"""Prior standard deviation of a sensor's bias, relative to the size of the loads in the log."""
NOISE_SHARE = 0.05
NOISE_SPREAD = 1.5
"""Prior spread of the noise.

The spread is the standard deviation of the logarithm of the noise. The prior median of the noise is
`NOISE_SHARE`, relative to the size of the loads. Of the values, 90 % lie within a factor of 12 of
the median.
"""
LEAST_NOISE = 1e-3
"""Smallest noise relative to the size of the log's loads.

This noise covers the rounding of loads in a file, and the velocity error of a replayed tool within
a tick.
"""
CORRELATION_SPREAD = 1.5
MOST_CORRELATED = 0.9995
"""Largest absolute correlation of neighbouring residuals.

In the prior, the artanh of the correlation has the standard deviation `CORRELATION_SPREAD`. Of the
correlations, 90 % lie between -0.986 and 0.986.
"""
LEAST_FREEDOM = 2.0
FREEDOM = 4.0
FREEDOM_SPREAD = 1.0
"""Prior standard deviation of ln(f - `LEAST_FREEDOM`), with the degrees of freedom f of the noise.

`LEAST_FREEDOM` is the smallest f, at which the variance becomes finite. `FREEDOM` is the prior
median of f - `LEAST_FREEDOM`. Of the values f, 90 % lie between 3 and 23. This range covers noise
with heavy tails, and comes close enough to normal noise. If 4 degrees of freedom were assumed for
normal noise, 90 % intervals would contain the true value in only 87 % of cases.
"""
CORRELATED = 0.5
"""Correlation of neighbouring residuals at the start: between white noise (0) and drift (1)."""
FARTHEST = 4.0
"""Limit of a first guess, in standard deviations of a prior.

Farther from the medians of the priors, the loads are not linear in the constants.
"""
MOST_STEPS = 60
NEAR = 0.01
"""Limit of twice the predicted increase of the log density, below which a search ends.

`MOST_STEPS` limits the number of least-squares steps of a search. Many steps are needed if a log
determines only combinations of constants, because these constants then lie on a curve.
"""
DAMPING = 0.1
HARDER = 8.0
EASIER = 0.2
"""Factor on the damping after a step that increased the log density.

The damping is used if a step would lower the density (Levenberg 1944). The damping is relative to
the information of the priors, and begins with the value `DAMPING`. `HARDER` is the factor on the
damping after each further step that would lower the density.
"""


@dataclass(frozen=True)
class Unpacked:
    """Parameters of a fit, split into constants, clock offset, biases and noise.

    Attributes
    ----------
    z
        Constants, transformed so that their priors are standard normal, see `Prior`, shape (p,).
    offset_s
        Offset of the force clock from the pose clock [s].
    bias
        Bias of each channel [N, N m], shape (channels,).
    scale
        Scale of the t-distributed innovations of each channel, shape (channels,). With four degrees
        of freedom, the standard deviation is sqrt(2) times the scale.
    correlation
        Correlation of neighbouring residuals of each channel, in (-1, 1), shape (channels,).
    freedom
        Degrees of freedom of the innovations of each channel, shape (channels,). With fewer degrees
        of freedom, outliers have less influence.
    """

    z: Array
    offset_s: float
    bias: Array
    scale: Array
    correlation: Array
    freedom: Array


def innovations(residuals: Array, correlation: Array) -> Array:
    """Return the innovations e_t = r_t - phi r_(t-1) of residuals, shape (m, channels).

    The factor phi is `correlation`. The first innovation after a gap (NaN) is sqrt(1 - phi²) r_t,
    because the noise is assumed to be stationary. Innovations are NaN at gaps. Innovations are
    linear in the residuals, so `residuals` may also be derivatives of residuals, shape (m,
    channels, k).
    """
    previous = np.concatenate([np.full_like(residuals[:1], np.nan), residuals[:-1]])
    phi = correlation.reshape(1, -1, *[1] * (residuals.ndim - 2))
    started = np.isnan(previous)
    return np.where(started, np.sqrt(1.0 - phi**2) * residuals, residuals - phi * previous)


def likelihood(residuals: Array, noise: Unpacked) -> tuple[float, Array, Array]:
    """Compute the log density of residuals, and the weights for reweighted least squares.

    Parameters
    ----------
    residuals
        Residuals at a constant sampling rate, shape (m, channels), NaN where missing.
    noise
        Noise of each channel.

    Returns
    -------
    tuple
        Log density, innovations, and weights of the squared innovations [1/unit²]. Both arrays have
        shape (m, channels), and are 0 where no residual is known.
    """
    here = np.isfinite(residuals)
    begun = here.sum(axis=0) - np.sum(here[1:] & here[:-1], axis=0)
    e = np.where(here, innovations(residuals, noise.correlation), 0.0)
    nu = noise.freedom
    weights = np.where(here, (nu + 1.0) / (nu * noise.scale**2 + e**2), 0.0)
    # logarithm of the density of Student's law
    constant = gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu) - 0.5 * np.log(nu * np.pi)
    tails = np.log1p(e**2 / (nu * noise.scale**2)).sum(axis=0)
    density = here.sum(axis=0) * (constant - np.log(noise.scale)) - 0.5 * (nu + 1.0) * tails
    density += 0.5 * begun * np.log(1.0 - noise.correlation**2)
    return float(density.sum()), e, weights


def place_information(freedom: Array) -> Array:
    """Return the Fisher information about the location of a t-distributed innovation with scale 1.

    The result has the shape of `freedom`. The formula is from Lange, Little and Taylor (1989).
    """
    return (freedom + 1.0) / (freedom + 3.0)


class Target:
    """Log posterior density of the parameters `u` of a fit.

    All entries of `u` have standard normal priors. The first `places` entries are the constants,
    the clock offset and the biases. The other entries describe the noise: scale, correlation and
    degrees of freedom of each channel.

    Parameters
    ----------
    forward
        Function from the constants to the loads.
    log
        Measured loads.
    sizes
        Typical magnitude of each channel's loads, shape (channels,). Default: `MeasuredLoads.sizes`
        of the log.

    Attributes
    ----------
    constants, places, size
        Number of constants, number of entries of `u` on which the loads depend, and size of `u`.
    sides
        Side of the cited value on which each constant may lie, shape (p,), see
        `tissue.fitting.problem.Parameter.side`.
    """

    def __init__(self, forward: Forward, log: MeasuredLoads, *, sizes: Array | None = None) -> None:
        self.forward = forward
        self.log = log
        self._priors = [each.prior for each in forward.parameters]
        self._channels = [forward.channels.index(name) for name in log.channels]
        self._sizes = log.sizes() if sizes is None else sizes
        self.constants = len(self._priors)
        self.places = self.constants + 1 + len(log.channels)
        self.size = self.places + 3 * len(log.channels)
        self.sides = np.array([each.side for each in forward.parameters])
        self._linearised: tuple[Array, Array, Array] | None = None
        self._last_shift: tuple[float, tuple[csr_array, csr_array]] | None = None

    def unpacked(self, u: Array) -> Unpacked:
        """Split the numbers `u`, shape (size,), and convert them to their own units."""
        p = self.constants
        bias, noise, correlation, freedom = u[p + 1 :].reshape(4, -1)
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
        """Return the derivative of each constant with respect to its transformed value in `z`."""
        return np.array([prior.slope(each) for prior, each in zip(self._priors, z, strict=True)])

    def loads(self, x: Array, offset_s: float) -> Array:
        """Return loads without bias, shape (m, channels), at the times of the log.

        The constants are given in their own units.
        """
        values, _ = self._shifted(offset_s)
        return values @ self.forward.loads(x)[:, self._channels]

    def simulated(self, u: Array) -> Array:
        """Return loads with clock offset and biases at the log's times, shape (m, channels)."""
        each = self.unpacked(u)
        return self.loads(self.x(each.z), each.offset_s) + each.bias

    def linearised(self, u: Array) -> tuple[Array, Array]:
        """Return the loads `simulated(u)` and their derivatives.

        The derivatives are with respect to the first `places` entries of `u`, shape (m, channels,
        places).
        """
        each = self.unpacked(u)
        place = u[: self.constants + 1]
        # the last place is kept, since a search for the noise needs the slopes of one place
        if self._linearised is None or not np.array_equal(self._linearised[0], place):
            self._linearised = (place.copy(), *self._by_place(each))
        loads, by_place = self._linearised[1:]
        return loads + each.bias, np.concatenate([by_place, self._by_bias(len(loads))], axis=2)

    def _by_bias(self, rows: int) -> Array:
        c = len(self._sizes)
        return np.broadcast_to(np.diag(BIAS_SHARE * self._sizes), (rows, c, c))

    def _by_place(self, each: Unpacked) -> tuple[Array, Array]:
        """Return loads without bias, shape (m, channels), and their derivatives.

        The derivatives are with respect to z and the scaled offset, shape (m, channels, p + 1).
        """
        values, rates = self._shifted(each.offset_s)
        x = self.x(each.z)
        loads = self.forward.loads(x)[:, self._channels]
        jacobian = self.forward.jacobian(x)[:, self._channels] * self.slopes(each.z)
        by_z = values @ jacobian.reshape(len(jacobian), -1)
        by_z = by_z.reshape(-1, len(self._channels), self.constants)
        by_offset = OFFSET_S * (rates @ loads)
        return values @ loads, np.concatenate([by_z, by_offset[:, :, None]], axis=2)

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

    def _innovations(self, moved: Array, correlation: Array) -> Array:
        """Return the innovations of derivatives, shape (m, channels, k), 0 at gaps of the log."""
        known = np.isfinite(self.log.values)[:, :, None]
        return np.nan_to_num(innovations(np.where(known, moved, np.nan), correlation))

    def whitened(self, moved: Array, noise: Unpacked) -> Array:
        """Return the derivatives `moved`, shape (m, channels, k), as whitened rows.

        The rows have shape (m * channels, k).

        For the matrix W of rows, Wᵀ W is the expected information.
        """
        weights = np.sqrt(place_information(noise.freedom)) / noise.scale
        rows = weights[:, None] * self._innovations(moved, noise.correlation)
        return rows.reshape(-1, moved.shape[2])

    def information(self, u: Array) -> Array:
        """Return the expected information on the first `places` entries of `u`.

        The information comes from the log and the priors, and has shape (places, places). Its cross
        terms with the noise are zero.
        """
        columns = self.whitened(self.linearised(u)[1], self.unpacked(u))
        return columns.T @ columns + np.eye(self.places)

    def value(self, u: Array) -> float:
        """Return the log density, up to a constant."""
        residuals = self.log.values - self.simulated(u)
        return likelihood(residuals, self.unpacked(u))[0] - 0.5 * float(u @ u)

    def reweighted(self, u: Array) -> tuple[float, Array, Array]:
        """Return the log density, its gradient, and the matrix of reweighted least squares.

        The gradient, shape (places,), and the matrix, shape (places, places), refer to the first
        `places` entries of `u`. The weights follow from the residuals. With expected weights
        (Fisher scoring), a search would need hundreds of steps if residuals lie far in the tails.
        """
        noise = self.unpacked(u)
        simulated, moved = self.linearised(u)
        log_density, e, weights = likelihood(self.log.values - simulated, noise)
        root = np.sqrt(weights)
        columns = root[:, :, None] * self._innovations(moved, noise.correlation)
        columns = columns.reshape(-1, self.places)
        gradient = columns.T @ (root * e).ravel() - u[: self.places]
        normal = columns.T @ columns + np.eye(self.places)
        return log_density - 0.5 * float(u @ u), gradient, normal

    def climbed(self, u: Array, *, held: int | None = None) -> tuple[float, Array]:
        """Find the most probable constants, offset and biases near `u` for fixed noise.

        Return the log density and the values found, shape (size,). The entry with the index `held`
        keeps its value.
        """
        free = np.array([at for at in range(self.places) if at != held])
        damping = 0.0
        log_density, gradient, normal = self.reweighted(u)
        for _ in range(MOST_STEPS):
            matrix = normal[np.ix_(free, free)] + damping * np.eye(len(free))
            step = np.linalg.solve(matrix, gradient[free])
            if gradient[free] @ step < NEAR:
                break
            moved = u.copy()
            moved[free] += step
            tried = self.reweighted(moved)
            # Levenberg and Marquardt's damping: less after a step that succeeds, more after one
            # that fails
            if tried[0] > log_density:
                u = moved
                log_density, gradient, normal = tried
                damping = EASIER * damping if damping > DAMPING else 0.0
            else:
                damping = max(HARDER * damping, DAMPING)
        return log_density, u

    def with_noise(self, u: Array) -> tuple[float, Array]:
        """Find the noise parameters in `u` that maximise the restricted likelihood.

        Keep the other entries of `u`. Return the logarithm of the product of this likelihood and
        the priors, and all entries. The restricted likelihood is the density of the loads after the
        other entries are integrated out by Laplace's approximation about `u`.
        """
        simulated, moved = self.linearised(u)
        residuals = self.log.values - simulated
        # the information of a channel is a polynomial of degree two in its correlation
        half = np.full(len(self._sizes), 0.5)
        even, up, down = (
            np.einsum("tci,tcj->cij", each, each, optimize=True)
            for each in (self._innovations(moved, phi) for phi in (0.0 * half, half, -half))
        )
        linear = up - down
        square = 2.0 * (up + down) - 4.0 * even

        def loss(noise: Array) -> float:
            tried = np.concatenate([u[: self.places], noise])
            each = self.unpacked(tried)
            phi = each.correlation[:, None, None]
            precision = (place_information(each.freedom) / each.scale**2)[:, None, None]
            information = np.sum((even + phi * linear + phi**2 * square) * precision, axis=0)
            _, volume = np.linalg.slogdet(information + np.eye(self.places))
            return 0.5 * float(volume + tried @ tried) - likelihood(residuals, each)[0]

        found = minimize(loss, u[self.places :], method="L-BFGS-B")
        return -float(found.fun), np.concatenate([u[: self.places], found.x])

    def start(self, offset_s: float) -> Array:
        """Return the starting values of a search with the given clock offset, shape (size,).

        The constants are computed by two steps of reweighted least squares, starting at their prior
        medians.
        """
        u = np.zeros(self.size)
        u[self.constants] = offset_s / OFFSET_S
        for _ in range(2):
            u[self.places :] = self._rough_noise(u)
            _, gradient, normal = self.reweighted(u)
            place = u[: self.places] + np.linalg.solve(normal, gradient)
            u[: self.places] = np.clip(place, -FARTHEST, FARTHEST)
        u[self.places :] = self._rough_noise(u)
        return u

    def _rough_noise(self, u: Array) -> Array:
        """Return the numbers of the noise, estimated from the median size of the residuals."""
        residuals = self.log.values - self.simulated(u)
        e = residuals[1:] - CORRELATED * residuals[:-1]
        away = np.nanmedian(np.abs(e - np.nanmedian(e, axis=0)), axis=0)
        scale = np.log((SD_PER_MAD * away / self._sizes + LEAST_NOISE) / NOISE_SHARE) / NOISE_SPREAD
        correlation = np.full(len(scale), np.arctanh(CORRELATED) / CORRELATION_SPREAD)
        return np.concatenate([scale, correlation, np.zeros(len(scale))])
