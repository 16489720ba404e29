"""Comparison of cutting laws with a table of steady loads.

Each law is fitted by maximum likelihood, without priors. At a given exponent of the size effect,
thrust and torque are each linear in a chip and an edge coefficient. If the table states the scatter
of the rows, the sum of squared errors has a chi-square distribution. The number of degrees of
freedom is the number of loads minus the number of constants. Constants at their lower limit of 0
are not counted.

A second misfit uses the cited ranges as priors. This misfit is the smallest value of a sum: the
squared errors of the loads plus the squared standard normal numbers of the constants. In a linear
problem, it has as many degrees of freedom as there are loads.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize_scalar, nnls
from scipy.stats import chi2

from meshes.base.arrays import Array
from tissue.fitting.cutting import CuttingForward
from tissue.fitting.table import SteadyTable, TableTarget, table_forward
from tissue.scene.scene import Scene
from tissue.simulation.load_record import SENSITIVITIES

REJECTED = 0.05
"""Probability of a larger misfit (p value) below which a law is rejected."""
TORQUE = ("tangential_chip_Pa", "tangential_edge_N_m")
THRUST = ("radial_chip_Pa", "radial_edge_N_m")
"""Chip and edge coefficient that a maximum-likelihood fit finds for the thrust.

`TORQUE` holds the two coefficients of the torque.

The effects of the axial coefficients on the thrust are proportional to the effects of the radial
coefficients, and have the opposite sign. The fitted coefficients of the thrust are therefore
differences of radial and axial coefficients, and may have any sign. The coefficients of the torque
are 0 or above.
"""
TYPICAL = np.array([1e8, 1e3])
"""Units of chip and edge coefficients [Pa, N/m], chosen to give effects of similar size."""
EXPONENTS = np.linspace(0.0, 0.9, 19)
"""Exponents of the size effect at which the search for the best exponent begins."""
PRECISION = 1e-4
"""Precision of the fitted exponent of the size effect."""
NO_EFFECT = 1e-6
"""Relative singular value below which a combination of constants has no effect on the loads."""
LEAST_RESIDUAL = 1e-9
"""Smallest root mean square residual, relative to the mean load. It replaces 0 in an exact fit."""


@dataclass(frozen=True)
class LawMisfit:
    """Misfit of one cutting law to a table.

    Attributes
    ----------
    has_size_effect
        True for the law with a free exponent m and a minimum chip thickness. False for the law that
        is linear in the chip thickness and has the full edge force at any thickness.
    constants
        Number of constants in the maximum-likelihood fit. The scatter is not counted.
    size_exponent
        Exponent m of the maximum-likelihood fit; 0 for the linear law.
    chi_square
        Sum of squared errors of the maximum-likelihood fit relative to the scatter. None without a
        scatter.
    freedom
        Degrees of freedom of `chi_square`.
    p
        Probability of a larger `chi_square`. None if there is no scatter or no degree of freedom.
    aic
        Akaike's information criterion, up to an additive term that is equal for all laws of a
        table. None if the table gives no scatter and the law could fit one load exactly because
        there are few rows.
    left_out
        Root mean square of the relative errors of the predicted loads. The loads of each row are
        predicted by the law that is fitted to all other rows. None if the other rows do not
        determine the constants.
    cited_chi_square, cited_p
        Chi-square of the fit with the cited ranges as priors (see the module description), and the
        probability of a larger value. None without a scatter.
    """

    has_size_effect: bool
    constants: int
    size_exponent: float
    chi_square: float | None
    freedom: int
    p: float | None
    aic: float | None
    left_out: float | None
    cited_chi_square: float | None
    cited_p: float | None

    @property
    def name(self) -> str:
        """Name of the law in words."""
        return "law with a size effect" if self.has_size_effect else "linear law"


def compared_laws(scene: Scene, table: SteadyTable) -> tuple[LawMisfit, ...]:
    """Return the misfits of the linear law and of the law with a size effect.

    Parameters
    ----------
    scene
        A block of bone and a drill, see `tissue.fitting.table.table_forward`.
    table
        Measured loads.
    """
    found = []
    for has_size_effect in (False, True):
        minimum = scene.cutting.minimum_chip_um or None
        changes = {"size_exponent": None, "minimum_chip_um": minimum}
        if not has_size_effect:
            changes = {"size_exponent": 0.0, "minimum_chip_um": 0.0}
        cutting = scene.cutting.model_copy(update=changes)
        forward = table_forward(scene.model_copy(update={"cutting": cutting}), table)
        fit = MaximumLikelihood(forward, table, has_size_effect=has_size_effect)
        cited = _cited_chi_square(forward, table)
        found.append(
            LawMisfit(
                has_size_effect,
                fit.constants,
                fit.exponent,
                fit.chi_square,
                fit.freedom,
                fit.p,
                fit.aic,
                fit.left_out(),
                cited,
                _probability(cited, table.loads.size),
            )
        )
    return tuple(found)


def _probability(chi_square: float | None, freedom: int) -> float | None:
    """Return the probability of a sum of squares above ``chi_square``."""
    if chi_square is None or freedom < 1:
        return None
    return float(chi2.sf(chi_square, freedom))


def _cited_chi_square(forward: CuttingForward, table: SteadyTable) -> float | None:
    """Return the misfit with the cited ranges as priors; None for a table without a scatter."""
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


class MaximumLikelihood:
    """Maximum-likelihood fit of one law to a table.

    Parameters
    ----------
    forward
        Forward model of the loads of the table's rows. Each load is divided by its unit in
        `SteadyTable.units`.
    table
        Measured loads.
    has_size_effect
        True if the exponent is free.

    Attributes
    ----------
    constants, exponent, chi_square, freedom, p, aic
        As in `LawMisfit`.
    """

    def __init__(
        self, forward: CuttingForward, table: SteadyTable, *, has_size_effect: bool
    ) -> None:
        self._forward = forward
        self._places = [forward.channels.index(name) for name in table.channels]
        self._coefficients = [
            TORQUE if name.startswith("torque") else THRUST for name in table.channels
        ]
        self._values = table.loads / table.units
        self._has_scatter = table.scatter is not None
        self._exponents = EXPONENTS if has_size_effect else EXPONENTS[:1]
        self._designs: dict[float, Array] = {}
        misfit, self.exponent, found = self._fitted(np.arange(len(self._values)))
        designs = list(zip(self._design(0.0), found, strict=True))
        ranks = [_rank(columns) for columns, _ in designs]
        self.constants = sum(ranks) + has_size_effect
        # A constant at its lower limit of 0 does not reduce the misfit.
        free = sum(_rank(columns[:, each != 0.0]) for columns, each in designs)
        self.freedom = self._values.size - free - (self.exponent > 0.0)
        self.chi_square = misfit if self._has_scatter else None
        self.p = _probability(self.chi_square, self.freedom)
        self.aic: float | None = misfit + 2.0 * self.constants
        if not self._has_scatter:
            # The size of the errors is a further constant for each load.
            self.aic += 2.0 * len(ranks)
            if len(self._values) <= max(ranks) + has_size_effect:
                self.aic = None

    def left_out(self) -> float | None:
        """Return the root mean square relative error of loads predicted from the other rows."""
        rows = np.arange(len(self._values))
        if (len(rows) - 1) * len(self._places) < self.constants:
            return None
        errors = []
        for row in rows.tolist():
            _, exponent, found = self._fitted(rows[rows != row])
            predicted = np.sum(self._design(exponent)[:, row] * found, axis=1)
            errors.append(predicted / self._values[row] - 1.0)
        return float(np.sqrt(np.mean(np.square(errors))))

    def _fitted(self, rows: NDArray[np.intp]) -> tuple[float, float, Array]:
        """Return the smallest misfit to the given rows, with its exponent and coefficients."""

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
        """Return minus twice the log likelihood, up to a constant, and the coefficients.

        The coefficients are a chip and an edge coefficient for each load, shape (channels, 2).
        """
        squares = np.zeros(len(self._places))
        found = np.zeros((len(self._places), len(TYPICAL)))
        for at, columns in enumerate(self._design(exponent)[:, rows]):
            values = self._values[rows, at]
            if self._coefficients[at] is TORQUE:
                found[at] = nnls(columns, values)[0]
            else:
                found[at] = np.linalg.lstsq(columns, values, rcond=NO_EFFECT)[0]
            squares[at] = np.sum((values - columns @ found[at]) ** 2)
        if self._has_scatter:
            return float(squares.sum()), found
        variances = np.maximum(squares / len(rows), LEAST_RESIDUAL**2)
        return float(len(rows) * np.log(variances).sum()), found

    def _design(self, exponent: float) -> Array:
        """Return the derivatives of loads with respect to coefficients, shape (channels, n, 2).

        The loads are divided by their units. The coefficients are in units of `TYPICAL`.
        """
        if exponent not in self._designs:
            coefficients = replace(self._forward.coefficients[0], size_exponent=exponent)
            slopes = self._forward.record.jacobian((coefficients,))
            columns = [
                slopes[:, place, 0][:, [SENSITIVITIES.index(name) for name in names]] * TYPICAL
                for place, names in zip(self._places, self._coefficients, strict=True)
            ]
            self._designs[exponent] = np.stack(columns)
        return self._designs[exponent]


def _rank(columns: Array) -> int:
    """Return the number of independent columns."""
    if not columns.any():
        return 0
    return int(np.linalg.matrix_rank(columns / np.abs(columns).max(), rtol=NO_EFFECT))


def law_sentences(laws: Sequence[LawMisfit]) -> list[str]:
    """Return sentences on the laws that a table rejects."""
    ranking = "the rows are too few to rank the laws"
    scores = [(each.aic, each.name) for each in laws if each.aic is not None]
    if len(scores) == len(laws):
        (smallest, best), (other, second) = sorted(scores)
        ranking = f"by AIC the {best} comes before the {second} (AIC {other - smallest:+.1f})"
    if laws[0].cited_p is None:
        return [f"the table states no scatter, so it rejects no law; {ranking}"]
    found = []
    for each in laws:
        if each.p is None:
            found.append(
                f"{each.name}: not tested, it has as many constants as the table has loads"
            )
            continue
        verdict = "rejected with any coefficients" if each.p < REJECTED else "not rejected"
        found.append(
            f"{each.name}: {verdict}, chi-square {each.chi_square:.3g} with {each.freedom} degrees "
            f"of freedom, p = {each.p:.2g}"
        )
    wrong = [each.name for each in laws if each.cited_p is not None and each.cited_p < REJECTED]
    refused = "no law is" if not wrong else f"the {' and the '.join(wrong)} is"
    found.append(f"{refused} rejected with coefficients in their cited ranges")
    return [*found, ranking]
