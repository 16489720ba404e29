"""Constants of a scene from a measured force log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fitting import needle_walls, organ_constants
from tissue.fitting.cutting_problem import cutting_problem
from tissue.fitting.device_problem import device_problem
from tissue.fitting.drawn_information import drawn_information
from tissue.fitting.experiments import Gain, expected_information
from tissue.fitting.identifiability import Identified, identified
from tissue.fitting.log import MeasuredLog
from tissue.fitting.needle_problem import needle_problem
from tissue.fitting.nuts import Draws, draw_by_nuts, require_nuts
from tissue.fitting.organ_problem import organ_problem
from tissue.fitting.posterior import Posterior, maximum_posterior
from tissue.fitting.problem import Problem
from tissue.fitting.target import OFFSET_S
from tissue.materials.prior import Prior
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene

__all__ = ["ConstantFit", "SceneFit", "fit_device", "fit_scene"]

PROBLEMS = {
    "tissue.builders.cutting:milled": cutting_problem,
    "tissue.builders.organ_scene:pierced": needle_problem,
    "tissue.builders.organ_scene:pressed": organ_problem,
}
"""What a log of a scene is compared with, by what builds its tissue."""
FITTED = "fit a scene of bone, a tooth, an organ or a needle"
NUISANCES = ("density.", "motors.", organ_constants.KEYS, needle_walls.KEYS)
"""Beginnings of the names of what belongs to the specimen of a log, or is a key of its scene, and to no material."""
VISIBLE = 20.0
"""Force over the noise's scale from which noise is not why a log determines nothing."""
SEED = 0
"""Of the draws: a log has the same fit each time."""


@dataclass(frozen=True)
class ConstantFit:
    """A constant before and after a fit.

    Attributes
    ----------
    name
        ``TABLE.MATERIAL.NAME``, or ``density.LAYER``, the factor on the density of a layer of this specimen.
    prior
        Before.
    low, value, high
        5, 50 and 95 % after, in the unit of the name.
    contraction
        Standard deviation after over that before.
    state
        ``determined``, ``narrowed``, or ``at its prior``.
    laplace
        5, 50 and 95 % of Laplace's approximation, where the three above are those of draws; else None.
    """

    name: str
    prior: Prior
    low: float
    value: float
    high: float
    contraction: float
    state: str
    laplace: tuple[float, float, float] | None


@dataclass(frozen=True, eq=False)
class SceneFit:
    """A scene's constants, fitted to a log.

    Attributes
    ----------
    name
        Of the scene or the device.
    path
        File of what was measured.
    posterior
        Constants given the log.
    identified
        What it determines.
    gains
        What other logs would add, the best first.
    block_s
        Time over which samples were averaged [s].
    notes
        What was found or assumed, in sentences.
    draws
        Draws of the posterior, shape (chains, draws, size), where it was sampled.
    fixed
        Constants on which the free ones rest, by their names.
    """

    name: str
    path: Path
    posterior: Posterior
    identified: Identified
    gains: tuple[Gain, ...]
    block_s: float
    notes: tuple[str, ...]
    draws: Draws | None
    fixed: Mapping[str, float]

    @property
    def constants(self) -> tuple[ConstantFit, ...]:
        """All free constants, in the order of the forward model."""
        found = []
        for at, (name, prior) in enumerate(zip(self.posterior.names, self.posterior.priors, strict=True)):
            laplace = self.posterior.interval(at)
            drawn = None if self.draws is None else prior.x(self.draws.quantiles(at)).tolist()
            low, value, high = drawn or laplace
            state = (
                "determined"
                if name in self.identified.determined
                else "at its prior"
                if name in self.identified.at_prior
                else "narrowed"
            )
            share = float(self.identified.contraction[at])
            found.append(ConstantFit(name, prior, low, value, high, share, state, laplace if drawn else None))
        return tuple(found)

    @property
    def of_material(self) -> tuple[int, ...]:
        """Places of the constants that belong to a material, not to the log's specimen."""
        return tuple(at for at, name in enumerate(self.posterior.names) if not name.startswith(NUISANCES))

    @property
    def offset_interval_s(self) -> tuple[float, float]:
        """90 % interval of the offset of the clocks [s]."""
        if self.draws is None:
            return self.posterior.offset_interval_s
        low, _, high = (OFFSET_S * self.draws.quantiles(len(self.posterior.names))).tolist()
        return low, high

    @property
    def sentences(self) -> tuple[str, ...]:
        """What a person should know of the fit."""
        each, (low, high) = self.posterior.nuisances, self.offset_interval_s
        channels = self.posterior.target.log.channels
        biases = ", ".join(
            f"{value:.3g} {name.rpartition('_')[2].replace('Nm', 'N m')} along {name.split('_')[1]}"
            for name, value in zip(channels, each.bias.tolist(), strict=True)
        )
        found = [
            f"forces come {1e3 * each.offset_s:.1f} ms ({1e3 * low:.1f} to {1e3 * high:.1f}) after the poses",
            f"bias of the sensor: {biases}",
            *self.notes,
        ]
        if not self.posterior.converged:
            found.append("the search did not come to a maximum: the intervals are not to be trusted")
        if self.draws is not None:
            found += [self.draws.sentence, *self.draws.warnings]
        return tuple(found)


def fit_scene(
    scene: Scene,
    log: MeasuredLog,
    *,
    free: Sequence[str] = (),
    nuts: bool = False,
    cores: int | None = None,
    progress: Progress | None = None,
) -> SceneFit:
    """Fit the constants of a scene's material to a log of forces and poses.

    Maximum posterior with the cited ranges as priors; the noise is autocorrelated and has heavy tails; the offset of
    the clocks, the sensor's bias and the specimen's density are estimated with the constants.

    Parameters
    ----------
    scene
        What was cut, and by which tool; its motion and device count for nothing, the log's poses stand for them.
    log
        What was measured, in the scene's frame.
    free
        Constants that are free, see `tissue.fitting.cutting_parameters.free_constants`; nothing frees the usual ones.
    nuts
        Draw from the posterior; without, it is a normal law about its maximum.
    cores
        Processor cores to use; default all.
    progress
        Called with what is being done.

    Raises
    ------
    InputError
        If such a scene cannot be fitted, the tool never cuts along the log, the log determines no constant, or there is
        no NumPyro to draw with.
    """
    report = progress or silent
    if nuts:
        require_nuts()
    build = ANATOMIES[scene.anatomy.kind].build
    if build not in PROBLEMS:
        raise InputError(f"scene must be one of tissue, got a {scene.anatomy.kind}: {FITTED}")
    problem = PROBLEMS[build](scene, log, free, cores=cores, progress=report)
    return _fitted(scene.name, log.path, problem, log.notes, report, nuts=nuts)


def fit_device(
    device: str,
    free: Path,
    held: Path | None,
    columns: Sequence[str] = (),
    *,
    nuts: bool = False,
    progress: Progress | None = None,
) -> SceneFit:
    """Fit mass, damping and friction of a device to logs of it, see `tissue.fitting.device_problem.device_problem`."""
    report = progress or silent
    if nuts:
        require_nuts()
    return _fitted(device, free, device_problem(device, free, held, tuple(columns)), (), report, nuts=nuts)


def _fitted(
    name: str, path: Path, problem: Problem, notes: tuple[str, ...], report: Progress, *, nuts: bool
) -> SceneFit:
    """The fit of a problem, and what it determines."""
    report("fitting", 0.8)
    posterior = maximum_posterior(problem.forward, problem.measured)
    found = identified(posterior)
    require_information(found, posterior)
    draws = None
    if nuts:
        report("drawing by NUTS, which takes minutes", 0.82)
        draws = draw_by_nuts(posterior.target, posterior.maximum, posterior.covariance, seed=SEED)
        found = drawn_information(found, posterior, draws)
    report("what to measure next", 0.9)
    material = [at for at, each in enumerate(posterior.names) if not each.startswith(NUISANCES)]
    gains = expected_information(posterior, problem.candidates(posterior), among=material)
    both = (*notes, *problem.notes)
    return SceneFit(name, path, posterior, found, tuple(gains), problem.block_s, both, draws, problem.fixed)


def require_information(found: Identified, posterior: Posterior) -> None:
    """Refuse a log that determines nothing.

    Raises
    ------
    InputError
        With how large the forces and the noise are.
    """
    if found.is_empty:
        target, noise = posterior.target, posterior.nuisances
        loads: Array = target.forward.loads(target.x(posterior.mean_z))
        forces = [at for at, name in enumerate(target.log.channels) if name.endswith("_N")]
        greatest = float(abs(loads[:, forces]).max())
        scale = float(noise.scale[forces].max())
        if greatest < VISIBLE * scale:
            raise InputError(
                f"measured must determine a constant, got a log in which noise of {scale:.2g} N hides what the tool "
                f"would meet, {greatest:.2g} N at most: give one of a deeper or faster cut"
            )
        raise InputError(
            f"measured must determine a constant, got a log that the scene explains to {scale:.2g} N and that leaves "
            "all of its constants at their ranges: check that the scene is what was cut, and choose others by free"
        )
