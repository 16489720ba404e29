"""Fit of an elastic law to presses of a probe, for tables without times.

The median force of the presses at each depth is fitted by least squares. The free constants are
Young's modulus, the shape constants of the law and the bias of the force sensor, which is the same
at all depths. The presses differ by far more than the noise of the sensor, so the intervals follow
from the scatter of the presses. For this purpose, the presses are resampled with replacement and
fitted again (bootstrap, Efron 1979, Ann. Stat. 7:1). The error of the mesh is added to the
intervals. This error is the shift of the constants in a fit on a mesh with two thirds of the edge
lengths.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from scipy.stats import norm, t

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fem.axisymmetric import FIRST
from tissue.fitting.log_files import LogColumns
from tissue.fitting.organ_runs import organ_parameters
from tissue.fitting.pictures import draw_rows
from tissue.fitting.probe_laws import (
    SHAPES,
    ProbeCurves,
    layer_scene,
    probe_curves,
    require_shallow,
    shape_keys,
)
from tissue.fitting.probe_table import ProbeTable, at_common_depths, read_presses
from tissue.fitting.problem import Parameter, chosen
from tissue.fitting.result import ConstantFit, Fitted
from tissue.scene.scene import Scene

RESAMPLES = 1000
"""Number of resampled sets of presses.

The ends of a 90 % interval then have a standard error of 2 % of its width.
"""
FINER = 1.5
"""Ratio of the edge lengths of the two meshes that are compared to find the mesh error.

The force converges with second order, so the difference is more than half of the error of the
coarser mesh.
"""
DETERMINED_RATIO = 2.0
"""Largest ratio of the ends of an interval for which a constant counts as determined."""
SEED = 42
POOR = 0.03
"""Misfit of a fitted curve above which a fit is reported as poor (judgement).

The fit must also exceed `SYSTEMATIC`. The interpolation of the forces has an error of 0.3 %, a
tenth of this value.
"""
SYSTEMATIC = 3.0
"""Ratio of a mean residual to its standard error above which a fit is reported as poor (judgement).

The mean is over presses. The fit must also exceed `POOR`. The ratio is about 1 if the residuals of
different presses are independent.
"""


@dataclass(frozen=True, eq=False)
class FittedCurve:
    """Best-fitting constants of n curves, one row for each curve.

    Attributes
    ----------
    modulus_Pa
        Young's modulus, shape (n,).
    shape
        Values of the k shape constants of the law, shape (n, k).
    bias_N
        Bias of the force sensor [N], shape (n,).
    force_N
        Forces of the fitted curves at d depths, including the bias [N], shape (n, d).
    """

    modulus_Pa: Array
    shape: Array
    bias_N: Array
    force_N: Array


def median_curve(forces_N: Array, draws: Ints | None = None) -> Array:
    """Return the median of the presses at each depth, shape (d,).

    With `draws`, return one median curve for each row of press indices in `draws`.
    """
    chosen = forces_N if draws is None else forces_N[draws]
    return np.median(chosen, axis=-2)


def fit_curves(curves: ProbeCurves, forces_N: Array) -> FittedCurve:
    """Fit force curves by least squares.

    The shape constants are chosen from all sets of values for which forces were computed.

    Parameters
    ----------
    curves
        Force per modulus for each set of shape constants.
    forces_N
        Curves to fit, shape (n, d).
    """
    unit = curves.unit_N_Pa
    centred = unit - unit.mean(axis=1, keepdims=True)
    wanted = forces_N - forces_N.mean(axis=1, keepdims=True)
    power = np.sum(centred**2, axis=1)
    # Tissue does not pull the ball: the modulus is not below zero.
    modulus = np.maximum(centred @ wanted.T, 0.0) / power[:, None]
    misfit = np.sum(wanted**2, axis=1) - modulus**2 * power[:, None]
    best = np.argmin(misfit, axis=0)
    found = modulus[best, np.arange(len(forces_N))]
    bias = forces_N.mean(axis=1) - found * unit[best].mean(axis=1)
    return FittedCurve(
        found, curves.shapes[best], bias, found[:, None] * unit[best] + bias[:, None]
    )


@dataclass(frozen=True, eq=False)
class ProbeFit(Fitted):
    """Elastic constants fitted to the force curves of a pressed probe.

    Attributes
    ----------
    name
        Name of the scene.
    path
        File of the table.
    table
        Table of the presses.
    law
        Name of the elastic law of the organ.
    constants
        Modulus and shape constants, with 90 % intervals.
    force_N
        Fitted force at the depths of the table, including the bias [N], shape (d,).
    bias_N
        Bias of the force sensor [N].
    misfit
        L2 norm of the difference between the fitted and the median curve, divided by the L2 norm of
        the median curve.
    notes
        Findings and assumptions of the fit, one sentence each.
    """

    name: str
    path: Path
    table: ProbeTable
    law: str
    constants: tuple[ConstantFit, ...]
    force_N: Array
    bias_N: float
    misfit: float
    notes: tuple[str, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    source: ClassVar[str] = "table of presses"
    meaning: ClassVar[str] = (
        "value: best fit; range: 5 and 95 % of resampled presses and error of the mesh."
    )

    findings: ClassVar[tuple[str, ...]] = ("determined", "narrowed")

    @property
    def size(self) -> dict[str, float]:
        """Number of measured presses."""
        return {"presses": len(self.table.forces_N)}

    @property
    def numbers(self) -> dict[str, Any]:
        """See `Fitted`."""
        return {"law": self.law, "misfit": self.misfit, "bias_N": self.bias_N}

    @property
    def columns(self) -> dict[str, Array]:
        """See `Fitted`."""
        low, middle, high = np.quantile(self.table.forces_N, [0.05, 0.5, 0.95], axis=0)
        measured = {"median_N": middle, "p05_N": low, "p95_N": high}
        return {"depth_mm": 1e3 * self.table.depths_m} | measured | {"fitted_N": self.force_N}

    def draw(self, path: Path) -> None:
        """See `Fitted`. The error bars show the 5 % to 95 % range of the measured presses."""
        depths_mm, middle, low, high, fitted = self.columns.values()
        bars = np.stack([middle - low, high - middle])
        draw_rows("depth / mm", depths_mm, {"force / N": (middle, bars, fitted)}, path)

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences on constants that the presses do not limit, and on a poor fit, see `Fitted`."""
        found = self._misfits()
        for each in self.constants:
            key = each.name.rpartition(".")[2]
            if key not in SHAPES:
                continue
            low, high = SHAPES[key]
            if each.low <= 1.05 * low or each.high >= 0.95 * high:
                end = "small" if each.low <= 1.05 * low else "large"
                found.append(
                    f"{each.name}: {end} values fit as well, the interval ends where the search "
                    "ends. Press deeper, or use a law with fewer constants"
                )
        return tuple(found)

    def _misfits(self) -> list[str]:
        """Return warnings about an implausible sensor bias, and about systematic residuals."""
        middle = median_curve(self.table.forces_N)
        smallest = float(np.abs(middle[self.table.depths_m > 0.0]).min())
        found = []
        if abs(self.bias_N) > smallest:
            found.append(
                f"the fitted zero of the force sensor, {1e3 * self.bias_N:.3g} mN, is larger than "
                f"the smallest measured force, {1e3 * smallest:.3g} mN: the law {self.law} does "
                "not follow the first depths. Check the zeros of force and depth, or try another "
                "organ.law"
            )
        pattern = common_pattern(self.table.forces_N, self.force_N)
        if self.misfit > POOR and pattern > SYSTEMATIC:
            found.append(
                f"all presses show the same deviation from the law {self.law}, and the fitted "
                f"curve differs from their median by {self.misfit:.1%}. Try another organ.law, or "
                "leave out the largest depths"
            )
        return found

    @property
    def sentences(self) -> tuple[str, ...]:
        """See `Fitted`."""
        return (
            f"the fitted curve differs from the median of {len(self.table.forces_N)} presses by "
            f"{self.misfit:.1%}",
            f"zero of the force sensor: {1e3 * self.bias_N:.3g} mN",
            *self.notes,
        )


def common_pattern(forces_N: Array, fitted_N: Array) -> float:
    """Return the L2 norm of the mean residual, divided by the L2 norm of its standard error.

    Mean and standard error are taken over the presses.

    The fitted curve is scaled and shifted to match each press before the residual is computed.
    Residuals are divided by the force range of their press. The norms are taken over the depths.

    Parameters
    ----------
    forces_N
        Forces of each press [N], shape (n, d).
    fitted_N
        Fitted curve, shape (d,).
    """
    curve = fitted_N - fitted_N.mean()
    power = float(np.sum(curve**2))
    if power == 0.0:
        return 0.0
    centred = forces_N - forces_N.mean(axis=1, keepdims=True)
    scale = centred @ curve / power
    residuals = centred - scale[:, None] * curve
    # 1e-300 avoids a division by zero for presses of constant force, and for equal residuals.
    residuals = residuals / np.maximum(np.ptp(forces_N, axis=1), 1e-300)[:, None]
    error = np.std(residuals, axis=0, ddof=1) / np.sqrt(len(forces_N))
    size = float(np.linalg.norm(residuals.mean(axis=0)))
    return size / max(float(np.linalg.norm(error)), 1e-300)


def presses_for(
    scene: Scene, path: Path, found: LogColumns, columns: Sequence[str] = ()
) -> ProbeTable:
    """Read a table of presses, and check that the scene's constants can be fitted to it.

    No force is computed. The parameters are those of `tissue.fitting.probe_table.read_presses`.

    Raises
    ------
    InputError
        If the columns cannot be read, or the table cannot be fitted with the scene. The error lists
        all reasons.
    """
    presses, notes = read_presses(path, found, columns)
    refused: list[InputError] = []
    deepest_m = max((float(depth[-1]) for depth, _ in presses if len(depth)), default=0.0)
    try:
        table = at_common_depths(path, presses, notes)
        deepest_m = float(table.depths_m.max())
    except InputError as error:
        refused.append(error)
    try:
        require_shallow(layer_scene(scene), deepest_m)
    except InputError as error:
        refused.append(error)
    if len(refused) > 1:
        raise InputError(". ".join(map(str, refused)))
    if refused:
        raise refused[0]
    return table


def fit_probes(
    scene: Scene,
    table: ProbeTable,
    *,
    free: Sequence[str] = (),
    progress: Progress = silent,
) -> ProbeFit:
    """Fit Young's modulus and the shape constants of an elastic law to presses on a slab.

    Parameters
    ----------
    scene
        Scene with a slab of one material on a bed, and a ball as tool. Motion, friction and device
        of the scene are ignored.
    table
        Table of the presses.
    free
        Names of the constants to find; the modulus is always free. By default, all shape constants
        above zero are free too.
    progress
        Called with a description of the current step.

    Raises
    ------
    InputError
        If the scene has no such slab or ball, or `free` names a constant that cannot be fitted.
    """
    layer = layer_scene(scene)
    modulus, *shapes = _parameters(scene, shape_keys(layer.organ))
    free_shapes = [each for each in chosen(free, [modulus, *shapes]) if each is not modulus]
    keys = tuple(each.name.rpartition(".")[2] for each in free_shapes)
    curves = probe_curves(
        layer, table.depths_m, keys, progress=lambda doing, share: progress(doing, 0.8 * share)
    )
    progress("drawing presses again", 0.8)
    forces = table.forces_N
    best = fit_curves(curves, median_curve(forces)[None])
    random = np.random.default_rng(SEED)
    draws = random.integers(0, len(forces), (RESAMPLES, len(forces)))
    drawn = fit_curves(curves, median_curve(forces, draws))
    progress("estimating the error of the mesh", 0.9)
    changes = dict(zip(keys, best.shape[0].tolist(), strict=True))
    fixed = replace(layer, organ=layer.organ.model_copy(update=changes))
    finer = probe_curves(fixed, table.depths_m, (), first=FIRST / FINER)
    shifted = fit_curves(curves, best.modulus_Pa[:, None] * finer.unit_N_Pa)
    values = [(1e-3 * best.modulus_Pa[0], 1e-3 * drawn.modulus_Pa, 1e-3 * shifted.modulus_Pa[0])]
    values += zip(best.shape[0], drawn.shape.T, shifted.shape[0], strict=True)
    constants = [
        _constant(parameter, each, len(forces))
        for parameter, each in zip([modulus, *free_shapes], values, strict=True)
    ]
    notes = (
        *table.notes,
        f"law {layer.organ.law}",
        f"a ball of {2e3 * layer.radius_m:g} mm without friction on a layer of "
        f"{1e3 * layer.thickness_m:g} mm, bonded to its bed",
        f"intervals from {RESAMPLES} draws of {len(forces)} presses and from the error of the mesh",
    )
    middle = median_curve(forces)
    return ProbeFit(
        scene.name,
        table.path,
        table,
        layer.organ.law,
        tuple(constants),
        best.force_N[0],
        float(best.bias_N[0]),
        float(np.linalg.norm(best.force_N[0] - middle) / np.linalg.norm(middle)),
        notes,
    )


def _parameters(scene: Scene, keys: tuple[str, ...]) -> list[Parameter]:
    """Return the modulus and the shape constants of the organ's law."""
    parameters, _ = organ_parameters(scene, ())
    ends = ("modulus_kPa", "young_kPa")
    modulus = next(each for each in parameters if each.name.endswith(ends))
    # A rate that the scene does not state is a constant of the material.
    by_key = {each.name.rpartition(".")[2]: each for each in parameters}
    return [modulus, *(by_key[key] for key in keys)]


def _constant(parameter: Parameter, values: tuple[float, Array, float], count: int) -> ConstantFit:
    """Return a constant with its interval.

    The values are the best fit, the fits to resampled presses, and the fit to another mesh.

    If there are only a few presses, the results of resampled sets scatter too little. The
    logarithms of these results are therefore stretched by the ratio of Student's quantile to the
    normal quantile, and by sqrt(n / (n - 1)) for n presses.
    """
    prior = parameter.prior
    best, drawn, shifted = (np.log(np.maximum(each, 1e-12)) for each in values)
    stretch = t.ppf(0.95, count - 1) / norm.ppf(0.95) * np.sqrt(count / (count - 1.0))
    low, middle, high = np.quantile(drawn, [0.05, 0.5, 0.95])
    mesh = norm.ppf(0.95) * abs(shifted - best)
    below = np.hypot(stretch * max(best - low, middle - low), mesh)
    above = np.hypot(stretch * max(high - best, high - middle), mesh)
    lowest, value, highest = np.exp([best - below, best, best + above]).tolist()
    ends = np.asarray(prior.z([lowest, value, highest, prior.low, prior.high])).tolist()
    spread = (ends[2] - ends[0]) / (2.0 * norm.ppf(0.95))
    state = "determined" if highest < DETERMINED_RATIO * lowest else "narrowed"
    return ConstantFit(
        parameter.name,
        prior,
        lowest,
        value,
        highest,
        tuple(ends),
        spread,
        state,
    )
