"""Comparison of cutting laws by a table of steady loads.

Each law is fitted by maximum likelihood with coefficients of 0 and above and no priors. The loads
are linear in the four coefficients of chip and edge at a given exponent of the size effect. With
the scatter of the rows, the sum of squares follows the chi-square law. Its degrees of freedom are
the number of loads less the number of constants that lie above 0.

A steady load of one drill has the same form with and without a chisel edge: a chip term plus an
edge term. Free coefficients absorb the factor between both drills. Only coefficients with their
cited ranges tell the drills apart. The largest density of table and priors together gives the sum
of squared errors and squared standard normal numbers. If all were linear, its degrees of freedom
would be the number of loads.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar, nnls
from scipy.stats import chi2

from meshes.base.arrays import Array
from tissue.fitting.cutting import CuttingForward
from tissue.fitting.table import SteadyTable, TableTarget, table_forward
from tissue.scene.scene import Scene
from tissue.simulation.load_record import SENSITIVITIES

__all__ = ["REJECTED", "LawMisfit", "compared_laws", "law_sentences"]


REJECTED = 0.05
"""Probability of a larger misfit below which a law is rejected."""
FREE = (
    "tangential_chip_Pa",
    "radial_chip_Pa",
    "tangential_edge_N_m",
    "radial_edge_N_m",
)
"""Coefficients of a maximum-likelihood fit.

The axial coefficients act on the thrust as the radial ones do.
"""
TYPICAL = np.array([1e8, 1e8, 1e3, 1e3])
"""Units of these coefficients [Pa, N/m], in which their effects are alike."""
EXPONENTS = np.linspace(0.0, 0.9, 19)
"""Exponents of the size effect from which the search begins."""
PRECISION = 1e-4
"""Precision of the exponent."""
NO_EFFECT = 1e-6
"""Singular value, relative to the largest, below which a combination has no effect on the loads."""
LEAST_RESIDUAL = 1e-9
"""Root mean square residual, relative to the mean load, that stands in for an exact fit."""


@dataclass(frozen=True)
class LawMisfit:
    """Misfit of one cutting law to a table.

    Attributes
    ----------
    has_size_effect
        True for a free exponent m and a minimum chip thickness, False for the law that is linear in
        the chip thickness and has its edge force at any thickness.
    has_chisel
        True for a drill with a chisel edge, False for lips that reach the axis.
    constants
        Number of constants of the maximum-likelihood fit, without the scatter.
    size_exponent
        Its exponent m.
    chi_square, freedom, p
        Its sum of squares over the scatter, the degrees of freedom, and the probability of a larger
        sum. None without a scatter or without degrees of freedom.
    aic
        Akaike's information criterion, up to a constant that all laws of a table share.
    left_out
        Error of each row as predicted from the other rows, relative to its loads (root mean
        square). None if the other rows do not determine the constants.
    cited_chi_square, cited_p
        Sum of squares with the cited ranges as priors, and the probability of a larger sum. None
        without a scatter.
    """

    has_size_effect: bool
    has_chisel: bool
    constants: int
    size_exponent: float
    chi_square: float | None
    freedom: int
    p: float | None
    aic: float
    left_out: float | None
    cited_chi_square: float | None
    cited_p: float | None

    @property
    def law(self) -> str:
        """The law in words, without the drill."""
        return "law with a size effect" if self.has_size_effect else "linear law"

    @property
    def name(self) -> str:
        """The law and the drill in words."""
        return f"{self.law}, {'chisel edge' if self.has_chisel else 'simple drill'}"


def compared_laws(scene: Scene, table: SteadyTable) -> tuple[LawMisfit, ...]:
    """Return the misfit of the linear law and of the size effect, each for both drills.

    Parameters
    ----------
    scene
        A block of bone and a drill, see `tissue.fitting.table.table_forward`. The chisel edge has
        the scene's ``tool.web_mm``, or its default if that is 0.
    table
        Measured loads.
    """
    found = []
    for has_size_effect, has_chisel in product((False, True), (False, True)):
        changed = _with_law(scene, has_size_effect=has_size_effect, has_chisel=has_chisel)
        forward = table_forward(changed, table)
        fit = _Likelihood(forward, table, has_size_effect=has_size_effect)
        cited = _cited_chi_square(forward, table)
        found.append(
            LawMisfit(
                has_size_effect,
                has_chisel,
                fit.constants,
                fit.exponent,
                fit.chi_square,
                fit.freedom,
                _probability(fit.chi_square, fit.freedom),
                fit.aic,
                fit.left_out(),
                cited,
                _probability(cited, table.loads.size),
            )
        )
    return tuple(found)


def _probability(chi_square: float | None, freedom: int) -> float | None:
    """Return the probability of a larger sum of squares."""
    if chi_square is None or freedom < 1:
        return None
    return float(chi2.sf(chi_square, freedom))


def _with_law(scene: Scene, *, has_size_effect: bool, has_chisel: bool) -> Scene:
    """Return a scene with one of the laws and one of the drills."""
    web_mm = (getattr(scene.tool, "web_mm", None) or None) if has_chisel else 0.0
    minimum = scene.cutting.minimum_chip_um or None
    changes = {"size_exponent": None, "minimum_chip_um": minimum}
    if not has_size_effect:
        changes = {"size_exponent": 0.0, "minimum_chip_um": 0.0}
    return scene.model_copy(
        update={
            "tool": scene.tool.model_copy(update={"web_mm": web_mm}),
            "cutting": scene.cutting.model_copy(update=changes),
        }
    )


def _cited_chi_square(forward: CuttingForward, table: SteadyTable) -> float | None:
    """Return the smallest sum of squares with the cited ranges as priors."""
    if table.scatter is None:
        return None
    target = TableTarget(forward, table)
    others = np.zeros(target.size - target.constants)

    def errors(z: Array) -> Array:
        simulated = target.simulated(np.concatenate([z, others]))
        return np.concatenate([(simulated - target.log.values).ravel(), z])

    def slopes(z: Array) -> Array:
        _, moved = target.linearised(np.concatenate([z, others]))
        by_z = moved[:, :, : target.constants].reshape(-1, target.constants)
        return np.concatenate([by_z, np.eye(target.constants)])

    # A constant whose cited value is an end of its range stays on its side of that value.
    lowest = np.where(target.sides > 0.0, 0.0, -np.inf)
    highest = np.where(target.sides < 0.0, 0.0, np.inf)
    # The search would stall on a bound, so it starts inside of them.
    found = least_squares(errors, 0.5 * target.sides, jac=slopes, bounds=(lowest, highest))
    return 2.0 * float(found.cost)


class _Likelihood:
    """Maximum-likelihood fit of one law to a table.

    Parameters
    ----------
    forward
        Loads of the rows over their units.
    table
        Measured loads.
    has_size_effect
        Whether the exponent is free.
    """

    def __init__(
        self, forward: CuttingForward, table: SteadyTable, *, has_size_effect: bool
    ) -> None:
        self._forward = forward
        self._places = [forward.channels.index(name) for name in table.channels]
        self._values = table.loads / table.units
        self._has_scatter = table.scatter is not None
        self._exponents = EXPONENTS if has_size_effect else EXPONENTS[:1]
        self._designs: dict[float, Array] = {}
        columns = self._design(0.0).reshape(-1, len(FREE))
        self.constants = _rank(columns) + has_size_effect
        misfit, self.exponent, found = self._fitted(np.arange(len(self._values)))
        # A constant at its end, 0, fits nothing.
        free = _rank(columns[:, found > 0.0]) + (self.exponent > 0.0)
        self.freedom = self._values.size - free
        self.chi_square = misfit if self._has_scatter else None
        scales = 0 if self._has_scatter else len(self._places)
        self.aic = misfit + 2.0 * (self.constants + scales)

    def left_out(self) -> float | None:
        """Return the relative error of each row as predicted from the other rows."""
        rows = np.arange(len(self._values))
        if (len(rows) - 1) * len(self._places) < self.constants:
            return None
        errors = []
        for row in rows.tolist():
            _, exponent, found = self._fitted(rows[rows != row])
            errors.append(self._design(exponent)[row] @ found / self._values[row] - 1.0)
        return float(np.sqrt(np.mean(np.square(errors))))

    def _fitted(self, rows: NDArray[np.intp]) -> tuple[float, float, Array]:
        """Return the smallest misfit of some rows, its exponent and its coefficients."""

        def misfit(exponent: float) -> float:
            return self._solved(exponent, rows)[0]

        best = float(min(self._exponents.tolist(), key=misfit))
        if len(self._exponents) > 1:
            step = float(EXPONENTS[1])
            search = minimize_scalar(
                misfit,
                bounds=(max(best - step, 0.0), min(best + step, float(EXPONENTS[-1]))),
                method="bounded",
                options={"xatol": PRECISION},
            )
            best = min(best, float(search.x), key=misfit)
        smallest, found = self._solved(best, rows)
        return smallest, best, found

    def _solved(self, exponent: float, rows: NDArray[np.intp]) -> tuple[float, Array]:
        """Return minus twice the log likelihood, up to a constant, and the coefficients."""
        columns = self._design(exponent)[rows].reshape(-1, len(FREE))
        values = self._values[rows]
        found, _ = nnls(columns, values.ravel())
        squares = np.sum((values - (columns @ found).reshape(values.shape)) ** 2, axis=0)
        if self._has_scatter:
            return float(squares.sum()), found
        variances = np.maximum(squares / len(rows), LEAST_RESIDUAL**2)
        return float(len(rows) * np.log(variances).sum()), found

    def _design(self, exponent: float) -> Array:
        """Return the loads over their units by the coefficients, shape (n, channels, 4).

        The coefficients are in units of `TYPICAL`.
        """
        if exponent not in self._designs:
            coefficients = replace(self._forward.coefficients[0], size_exponent=exponent)
            slopes = self._forward.record.jacobian((coefficients,))[:, self._places, 0]
            places = [SENSITIVITIES.index(name) for name in FREE]
            self._designs[exponent] = slopes[..., places] * TYPICAL
        return self._designs[exponent]


def _rank(columns: Array) -> int:
    """Return the number of independent columns."""
    if not columns.any():
        return 0
    return int(np.linalg.matrix_rank(columns / np.abs(columns).max(), rtol=NO_EFFECT))


def law_sentences(laws: Sequence[LawMisfit]) -> list[str]:
    """Return sentences on which laws a table rejects."""
    if not laws:
        return []
    ranked = sorted(laws[::2], key=lambda each: each.aic)
    best = ranked[0]
    gaps = [f"{each.law} (AIC {each.aic - best.aic:+.1f})" for each in ranked[1:]]
    ranking = f"by AIC the {best.law} comes before the {', '.join(gaps)}"
    if laws[0].cited_p is None:
        return [f"the table states no scatter, so it rejects no law; {ranking}"]
    found = []
    for each in laws[::2]:
        if each.p is None:
            found.append(f"{each.law}: not tested, it has as many constants as the table has loads")
            continue
        verdict = "rejected with any coefficients" if each.p < REJECTED else "not rejected"
        found.append(
            f"{each.law}: {verdict}, chi-square {each.chi_square:.3g} with {each.freedom} degrees "
            f"of freedom, p = {each.p:.2g}"
        )
    wrong = [each.name for each in laws if each.cited_p is not None and each.cited_p < REJECTED]
    if wrong:
        found.append(f"rejected with coefficients in their cited ranges: {'; '.join(wrong)}")
    else:
        found.append("no law is rejected with coefficients in their cited ranges")
    return [*found, ranking]
