"""Fit of a scene's constants to a measured force log, or to a table of steady loads."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fitting.cutting import cutting_problem, fixed_densities
from tissue.fitting.identifiability import Gain, Identified, expected_information, identified
from tissue.fitting.laws import LawMisfit, compared_laws, law_sentences
from tissue.fitting.log import MeasuredLog
from tissue.fitting.organ_problem import organ_problem
from tissue.fitting.pictures import draw_log, draw_rows
from tissue.fitting.posterior import Posterior, maximum_of, maximum_posterior
from tissue.fitting.result import FAR_SD, ConstantFit, Fitted, words_of
from tissue.fitting.table import SteadyTable, TableTarget, table_forward
from tissue.fitting.target import OFFSET_S
from tissue.scene.anatomy import CutAnatomy
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene

FITTED = "use a scene in which a tool cuts bone or a tooth, or a probe presses an organ"
SHOWN = 5
"""Largest number of entries in each of two lists of a report.

The lists contain combinations of constants, and logs that could be measured next.
"""
NATS = 0.1
"""Information gain below which another log is not recommended [nats].

For a single constant, a gain of 0.1 nats narrows the interval by 10 %.
"""


@dataclass(frozen=True, eq=False)
class SceneFit(Fitted):
    """Constants of a scene, fitted to a log.

    Attributes
    ----------
    posterior
        Posterior of the constants given the log.
    identified
        Constants, and combinations of constants, that the log determines.
    gains
        Expected information gains of logs that could be measured next, the largest first.
    block_s
        Averaging time of the samples [s].
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
            is_doubtful = each.is_far or (state == "determined" and abs(self.offset_sd) > FAR_SD)
            found.append(replace(each, state="doubtful") if is_doubtful else each)
        return tuple(found)

    @property
    def offset_sd(self) -> float:
        """Offset between force clock and pose clock, in standard deviations of its prior."""
        return self.posterior.nuisances.offset_s / OFFSET_S

    @property
    def doubts(self) -> tuple[str, ...]:
        """See `Fitted`."""
        found = []
        if abs(self.offset_sd) > FAR_SD:
            found.append(
                f"the forces come {1e3 * self.posterior.nuisances.offset_s:.3g} ms after the "
                f"poses, {abs(self.offset_sd):.1f} standard deviations of the "
                f"{1e3 * OFFSET_S:g} ms that are expected. No constant counts as determined. "
                "Check the times of poses and forces, and the place where the tool touches"
            )
        return (*found, *(each.doubt for each in self.constants if each.is_far))

    @property
    def verdicts(self) -> list[str]:
        """Sentences of `Fitted.verdicts`, and others on combinations, priors and the next log."""
        found = super().verdicts
        for combined in self.identified.combinations[:SHOWN]:
            # A constant whose prior has the median 0 has no weight over that median.
            weights = {name: weight for name, weight in combined.weights.items() if weight != 0.0}
            terms = [f"{weight:.2g} {words_of(name)[0]}" for name, weight in weights.items()]
            found.append(
                "determined only as a combination of constants, each divided by the median of its "
                "prior: "
                f"{' + '.join(terms).replace('+ -', '- ')} = {combined.value:.4g} "
                f"({combined.low:.4g} to {combined.high:.4g})"
            )
        if at_prior := [words_of(name)[0] for name in self.identified.at_prior]:
            found.append(
                f"not narrowed by this {self.source}, left at the cited range: "
                f"{', '.join(at_prior)}"
            )
        if self.gains and self.gains[0].nats > NATS:
            best = self.gains[0]
            found.append(
                f"to measure next: {best.label}. This adds {best.nats:.2g} nats and reduces the "
                f"interval of {words_of(best.widest)[0]} to {best.shrinks_to:.0%} of its present "
                "width"
            )
        return found

    @property
    def correlation(self) -> Array:
        """See `Fitted`."""
        places = np.array(self.of_material, dtype=np.int64)
        covariance = self.posterior.covariance_z[np.ix_(places, places)]
        spread = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(spread, spread))

    @property
    def size(self) -> dict[str, float]:
        """Dictionary with the averaging time of the samples [s] under the key ``block_s``."""
        return {"block_s": self.block_s}

    @property
    def sentences(self) -> tuple[str, ...]:
        """See `Fitted`."""
        each = self.posterior.nuisances
        low, high = self.posterior.offset_interval_s
        biases = []
        for name, value in zip(self.posterior.target.log.channels, each.bias.tolist(), strict=True):
            _, axis, unit = name.split("_")
            biases.append(f"{value:.3g} {unit.replace('Nm', 'N m')} along {axis}")
        return (
            f"forces come {1e3 * each.offset_s:.1f} ms ({1e3 * low:.1f} to {1e3 * high:.1f}) "
            "after the poses",
            f"bias of the sensor: {', '.join(biases)}",
            *self.notes,
            *self._warnings,
        )

    @property
    def _warnings(self) -> tuple[str, ...]:
        if self.posterior.converged:
            return ()
        return ("the search did not reach a maximum: do not rely on the intervals",)

    @property
    def _findings(self) -> dict[str, Any]:
        return {
            "converged": self.posterior.converged,
            "combinations": [
                {
                    "weights": each.weights,
                    "p05": each.low,
                    "p50": each.value,
                    "p95": each.high,
                    "contraction": each.contraction,
                }
                for each in self.identified.combinations
            ],
            "next": [asdict(each) for each in self.gains],
        }

    @property
    def numbers(self) -> dict[str, Any]:
        """See `Fitted`."""
        each = self.posterior.nuisances
        low, high = self.posterior.offset_interval_s
        return self._findings | {
            "offset_s": [low, each.offset_s, high],
            "channels": list(self.posterior.target.log.channels),
            "bias": each.bias.tolist(),
            "noise_scale": each.scale.tolist(),
            "noise_correlation": each.correlation.tolist(),
            "noise_freedom": each.freedom.tolist(),
        }

    @property
    def columns(self) -> dict[str, Array]:
        """See `Fitted`."""
        log = self.posterior.target.log
        simulated = self.posterior.simulated
        found = {"time_s": log.times_s}
        for at, name in enumerate(log.channels):
            found[f"measured_{name}"] = log.values[:, at]
            found[f"simulated_{name}"] = simulated[:, at]
        return found

    def draw(self, path: Path) -> None:
        """See `Fitted`."""
        draw_log(self.posterior.target.log, self.posterior.simulated, path)

    @property
    def tables(self) -> dict[str, list[dict[str, str]]]:
        """Table of possible next logs (see `Fitted`)."""
        rows = [
            {
                "log of a second": each.label,
                "expected information / nats": f"{each.nats:.2g}",
                f"interval of {words_of(each.widest)[0]}, of that now": f"{each.shrinks_to:.0%}",
            }
            for each in self.gains[:SHOWN]
        ]
        return {"What to measure next": rows} if rows else {}


@dataclass(frozen=True, eq=False)
class TableFit(SceneFit):
    """Constants of a scene, fitted to a table of steady loads.

    Attributes
    ----------
    table
        Table of steady loads.
    """

    table: SteadyTable
    laws: tuple[LawMisfit, ...]

    source: ClassVar[str] = "table"

    @property
    def sentences(self) -> tuple[str, ...]:
        """See `Fitted`."""
        return (*law_sentences(self.laws), *self.notes, *self._warnings)

    @property
    def numbers(self) -> dict[str, Any]:
        """See `Fitted`."""
        return self._findings | {"laws": [asdict(each) for each in self.laws]}

    @property
    def columns(self) -> dict[str, Array]:
        """See `Fitted`."""
        simulated = self.posterior.simulated * self.table.units
        found = {"feed_mm_per_turn": 1e3 * self.table.feeds_per_turn_m}
        for at, channel in enumerate(self.table.channels):
            load = "torque_Nm" if channel.endswith("Nm") else "thrust_N"
            found[f"measured_{load}"] = self.table.loads[:, at]
            found[f"simulated_{load}"] = simulated[:, at]
        return found

    def draw(self, path: Path) -> None:
        """See `Fitted`."""
        scatter = self.table.scatter
        loads = {}
        for at, name in enumerate(self.table.channels):
            what = "torque / N m" if name.endswith("Nm") else "thrust / N"
            bars = None if scatter is None else scatter[:, at]
            simulated = self.posterior.simulated[:, at] * self.table.units[:, at]
            loads[what] = (self.table.loads[:, at], bars, simulated)
        draw_rows("feed per turn / mm", 1e3 * self.table.feeds_per_turn_m, loads, path)

    @property
    def tables(self) -> dict[str, list[dict[str, str]]]:
        """Table that compares the cutting laws, see `Fitted`."""

        def shown(value: float | None, form: str) -> str:
            return "" if value is None else format(value, form)

        rows = [
            {
                "law": each.name,
                "constants": str(each.constants),
                "chi-square (degrees of freedom)": (
                    f"{shown(each.chi_square, '.3g')} ({each.freedom})"
                ),
                "p": shown(each.p, ".2g"),
                "AIC": shown(each.aic, ".1f"),
                "rows predicted from the others, off by": shown(each.left_out, ".1%"),
                "chi-square with cited ranges as priors": shown(each.cited_chi_square, ".3g"),
                "p with cited ranges": shown(each.cited_p, ".2g"),
            }
            for each in self.laws
        ]
        return {"Which law the table rejects": rows}


def fit_table(
    scene: Scene,
    table: SteadyTable,
    *,
    free: Sequence[str] = (),
    progress: Progress = silent,
) -> TableFit:
    """Fit the constants of a scene's bone to a table of steady loads, and compare cutting laws.

    The fit maximises the posterior. The priors are the cited ranges of the constants. The errors of
    the rows are assumed independent and normal. See `tissue.fitting.table.table_forward` for the
    parameters and the errors.
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

    The fit maximises the posterior. The priors are the cited ranges of the constants. The noise is
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
        If this kind of scene cannot be fitted, the tool cuts nothing on the path of the log, or the
        log determines no constant.
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
            "be small enough to determine a constant",
            "a mesh whose error is so large that the log determines no constant of the scene",
            "use a smaller value",
        )
    forces = [at for at, name in enumerate(log.channels) if name.startswith("force_")]
    largest = float(np.abs(posterior.simulated - posterior.nuisances.bias)[:, forces].max())
    return InputError(
        "measured",
        "determine at least one constant of the scene",
        (
            f"a log with forces up to {largest:.2g} N and noise of "
            f"{posterior.nuisances.scale[forces].max():.2g} N"
        ),
        (
            "give the log of a deeper or faster cut, and check that the scene describes "
            "the material that was cut"
        ),
    )
