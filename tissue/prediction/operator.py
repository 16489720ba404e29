"""Linear operators of lifted states: their observables, and the cap of their eigenvalues."""

from abc import ABC, abstractmethod
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive

__all__ = [
    "Delays",
    "Dictionary",
    "FitStatistics",
    "GapProducts",
    "Identity",
    "Operator",
    "Polynomials",
    "cap_spectrum",
    "spectral_radius",
]

Indices = NDArray[np.intp]


class Dictionary(ABC):
    """Observables φ(x) of a state x.

    The state itself comes first, once, so that the first entries decode it.

    A dictionary with `lags` earlier states takes windows of shape (..., (lags + 1) d), newest state
    first. The leading state is then the whole window, and its newest d entries come first. A
    subclass defines the observables after the state by `extra_size` and `extra`. Both work over any
    leading axes, one sample included.
    """

    lags: int = 0

    @abstractmethod
    def extra_size(self, state_size: int) -> int:
        """Return the number of observables beyond the state."""

    @abstractmethod
    def extra(self, states: Array) -> Array:
        """Return the observables beyond the state, shape (..., extra_size)."""

    def size(self, state_size: int) -> int:
        """Return the number of observables of a state with a given number of entries."""
        window_size = state_size * (self.lags + 1)
        return window_size + self.extra_size(window_size)

    def lift(self, states: Array) -> Array:
        """Return the observables of states or windows, shape (..., D)."""
        return np.concatenate((states, self.extra(states)), axis=-1)


@dataclass(frozen=True)
class Identity(Dictionary):
    """The state alone: linear dynamic mode decomposition."""

    def extra_size(self, state_size: int) -> int:
        """Return 0: there are no observables beyond the state."""
        return 0

    def extra(self, states: Array) -> Array:
        """Return an empty array, shape (..., 0)."""
        return states[..., :0]


@dataclass(frozen=True)
class Delays(Dictionary):
    """Observables of the present state and the `lags` states before it.

    This is a delay embedding (Takens 1981). The inner dictionary, which has no delays, takes the
    whole window as its state, newest first.
    """

    lags: int
    inner: Dictionary = Identity()

    def extra_size(self, state_size: int) -> int:
        """Return the number of observables that the inner dictionary adds to the window."""
        return self.inner.extra_size(state_size)

    def extra(self, states: Array) -> Array:
        """Return the observables that the inner dictionary adds to the windows."""
        return self.inner.extra(states)


@dataclass(frozen=True)
class Polynomials(Dictionary):
    """All monomials of degree 2 to `order` of the state's entries.

    Degree 1 is the state itself.

    Parameters
    ----------
    order
        Highest degree, 2 or more.
    columns
        Entries of the state (of the window, with delays) to multiply; empty for all.
    """

    order: int
    columns: tuple[int, ...] = ()

    def extra_size(self, state_size: int) -> int:
        """Return the number of monomials."""
        levels = _monomials(len(self.columns) or state_size, self.order)
        return sum(len(parents) for parents, _ in levels)

    def extra(self, states: Array) -> Array:
        """Return the monomials, by degree, then in the order of the entries."""
        factors = states[..., list(self.columns)] if self.columns else states
        levels = [factors]
        for parents, entries in _monomials(factors.shape[-1], self.order):
            levels.append(levels[-1][..., parents] * factors[..., entries])
        return np.concatenate(levels[1:], axis=-1)


@lru_cache(maxsize=64)
def _monomials(entry_count: int, order: int) -> tuple[tuple[Indices, Indices], ...]:
    """Return, for each degree from 2, the two factors of each monomial.

    The first factor is the index of a monomial of the degree below, the second the index of an
    entry.
    """
    last = list(range(entry_count))
    levels = []
    for _ in range(2, order + 1):
        made = [
            (parent, entry)
            for parent, highest in enumerate(last)
            for entry in range(highest, entry_count)
        ]
        parents, entries = np.array(made, np.intp).T
        levels.append((parents, entries))
        last = entries.tolist()
    return tuple(levels)


@dataclass(frozen=True)
class GapProducts(Dictionary):
    """Observables of unilateral contact with a gap g and an overlap p = max(0, -g).

    The gap is g = normal · x + distance. The observables are p and p², and for each entry x_j of
    `columns` the product p x_j and the entry x_j while the gap is closed. With the velocity among
    the columns, the force of a unilateral spring and damper is a combination of p and the velocity.

    Parameters
    ----------
    normal
        Weights of the state's first entries in the gap, each in the gap's unit over the entry's.
    distance
        Gap at the state zero, in the gap's unit.
    columns
        Entries of the state to multiply. Leave out the gap's own entry, which would repeat the
        overlap.
    """

    normal: tuple[float, ...]
    distance: float = 0.0
    columns: tuple[int, ...] = ()

    def extra_size(self, state_size: int) -> int:
        """Return the number of observables: two, and two for each column."""
        return 2 + 2 * len(self.columns)

    def extra(self, states: Array) -> Array:
        """Return the overlap, its products, and the entries while closed.

        The shape is (..., 2 + 2 columns).
        """
        gap = states[..., : len(self.normal)] @ np.array(self.normal) + self.distance
        overlap = np.maximum(0.0, -gap)[..., None]
        entries = states[..., list(self.columns)]
        products = (overlap, overlap**2, overlap * entries, (overlap > 0.0) * entries)
        return np.concatenate(products, axis=-1)


@dataclass(frozen=True)
class FitStatistics:
    """Statistics of a fit.

    Attributes
    ----------
    samples
        Number of pairs of neighbouring training states.
    residual_rms
        One-step error of each observable on the training data, in its unit, shape (D,).
    radius_before
        Spectral radius before the cap.
    capped
        Number of eigenvalues that were shrunk.
    """

    samples: int = 0
    residual_rms: Array = field(default_factory=lambda: np.zeros(0))
    radius_before: float = 0.0
    capped: int = 0


@dataclass(frozen=True)
class Operator:
    """Affine map of observables over a step, φ → A φ + B u + offset, in their units.

    Inputs are held over the step (an exact zero-order hold).

    Attributes
    ----------
    dictionary
        The observables.
    A, B, offset
        Shapes (D, D), (D, m), (D,).
    middle, scale
        Mean and standard deviation of the observables in training, shape (D,).
    step_s
        Length of the step [s].
    statistics
        Statistics of the fit; zeros for an operator from a file.
    """

    dictionary: Dictionary
    A: Array
    B: Array
    offset: Array
    middle: Array
    scale: Array
    step_s: float
    statistics: FitStatistics = field(default_factory=FitStatistics)

    @property
    def state_size(self) -> int:
        """Number of entries of a state, without delays; 0 if the matrices do not fit."""
        count = len(self.offset)
        fitting = (size for size in range(1, count + 1) if self.dictionary.size(size) == count)
        return next(fitting, 0)

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Eigenvalues of A, largest first."""
        values = np.linalg.eigvals(self._scaled()).astype(np.complex128)
        return values[np.argsort(-np.abs(values), kind="stable")]

    def predicted_states(self, horizon: int) -> list[tuple[Array, Array]]:
        """Return matrices M (d, D) and offsets c (d,) for 1 to `horizon` steps.

        The state after the steps is M φ + c, without inputs.
        """
        size = self.state_size
        advanced = [(self.A[:size], self.offset[:size])]
        while len(advanced) < horizon:
            matrix, offset = advanced[-1]
            advanced.append((matrix @ self.A, matrix @ self.offset + offset))
        return advanced

    def capped(self, limit: float) -> "Operator":
        """Return the operator with no eigenvalue larger than `limit`.

        The shrunk operator acts about the mean of the training data. A mode at exactly 1 still
        drifts under a constant force, in proportion to time. Below 1 it stays bounded.
        """
        shrunk, count = cap_spectrum(self._scaled(), limit)
        if count == 0:
            return self
        A = shrunk * self.scale[:, None] / self.scale
        statistics = replace(self.statistics, capped=self.statistics.capped + count)
        offset = self.offset + (self.A - A) @ self.middle
        return replace(self, A=A, offset=offset, statistics=statistics)

    def _scaled(self) -> Array:
        """Return A in units of the standard deviations."""
        return self.A / self.scale[:, None] * self.scale


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
        # A pair of complex eigenvalues has a block of two rows.
        size = 2 if row + 1 < len(triangle) and triangle[row + 1, row] != 0.0 else 1
        block = slice(row, row + size)
        modulus = spectral_radius(triangle[block, block])
        if modulus > limit:
            shrunk[block, block] *= limit / modulus
            capped += size
        row += size
    return matrix + basis @ (shrunk - triangle) @ basis.T, capped
