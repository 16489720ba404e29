"""Constants that vary in an uncertainty band, and quasi-Monte Carlo samples of these constants."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import tomli_w
from scipy.sparse.csgraph import connected_components
from scipy.special import ndtri
from scipy.stats import qmc
from scipy.stats import sobol_indices as scipy_indices

from meshes.base.arrays import Array, Ints
from meshes.base.errors import require_range
from tissue.materials.constants import Constant, Entry, Prior
from tissue.materials.scene_constants import Materials
from tissue.scene.scene import Scene
from tissue.scene.used_constants import used_constants

FEWEST_SAMPLES = 16
MOST_SAMPLES = 65536
"""Largest number of samples of a band.

`FEWEST_SAMPLES` is the smallest number, 16. With fewer samples, no sample would lie outside the
90 % band.

At 16,384 samples, the sampling error of a 95 % quantile is 0.12 % (``tests/bench/bench_band.py``).
More than 65,536 samples would only cost time.
"""


@dataclass(frozen=True, eq=False)
class Ranges:
    """Constants that vary in an uncertainty band.

    Attributes
    ----------
    names
        Names such as ``cutting.bone.radial_chip_N_mm2``.
    priors
        Prior of each constant. Every prior has a range.
    correlation
        Correlation matrix of the standard normal numbers that are transformed into the constants,
        shape (p, p).
    """

    names: tuple[str, ...]
    priors: tuple[Prior, ...]
    correlation: Array

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Indices of the constants in each group of directly or indirectly correlated constants."""
        labels = connected_components(self.correlation != 0.0, directed=False)[1]
        return tuple(
            tuple(np.flatnonzero(labels == label).tolist())
            for label in range(labels.max(initial=-1) + 1)
        )

    @cached_property
    def group_names(self) -> tuple[str, ...]:
        """Name of each group: the names of its constants, joined by `` + ``."""
        return tuple(" + ".join(self.names[at] for at in group) for group in self.groups)

    def x(self, free: Array) -> Array:
        """Convert standard normal numbers, shape (n, p), to values of the constants, same shape.

        The normal numbers are independent. The constants are correlated as `correlation` describes.
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
    """Return the constants of a scene that have a range and are not set by the scene itself.

    Parameters
    ----------
    scene
        The scene.
    layers
        Layers of the scene's bone whose constants are returned.
    table
        Beginning of the names of the returned constants. An empty string selects all names.
    further
        Priors of other quantities that vary, keyed by name.
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
    count = int(
        require_range("band", asked, FEWEST_SAMPLES, MOST_SAMPLES, "use a value such as 200")
    )
    return 1 << (count - 1).bit_length()


def normals(count: int, width: int, *, seed: int) -> Array:
    """Return independent standard normal numbers, shape (count, width).

    The numbers follow a scrambled Sobol sequence. `count` is a power of two.
    """
    points = qmc.Sobol(width, scramble=True, seed=seed).random(count)
    # a point of exactly 0 or 1 would give an infinite number; 1e-12 is 7 standard deviations away
    return ndtri(np.clip(points, 1e-12, 1.0 - 1e-12))


SOURCE = "a sample of a band"


def sample_name(number: int, count: int) -> str:
    """Return the file name of a sample, such as ``sample_017.toml`` if there are 256 samples."""
    return f"sample_{number:0{len(str(count - 1))}d}.toml"


def sampled(constants: Materials, names: Sequence[str], x: Array) -> Materials:
    """Return a copy of the constants with the values `x` of a sample for the constants `names`.

    `x` has shape (p,).

    Each entry of `names` has the form ``TABLE.MATERIAL.NAME``. Density factors are left out,
    because they are not constants of a material.
    """
    values = (Constant(value, value, value, SOURCE, "L") for value in map(float, x))
    drawn = {
        name: one
        for name, one in zip(names, values, strict=True)
        if not name.startswith("density.")
    }
    return replace(constants, given={**constants.given, **drawn}, names=(), matrix=())


def sample_text(constants: Materials, names: Sequence[str], x: Array) -> str:
    """Return the text of the TOML file of a sample.

    A density factor is written as a comment, because a scene cannot set it.
    """
    lines = [
        f"# {name} = {float(value)!r}, which no file of materials holds"
        for name, value in zip(names, x, strict=True)
        if name.startswith("density.")
    ]
    given = sampled(constants, names, x).given
    return "\n".join([*lines, tomli_w.dumps(toml_tables(given))])


def toml_tables(given: Mapping[str, Constant]) -> dict[str, dict[str, dict[str, Entry]]]:
    """Return the nested tables of a TOML file for constants with names ``TABLE.MATERIAL.NAME``."""
    tables: dict[str, dict[str, dict[str, Entry]]] = {}
    for full, one in given.items():
        table, material, name = full.split(".", 2)
        tables.setdefault(table, {}).setdefault(material, {})[name] = {
            "value": one.value,
            "range": [one.low, one.high],
            "source": one.source,
            "confidence": one.confidence,
        }
    return tables


DRAWS = 400
"""Number of bootstrap draws for the ends of 90 % intervals.

With 400 draws, the probability beyond each end, which should be 5 %, has a standard error of 1 %.
"""


def sobol_indices(
    figures: Callable[[Array], Array], groups: tuple[tuple[int, ...], ...], *, count: int, seed: int
) -> Array:
    """Compute first-order and total Sobol indices of a function of standard normal numbers.

    The numbers are independent. Two random matrices A and B are drawn. For each group of columns, a
    third matrix is a copy of A with the columns of the group taken from B. First-order indices use
    the formula of Saltelli et al. (2010, Comput. Phys. Commun. 181:259, table 2 b). Total indices
    use the formula of Jansen (table 2 f in the same paper).

    Parameters
    ----------
    figures
        Function that maps normal numbers, shape (n, p), to n rows of values, shape (n, figures).
        Indices are computed for each column of values.
    groups
        Columns of each group. Every column belongs to one group.
    count
        Number of rows of A, a power of two. `figures` is evaluated for ``count * (groups + 2)``
        rows in total.

    Returns
    -------
    Influence of each group of constants on each value, shape (2, 3, groups, figures). The first
    axis contains the first-order index and the total index. The second axis contains the index and
    the lower and upper ends of its 90 % bootstrap interval. The indices of a value that does not
    vary are NaN.
    """
    width = sum(map(len, groups))
    both = normals(count, 2 * width, seed=seed)
    first = both[:, :width]
    second = both[:, width:]
    mixed = []
    for group in groups:
        rows = first.copy()
        rows[:, group] = second[:, group]
        mixed.append(figures(rows).T)
    sampled = {"f_A": figures(first).T, "f_B": figures(second).T, "f_AB": np.stack(mixed)}

    constant = np.ptp(sampled["f_A"], axis=1) == 0.0

    def indices(rows: Ints) -> Array:
        found = scipy_indices(func={name: f[..., rows] for name, f in sampled.items()}, n=count)
        both = np.stack([found.first_order, found.total_order])
        both = both.reshape(2, len(constant), len(groups))  # SciPy drops an axis of length 1
        both[:, constant] = np.nan
        return both.swapaxes(1, 2)

    # SciPy's own bootstrap takes no seed, and a band must be the same each time
    rng = np.random.default_rng(seed)
    drawn = [indices(rows) for rows in rng.integers(0, count, (DRAWS, count))]
    return _with_ends(indices(np.arange(count)), drawn)


def _with_ends(whole: Array, drawn: list[Array]) -> Array:
    """Return Sobol indices and the ends of their 90 % bootstrap intervals, stacked along axis 1."""
    ends = np.quantile(np.array(drawn), (0.05, 0.95), axis=0)
    return np.stack([whole, *ends], axis=1)


LEAST_EXPLAINED = 0.8
"""Cross-validated share of explained variance below which a surrogate gives no indices.

If this share is smaller, more than a fifth of the variance is attributed to no constant, or to a
wrong constant.
"""
RIDGES = 10.0 ** np.arange(-6, 3)
"""Ridge parameters that are compared; the terms of the polynomial have unit variance.

With the smallest parameter the surrogate interpolates the runs. With the largest parameter it is
almost constant.
"""
REFITS = 100
"""Number of bootstrap draws of a surrogate: fewer than `DRAWS`, because each draw needs a fit."""


def surrogate_indices(
    free: Array, figures: Array, groups: tuple[tuple[int, ...], ...], *, seed: int
) -> tuple[Array, Array]:
    """Compute Sobol indices of summary values with a polynomial, and the variance it explains.

    The indices have the form of `sobol_indices`.

    The polynomial is a sum of products of normalised Hermite polynomials up to degree two. Its
    coefficients are found by ridge regression. The indices are computed from the coefficients
    (Sudret 2008, Reliab. Eng. Syst. Saf. 93:964). The share of explained variance is evaluated on
    runs that are not used in the fit.

    Parameters
    ----------
    free
        Independent standard normal numbers of each run, shape (n, p).
    figures
        Summary values of each run, shape (n, figures).
    groups
        Columns of each group. Every column belongs to one group.
    """
    terms = _terms(free.shape[1])
    basis = np.column_stack([_product(free, term) for term in terms])
    members = np.array([[any(at in group for at in term) for term in terms] for group in groups])
    alone = np.array([[all(at in group for at in term) for term in terms] for group in groups])
    count = len(groups)
    width = figures.shape[1]
    found = np.full((2, 3, count, width), np.nan)
    explained = np.full(width, np.nan)
    rng = np.random.default_rng(seed)
    for column, values in enumerate(figures.T):
        # a constant figure has no variance to attribute
        if np.ptp(values) == 0.0:
            continue
        ridge, explained[column] = _best(basis, values)
        if explained[column] < LEAST_EXPLAINED:
            continue
        rows = [np.arange(len(free)), *rng.integers(0, len(free), (REFITS, len(free)))]
        drawn = [
            _shares(_fitted(basis[each], values[each], ridge), alone, members) for each in rows
        ]
        found[..., column] = _with_ends(drawn[0], drawn[1:])
    return found, explained


def _terms(width: int) -> list[tuple[int, ...]]:
    """Return the column indices of each polynomial term: single columns, squares and pairs.

    The term of a square contains the index of its column twice.
    """
    places = range(width)
    return [*((at,) for at in places), *((at, at) for at in places), *combinations(places, 2)]


def _product(free: Array, term: tuple[int, ...]) -> Array:
    # normalised Hermite polynomials of degree two: (z**2 - 1) / sqrt(2) of one number, else a
    # product
    if len(term) == 2 and term[0] == term[1]:
        return (free[:, term[0]] ** 2 - 1.0) / np.sqrt(2.0)
    return free[:, list(term)].prod(axis=1)


def _fitted(basis: Array, values: Array, ridge: float) -> Array:
    """Return the coefficients of a ridge regression of centred values on a centred basis."""
    centred = basis - basis.mean(axis=0)
    kernel = centred @ centred.T
    kernel[np.diag_indices_from(kernel)] += ridge * len(basis)
    return centred.T @ np.linalg.solve(kernel, values - values.mean())


def _best(basis: Array, values: Array) -> tuple[float, float]:
    """Return the best ridge parameter, and the share of the variance that the fit explains.

    The best ridge parameter has the smallest error on runs that are left out of the fit one by one.
    This error has a closed form (Allen 1974, Technometrics 16:125).
    """
    centred = basis - basis.mean(axis=0)
    eigenvalues, vectors = np.linalg.eigh(centred @ centred.T)
    errors = []
    for ridge in RIDGES * len(basis):
        rest = ridge / (eigenvalues.clip(0.0) + ridge)
        residuals = vectors @ (rest * (vectors.T @ (values - values.mean())))
        # the mean takes one degree of freedom in addition to the polynomial
        freedom = vectors**2 @ rest - 1.0 / len(values)
        errors.append(np.mean((residuals / freedom) ** 2))
    at = int(np.argmin(errors))
    return float(RIDGES[at]), 1.0 - float(errors[at] / values.var())


def _shares(coefficients: Array, alone: Array, members: Array) -> Array:
    """Return first-order and total Sobol indices, shape (2, groups)."""
    # coefficients of zero have no indices: 1e-300 avoids a division by zero
    squares = coefficients**2 / max(float((coefficients**2).sum()), 1e-300)
    return np.stack([alone @ squares, members @ squares])
