"""Constants of a scene from a measured force log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fitting.cutting import cutting_problem, fixed_densities
from tissue.fitting.identifiability import Gain, Identified, expected_information, identified
from tissue.fitting.laws import LawMisfit, compared_laws, law_sentences
from tissue.fitting.log import MeasuredLog
from tissue.fitting.organ_problem import organ_problem
from tissue.fitting.organ_runs import KEYS
from tissue.fitting.posterior import Posterior, maximum_of, maximum_posterior
from tissue.fitting.table import SteadyTable, TableTarget, table_forward
from tissue.fitting.target import OFFSET_S
from tissue.materials.constants import Prior
from tissue.scene.anatomy import CutAnatomy
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene

__all__ = ["ConstantFit", "Fitted", "SceneFit", "TableFit", "fit_scene", "fit_table"]


FITTED = "fit a scene of bone, a tooth or an organ under a probe"
NUISANCES = ("density.", KEYS)
"""Prefixes of the names of numbers that belong to the specimen of a log or to its scene.

Such numbers are not constants of a material.
"""
FAR = 3.0
FAR_TIMES = 10.0
"""Ratio of a value to the end of its cited range, above which the value contradicts its prior.

This limit is needed in addition to `FAR`, because some priors have a heavy tail towards zero. `FAR`
is a limit in standard deviations of the prior. By chance, 0.3 % of the constants lie beyond it.
"""
UNIT_TIMES = 100.0
"""Ratio of a value to the end of its cited range that suggests a wrong unit.

Units such as N and kN differ by factors of 1000.
"""


@dataclass(frozen=True)
class ConstantFit:
    """Constant before and after a fit.

    Attributes
    ----------
    name
        ``TABLE.MATERIAL.NAME``; or ``density.LAYER`` for the factor by which the density of a layer
        is multiplied in this specimen.
    prior
        Cited median and range.
    low, value, high
        Quantiles at 5, 50 and 95 % after the fit, in the unit of the name.
    z
        The three quantiles `low`, `value` and `high`, and the two ends of the cited range, as
        standard normal numbers of the prior, shape (5,).
    contraction
        Standard deviation of the constant after the fit, divided by the standard deviation before
        the fit.
    state
        ``determined``, ``narrowed``, ``at its prior``, or ``doubtful``. A doubtful value lies far
        outside its cited range, or was found with a clock offset that contradicts its prior.
    """

    name: str
    prior: Prior
    low: float
    value: float
    high: float
    z: tuple[float, ...]
    contraction: float
    state: str

    @property
    def is_far(self) -> bool:
        """True if the value lies far outside the cited range."""
        is_outside = (
            self.value > FAR_TIMES * self.prior.high > 0.0
            or self.value < self.prior.low / FAR_TIMES
        )
        return abs(self.z[1]) > FAR or is_outside


def _far_sentence(each: ConstantFit) -> str:
    """Return a sentence on a constant far outside its cited range."""
    side = "below" if each.z[1] < 0.0 else "above"
    ratio = each.value / each.prior.high
    if side == "below":
        ratio = each.prior.low / max(each.value, 1e-300)
    times = f"{ratio:.3g} times " if np.isfinite(ratio) and ratio >= FAR_TIMES else ""
    cause = ""
    if times and ratio >= UNIT_TIMES:
        read = "kN" if side == "below" else "mN"
        cause = f", as with forces in {read} that are read in N"
    return (
        f"{each.name} = {each.value:.3g} is {times}{side} its range of {each.prior.low:g} to "
        f"{each.prior.high:g} ({abs(each.z[1]):.1f} standard deviations of the prior) and does not "
        f"count as determined{cause}. Check the units and signs of the log, the scene and the tool"
    )


class Fitted:
    """Result of a fit to any kind of measurement.

    Attributes
    ----------
    source
        Kind of the measurement, one word.
    meaning
        Explanation of the numbers in the file of constants that the fit writes.
    """

    source: ClassVar[str] = "log"
    meaning: ClassVar[str] = (
        "value: median; range: 5 and 95 % of the posterior; correlation: of the standard normal "
        "numbers of each."
    )
    constants: tuple[ConstantFit, ...]

    @property
    def of_material(self) -> tuple[int, ...]:
        """Indices of the constants that belong to a material, not to the specimen or the scene."""
        return tuple(
            at for at, each in enumerate(self.constants) if not each.name.startswith(NUISANCES)
        )

    @property
    def scene_keys(self) -> dict[str, float]:
        """Fitted values of scene keys, which are not constants of a material."""
        return {each.name: each.value for each in self.constants if each.name.startswith(KEYS)}


@dataclass(frozen=True, eq=False)
class SceneFit(Fitted):
    """Constants of a scene, fitted to a log.

    Attributes
    ----------
    name
        Name of the scene.
    path
        File of the measured log.
    posterior
        Posterior of the constants given the log.
    identified
        Constants and combinations that the log determines.
    gains
        Expected information gains of logs that could be measured next, the largest first.
    block_s
        Time over which samples were averaged [s].
    notes
        Findings and assumptions, in sentences.
    fixed
        Values of fixed constants on which the free constants depend, keyed by name.
    """

    name: str
    path: Path
    posterior: Posterior
    identified: Identified
    gains: tuple[Gain, ...]
    block_s: float
    notes: tuple[str, ...]
    fixed: Mapping[str, float]

    @cached_property
    def constants(self) -> tuple[ConstantFit, ...]:  # type: ignore[override]  # never set
        """All free constants, in the order of the forward model."""
        found = []
        for at, parameter in enumerate(self.posterior.target.forward.parameters):
            low, value, high = self.posterior.interval(at)
            cited = parameter.cited or parameter.prior
            state = "narrowed"
            if parameter.name in self.identified.determined:
                state = "determined"
            elif parameter.name in self.identified.at_prior:
                state = "at its prior"
            each = ConstantFit(
                parameter.name,
                cited,
                low,
                value,
                high,
                tuple(parameter.prior.z([low, value, high, cited.low, cited.high]).tolist()),
                float(self.identified.contraction[at]),
                state,
            )
            is_doubtful = each.is_far or (state == "determined" and abs(self.offset_sd) > FAR)
            found.append(replace(each, state="doubtful") if is_doubtful else each)
        return tuple(found)

    @property
    def offset_sd(self) -> float:
        """Offset between the clocks of forces and poses, in standard deviations of its prior."""
        return self.posterior.nuisances.offset_s / OFFSET_S

    @property
    def doubts(self) -> tuple[str, ...]:
        """Sentences about results that contradict the priors."""
        found = []
        if abs(self.offset_sd) > FAR:
            found.append(
                f"the forces come {1e3 * self.posterior.nuisances.offset_s:.3g} ms after the "
                f"poses, {abs(self.offset_sd):.1f} standard deviations of the "
                f"{1e3 * OFFSET_S:g} ms that are expected. No constant counts as determined. "
                "Check the times of poses and forces, and the place where the tool touches"
            )
        found += [_far_sentence(each) for each in self.constants if each.is_far]
        return tuple(found)

    @property
    def correlation(self) -> Array:
        """Correlation matrix of the fitted constants that belong to a material."""
        places = np.array(self.of_material, dtype=np.int64)
        covariance = self.posterior.covariance_z[np.ix_(places, places)]
        spread = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(spread, spread))

    @property
    def size(self) -> dict[str, float]:
        """Entry of the results file: the time over which samples were averaged [s]."""
        return {"block_s": self.block_s}

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences that summarise the fit for the user."""
        each = self.posterior.nuisances
        low, high = self.posterior.offset_interval_s
        biases = []
        for name, value in zip(self.posterior.target.log.channels, each.bias.tolist(), strict=True):
            _, axis, unit = name.split("_")
            biases.append(f"{value:.3g} {unit.replace('Nm', 'N m')} along {axis}")
        found = [
            f"forces come {1e3 * each.offset_s:.1f} ms ({1e3 * low:.1f} to {1e3 * high:.1f}) "
            "after the poses",
            f"bias of the sensor: {', '.join(biases)}",
            *self.notes,
        ]
        return (*found, *self._warnings)

    @property
    def _warnings(self) -> tuple[str, ...]:
        if self.posterior.converged:
            return ()
        return ("the search did not reach a maximum: do not rely on the intervals",)


@dataclass(frozen=True, eq=False)
class TableFit(SceneFit):
    """Constants of a scene, fitted to a table of steady loads.

    Attributes
    ----------
    table
        The table.
    laws
        Misfits of the cutting laws.
    """

    table: SteadyTable
    laws: tuple[LawMisfit, ...]

    source: ClassVar[str] = "table"

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences that summarise the fit for the user, as for `SceneFit`."""
        return (*law_sentences(self.laws), *self.notes, *self._warnings)


def fit_table(
    scene: Scene,
    table: SteadyTable,
    *,
    free: Sequence[str] = (),
    progress: Progress = silent,
) -> TableFit:
    """Fit the constants of a scene's bone to a table of steady loads, and compare cutting laws.

    The fit finds the maximum of the posterior with the cited ranges as priors. The errors of the
    rows are assumed independent and normal. The parameters and the errors that are raised are
    described in `tissue.fitting.table.table_forward`.
    """
    progress("computing the loads of the drill", 0.0)
    forward = table_forward(scene, table, free)
    progress("fitting", 0.1)
    posterior = maximum_of(TableTarget(forward, table))
    found = identified(posterior)
    progress("comparing laws", 0.7)
    return TableFit(
        scene.name,
        table.path,
        posterior,
        found,
        (),
        0.0,
        forward.notes,
        fixed_densities(scene, forward),
        table,
        compared_laws(scene, table),
    )


def fit_scene(
    scene: Scene,
    log: MeasuredLog,
    *,
    free: Sequence[str] = (),
    cores: int | None = None,
    progress: Progress = silent,
) -> SceneFit:
    """Fit the constants of a scene's material to a log of forces and poses.

    The fit finds the maximum of the posterior with the cited ranges as priors. The noise is
    autocorrelated and has heavy tails. The offset of the clocks, the sensor's bias and the
    specimen's density are estimated together with the constants.

    Parameters
    ----------
    scene
        Scene with the specimen and the tool. The poses of the log replace the motion and the
        device of the scene.
    log
        Measured log in the scene's frame.
    free
        Free constants, see `tissue.fitting.cutting.cutting_forward`. An empty sequence selects the
        default constants.
    cores
        Processor cores to use; default all.
    progress
        Called with a description of the current step.

    Raises
    ------
    InputError
        If this kind of scene cannot be fitted, the tool never cuts along the log, or the log
        determines no constant.
    """
    if not isinstance(scene.anatomy, CutAnatomy | SoftAnatomy):
        raise InputError(
            "scene",
            "have constants that can be fitted",
            f"anatomy.kind = {scene.anatomy.kind}",
            FITTED,
        )
    of_tissue = cutting_problem if isinstance(scene.anatomy, CutAnatomy) else organ_problem
    problem = of_tissue(scene, log, free, cores=cores, progress=progress)
    # recording the geometry, or the runs of an organ, takes most of the time
    progress("fitting", 0.8)
    posterior = maximum_posterior(problem.forward, problem.measured)
    of_this_mesh = posterior
    if problem.finer is not None:
        progress("fitting on a finer mesh", 0.85)
        whole, *parts = (maximum_posterior(each, problem.measured) for each in problem.finer)
        posterior = posterior.with_mesh(whole, parts, problem.mesh_factor)
    found = identified(posterior)
    notes = (*log.notes, *problem.notes)
    fit = SceneFit(
        scene.name, log.path, posterior, found, (), problem.block_s, notes, problem.fixed
    )
    if found.is_empty:
        rough = identified(of_this_mesh)
        # with loads in a wrong unit, constants are so far from their ranges that no mesh is fine
        # enough
        if doubts := replace(fit, posterior=of_this_mesh, identified=rough).doubts:
            raise InputError(f"measured: {'. '.join(doubts)}.")
        raise _determines_nothing(posterior, log, is_mesh=not rough.is_empty)
    # between the start of the search, at 0.8, and the end
    progress("what to measure next", 0.9)
    gains = expected_information(posterior, problem.candidates(), among=fit.of_material)
    return replace(fit, gains=tuple(gains))


def _determines_nothing(posterior: Posterior, log: MeasuredLog, *, is_mesh: bool) -> InputError:
    """Return the error for a log that determines no constant.

    If `is_mesh` is true, the message names the error of the finite-element mesh as the reason.
    """
    if is_mesh:
        return InputError(
            "anatomy.touch_edge_mm",
            "be fine enough to determine a constant",
            "a mesh with an error so large that the log determines no constant of the scene",
            "use a shorter edge",
        )
    forces = [at for at, name in enumerate(log.channels) if name.startswith("force_")]
    largest = float(np.abs(posterior.simulated - posterior.nuisances.bias)[:, forces].max())
    return InputError(
        "measured",
        "determine a constant",
        (
            f"a log with a force of {largest:.2g} N at most and noise of "
            f"{posterior.nuisances.scale[forces].max():.2g} N, which determines no constant "
            "of the scene"
        ),
        (
            "give the log of a deeper or faster cut, and check that the scene describes "
            "the material that was cut"
        ),
    )
