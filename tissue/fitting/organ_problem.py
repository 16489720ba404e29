"""A log of a probe on an organ as a fit takes it: loads by runs, linear in constants near the most probable ones."""

import os
from collections.abc import Sequence

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import names_of_caller
from meshes.base.progress import Progress
from tissue.fitting.averaged import block_averages, block_ticks
from tissue.fitting.cutting import CHANNELS
from tissue.fitting.forward import LinearForward
from tissue.fitting.log import MeasuredLog
from tissue.fitting.organ_runs import KEYS, Poses, organ_loads
from tissue.fitting.parameter import Parameter, chosen
from tissue.fitting.posterior import maximum_posterior
from tissue.fitting.problem import Problem
from tissue.materials.prior import Prior
from tissue.models.tissue_model import TICK_S
from tissue.scene.scene import Scene
from tissue.scene.used_constants import used_constants

__all__ = ["organ_problem"]

STEP = 0.3
"""Step of a constant over which loads are differenced, in standard deviations of its prior: nodes come into contact and
leave it, so that smaller ones show single nodes."""
SETTLED = 0.3
"""Distance of the most probable constants from those of the runs, in their standard deviations, at which they agree."""
ROUNDS = 4
UNSETTLED = "runs and result do not agree yet: the intervals are not to be trusted, free fewer constants"
FARTHEST = 3.0
"""Standard deviations of a prior beyond which no run is made."""
FRICTION = (0.25, 2.5)
"""5 and 95 % of friction between tool and organ, over the scene's: wet tissue on metal 0.1 to 0.6 (from memory of the
literature)."""
MODULUS = (1.0 / 3.0, 3.0)
"""Likewise of a modulus that the scene states and `free` names: as liver scatters in tissue/materials/soft.toml."""


def organ_problem(
    scene: Scene, log: MeasuredLog, free: Sequence[str], *, cores: int | None, progress: Progress
) -> Problem:
    """A probe that presses an organ; see `tissue.fitting.fit.fit_scene`.

    The organ is run along the log's poses, once with the constants as they are and once with each of them changed.
    Loads are linear in a modulus and nearly so in the others: the runs are made again about what was found until that
    agrees.
    """
    poses = Poses(log.times_s, log.tips_m, log.quaternions_of(scene))
    parameters = tuple(chosen(free, _possible(scene, named=bool(free))))
    ticks = block_ticks(float(log.load_times_s[-1] - log.load_times_s[0]), log.load_period_s)
    measured = block_averages(log.load_times_s, log.loads, log.channels, ticks)
    z, workers = np.zeros(len(parameters)), cores or os.cpu_count() or 1
    with names_of_caller({"motion must": "measured must", "the motion": "the log"}):
        for number in range(ROUNDS):
            progress(f"round {number + 1} of runs of the organ", 0.2 * number)
            forward = _linear(scene, poses, parameters, z, workers, progress)
            posterior = maximum_posterior(forward, measured)
            away = np.abs(posterior.mean_z - z) / np.sqrt(np.diag(posterior.covariance_z))
            z = np.clip(posterior.mean_z, -FARTHEST, FARTHEST)
            if float(away.max()) < SETTLED:
                break
    return Problem(forward, measured, ticks * TICK_S, lambda _: [], _notes(parameters, number + 1, away))


def _notes(parameters: Sequence[Parameter], rounds: int, away: Array) -> tuple[str, ...]:
    count = rounds * (1 + len(parameters))
    keys = ", ".join(each.name for each in parameters if each.name.startswith(KEYS))
    return (
        f"{count} runs of the organ in {rounds} rounds, the last {away.max():.2g} standard deviations from its result",
        "what to measure next is not computed for an organ, whose every candidate would be several runs",
        *([UNSETTLED] if float(away.max()) >= SETTLED else []),
        *([f"not a material's and not in fitted.toml, to be set in the scene: {keys}"] if keys else []),
    )


def _possible(scene: Scene, *, named: bool) -> list[Parameter]:
    """What can be free: constants of the organ that it does not state, friction, and stated moduli where asked for."""
    used = [each for each in used_constants(scene, ()) if each.full.startswith("soft.")]
    found = [
        Parameter(each.full, Prior.of(each.cited, each.full))
        for each in used
        if each.stated is None and each.cited.low < each.cited.high
    ]
    organ = scene.organ
    stated = {"organ.friction": (organ.friction, FRICTION)}
    if named:
        stated |= {"organ.young_kPa": (organ.young_kPa or 0.0, MODULUS)}
        stated |= {"organ.young_end_kPa": (organ.young_end_kPa or 0.0, MODULUS)}
        stated |= {f"organ.parts.{name}": (value, MODULUS) for name, value in (organ.parts or {}).items()}
    for name, (value, (low, high)) in stated.items():
        if value > 0.0:
            found.append(Parameter(name, Prior(value, low * value, high * value)))
    return found


def _linear(
    scene: Scene, poses: Poses, parameters: Sequence[Parameter], z: Array, workers: int, progress: Progress
) -> LinearForward:
    """Loads that are linear in the constants about those of normal numbers z, shape (p,)."""
    x = np.array([float(each.prior.x(at)) for each, at in zip(parameters, z, strict=True)])
    towards = np.where(z > 0.0, -STEP, STEP)
    other = np.array([float(each.prior.x(at)) for each, at in zip(parameters, z + towards, strict=True)])
    names = [each.name for each in parameters]
    samples = [dict(zip(names, x.tolist(), strict=True))]
    samples += [samples[0] | {name: float(value)} for name, value in zip(names, other, strict=True)]
    base, *changed = organ_loads(scene, poses, samples, cores=workers, report=progress)
    basis = np.stack([(each - base) / (b - a) for each, a, b in zip(changed, x, other, strict=True)], axis=-1)
    times_s = float(poses.times_s[0]) + TICK_S * np.arange(len(base), dtype=np.float64)
    return LinearForward(tuple(parameters), CHANNELS, times_s, basis, base - basis @ x)
