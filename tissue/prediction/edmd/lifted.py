"""Fitted linear map of observables, discrete in time or a rate, and the cap of its eigenvalues."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.prediction.edmd.dictionary import Dictionary

__all__ = ["FitStatistics", "Generator", "LiftedMap", "Operator", "cap_spectrum", "spectral_radius"]


@dataclass(frozen=True)
class FitStatistics:
    """Statistics of a fit.

    Attributes
    ----------
    samples, episodes
        Number of pairs of neighbouring training states, and of the episodes they come from.
    rank, condition
        Number of singular values kept of the scaled regressors, and the ratio of the largest to the
        smallest of them.
    residual_rms
        One-step error of each observable on the training data, in its unit, shape (D,); of its rate
        for a generator.
    radius_before
        Spectral radius before the cap (of a generator: largest real part of an eigenvalue).
    capped
        Number of eigenvalues that were shrunk.
    cap_change
        Frobenius norm of the change by the cap, in scaled observables.
    """

    samples: int
    episodes: int
    rank: int
    condition: float
    residual_rms: Array
    radius_before: float
    capped: int = 0
    cap_change: float = 0.0


@dataclass(frozen=True)
class LiftedMap:
    """Affine map of observables, φ → A φ + B u + offset, in the units of the observables.

    Attributes
    ----------
    dictionary
        The observables.
    A, B, offset
        Shapes (D, D), (D, m), (D,).
    middle, scale
        Mean and standard deviation of the observables in training, shape (D,).
    input_middle, input_scale
        Mean and standard deviation of the inputs in training, shape (m,).
    moments
        Mean outer product of the scaled regressors [φ, u, 1] (without the 1 if there is no offset),
        shape (p, p).
    lowest, highest
        Corners of the box of the training states, without their delays, shape (d,).
    statistics
        Statistics of the fit.
    """

    dictionary: Dictionary
    A: Array
    B: Array
    offset: Array
    middle: Array
    scale: Array
    input_middle: Array
    input_scale: Array
    moments: Array
    lowest: Array
    highest: Array
    statistics: FitStatistics

    @property
    def state_size(self) -> int:
        """Number of entries of a state, without delays."""
        return len(self.lowest)

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of A, largest first."""
        values = np.linalg.eigvals(self.A / self.scale[:, None] * self.scale).astype(np.complex128)
        return values[np.argsort(-np.abs(values), kind="stable")]

    def lift(self, states: Array) -> Array:
        """Return the observables of a state, shape (D,).

        With delays, the state is an array of rows: the state and the states before it, oldest
        first.
        """
        return self.dictionary.lift(np.atleast_2d(states)[::-1].ravel())


@dataclass(frozen=True)
class Operator(LiftedMap):
    """Discrete operator: φ one step later.

    Inputs are held over the step (an exact zero-order hold).
    """

    step_s: float

    def advance(self, lifted: Array, inputs: Array | None = None) -> Array:
        """Return the observables one step later, for any leading axes.

        Use None for inputs that are zero.
        """
        advanced = lifted @ self.A.T + self.offset
        return advanced if inputs is None else advanced + inputs @ self.B.T

    def predict(self, state: Array, inputs: Array | None, horizon: int) -> Array:
        """Predict states 1 to `horizon` steps ahead, shape (horizon, d).

        The state is lifted once, advanced linearly and decoded.

        Parameters
        ----------
        state
            Present state, shape (d,); with delays the last lags + 1 states, oldest first, shape
            (lags + 1, d).
        inputs
            Inputs over each step, shape (horizon, m), or (m,) for constant inputs; None without
            inputs.
        horizon
            Number of steps.

        Raises
        ------
        InputError
            If the horizon is below 1.
        """
        if horizon < 1:
            raise InputError("horizon", "be at least 1 step", horizon, "use 1")
        lifted = self.lift(state)
        acting = np.broadcast_to(
            np.zeros(0) if inputs is None else inputs, (horizon, self.B.shape[1])
        )
        states = np.empty((horizon, self.state_size))
        # an operator left uncapped may well diverge
        with np.errstate(over="ignore", invalid="ignore"):
            for step in range(horizon):
                lifted = self.A @ lifted + self.B @ acting[step] + self.offset
                states[step] = lifted[: self.state_size]
        return states

    def predicted_states(self, horizon: int) -> list[tuple[Array, Array]]:
        """Return matrices M (d, D) and offsets c (d,) for 1 to `horizon` steps.

        The state after the steps is M φ + c, without inputs.
        """
        advanced = [(self.A[: self.state_size], self.offset[: self.state_size])]
        while len(advanced) < horizon:
            matrix, offset = advanced[-1]
            advanced.append((matrix @ self.A, matrix @ self.offset + offset))
        return advanced

    def capped(self, limit: float) -> Self:
        """Return the operator with no eigenvalue larger than `limit`.

        The shrunk operator acts about the mean of the training data. A mode at exactly 1 still
        drifts under a constant force, in proportion to time. Below 1 it stays bounded.
        """
        matrix = self.A / self.scale[:, None] * self.scale
        shrunk, count = cap_spectrum(matrix, limit)
        if count == 0:
            return self
        A = shrunk * self.scale[:, None] / self.scale
        change = float(np.linalg.norm(shrunk - matrix))
        statistics = replace(
            self.statistics,
            capped=self.statistics.capped + count,
            cap_change=self.statistics.cap_change + change,
        )
        return replace(
            self, A=A, offset=self.offset + (self.A - A) @ self.middle, statistics=statistics
        )

    def generator(self) -> "Generator":
        """Return the rate whose exact zero-order hold is this operator.

        It is the principal logarithm of [A B c; 0 1 0; 0 0 1].

        Raises
        ------
        InputError
            If an eigenvalue is zero or negative: then no real generator exists.
        """
        from scipy.linalg import logm

        values = self.eigenvalues
        size = np.abs(values)
        if (size <= 1e-12 * size.max()).any() or (
            (values.real < 0.0) & (np.abs(values.imag) <= 1e-12 * size)
        ).any():
            raise InputError(
                "eigenvalues",
                "be neither zero nor negative to have a logarithm",
                f"{values.real.min():.3g}",
                "take shorter steps or fewer observables",
            )
        whole = np.eye(len(self.offset) + self.B.shape[1] + 1)
        whole[: len(self.offset)] = _scaled(self)
        return Generator(**vars(_unscaled(self, np.real(logm(whole)) / self.step_s)))


@dataclass(frozen=True)
class Generator(LiftedMap):
    """Rate of the observables: dφ/dt = A φ + B u + offset."""

    def discrete(self, step_s: float) -> Operator:
        """Return the operator over a step [s] with inputs held.

        It is the exponential of [A B c; 0 0 0; 0 0 0] (Van Loan 1978).
        """
        from scipy.linalg import expm

        require_positive("step_s", step_s, "use the time between samples, such as 0.001")
        whole = np.zeros((len(self.offset) + self.B.shape[1] + 1,) * 2)
        whole[: len(self.offset)] = _scaled(self)
        return Operator(**vars(_unscaled(self, expm(step_s * whole))), step_s=step_s)


def _scaled(lifted: LiftedMap) -> Array:
    """Return [A B c] in units of the standard deviations, shape (D, D + m + 1)."""
    rows = lifted.scale[:, None]
    return np.hstack(
        (
            lifted.A / rows * lifted.scale,
            lifted.B / rows * lifted.input_scale,
            lifted.offset[:, None] / rows,
        )
    )


def _unscaled(lifted: LiftedMap, whole: Array) -> LiftedMap:
    """Return the map that takes scaled [φ u 1] to `whole` times it."""
    count = len(lifted.offset)
    kept = LiftedMap(**{name: getattr(lifted, name) for name in LiftedMap.__dataclass_fields__})
    return replace(
        kept,
        A=whole[:count, :count] * lifted.scale[:, None] / lifted.scale,
        B=whole[:count, count:-1] * lifted.scale[:, None] / lifted.input_scale,
        offset=whole[:count, -1] * lifted.scale,
    )


def spectral_radius(matrix: Array) -> float:
    """Return the largest modulus of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(matrix)).max(initial=0.0))


def cap_spectrum(matrix: Array, limit: float = 1.0) -> tuple[Array, int]:
    """Return the matrix with eigenvalues larger than `limit` shrunk to that size, and their number.

    The real Schur form A = Q T Qᵀ has the small eigenvalues leading. Only the diagonal blocks of
    the large eigenvalues are scaled. A state in the invariant subspace of the small eigenvalues
    therefore moves exactly as before. The small eigenvalues and the frequencies of the large ones
    do not change. The change |A' - A| is at most the excess of the large eigenvalues over the limit
    (times a block's own departure from normality). Q is orthogonal, so no matrix of eigenvectors is
    inverted and its condition number has no effect. Right eigenvectors of the small eigenvalues
    stay, left ones may turn. Several modes capped to one size may share an eigenvector: at 1 they
    then grow in proportion to the steps, not as a power; below 1 they settle.

    Raises
    ------
    InputError
        If the matrix is not finite or the limit is not positive.
    """
    from scipy.linalg import schur

    require_positive("limit", limit, "use 1")
    if not np.isfinite(matrix).all():
        raise InputError(
            "the matrix",
            "be finite to be capped",
            "NaN or infinity",
            "fit it again with ridge=1e-6",
        )
    if spectral_radius(matrix) <= limit:
        return matrix, 0
    try:
        # SciPy prints its own error when a stop is raised in its callback. Python raises
        # stops in the main thread alone, so the callback runs in another thread.
        with ThreadPoolExecutor(1) as pool:
            ordered = pool.submit(
                schur, matrix, output="real", sort=lambda re, im: re**2 + im**2 <= limit**2
            )
            triangle, basis, _ = ordered.result()
    except np.linalg.LinAlgError:
        # Eigenvalues too close to the limit to be put in order: the unordered form has the same
        # capped spectrum.
        triangle, basis = schur(matrix, output="real")
    shrunk = triangle.copy()
    capped = 0
    row = 0
    while row < len(triangle):
        size = 2 if row + 1 < len(triangle) and triangle[row + 1, row] != 0.0 else 1
        block = slice(row, row + size)
        modulus = float(np.abs(np.linalg.eigvals(triangle[block, block])).max())
        if modulus > limit:
            shrunk[block, block] *= limit / modulus
            capped += size
        row += size
    return matrix + basis @ (shrunk - triangle) @ basis.T, capped
