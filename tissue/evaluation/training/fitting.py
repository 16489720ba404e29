"""From recorded runs to a scene's predictors: contact plane, dictionary, operators and the terms of the loop."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.training.recording import Recording
from tissue.prediction.edmd.dictionary import Delays, Dictionary, Identity
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode, window
from tissue.prediction.edmd.lifted import Operator
from tissue.prediction.edmd.overlaps import Overlaps
from tissue.prediction.edmd.polynomials import Polynomials
from tissue.prediction.edmd.radial import Gaussians
from tissue.prediction.edmd.validation import choose
from tissue.prediction.koopman import RELEASED, SMOOTHING, WIDTH, LoopTerms
from tissue.prediction.trained import Trained

__all__ = ["CHOSEN_AT", "candidates", "contact_plane", "fit", "loop_terms"]

CHOSEN_AT = 4
"""Ticks ahead at which dictionaries are compared: the latency that is to be hidden."""
FOLDS = 3
COMPARED = 9
"""Runs by which dictionaries are compared; all of them fit the one that is chosen."""
FELT = 0.1
"""Share of the greatest axis' force from which an axis counts when dictionaries are compared."""
LAGS = (5, 10, 20)
LEADS = (0.0, 2.0, 4.0, 8.0)
"""Steps ahead at which the gap is looked at."""
SPEED_STEPS = 10
"""Steps over which the gap's speed is taken."""
HORIZON_TICKS = 12
"""Ticks ahead up to which terms are learnt."""
CENTRES = 12
"""Centres of radial observables."""
RADIAL_LAGS = 5
MARGIN = 3.0
"""Times the largest usual error and size in training at which the loop stops trusting; a prior."""


def contact_plane(runs: Sequence[Recording]) -> tuple[Array, float]:
    """Normal n and distance c of the plane n . x + c = 0 where contact begins.

    The normal is the mean direction of the force on the device; the plane goes through the median place of first
    touches along it.

    Raises
    ------
    InputError
        If nothing is touched.
    """
    total = np.sum([run.force_N.sum(axis=0) for run in runs], axis=0)
    size = float(np.linalg.norm(total))
    if size == 0.0:
        raise InputError("scene must have a tool that touches, got no force in any trial: run longer, or go deeper")
    normal = total / size
    places: list[float] = []
    for run in runs:
        touched = np.abs(run.force_N).max(axis=1) > 0.0
        begins = np.flatnonzero(touched[1:] & ~touched[:-1]) + 1
        places += (run.position_m[begins] @ normal).tolist()
    return normal, -float(np.median(places)) if places else 0.0


def candidates(runs: Sequence[Recording], rng: np.random.Generator) -> dict[str, Edmd]:
    """Dictionaries to choose from: delays alone, with overlaps of the contact, with second powers, with Gaussians."""
    normal, distance = contact_plane(runs)
    found: dict[str, Dictionary] = {}
    for lags, seen in product(LAGS, (False, True)):
        gap = Overlaps(tuple(normal.tolist()), distance, LEADS, min(SPEED_STEPS, lags), WIDTH)
        found[f"{lags} delays{' and overlaps' if seen else ''}"] = Delays(lags, gap if seen else Identity())
    newest = tuple(range(WIDTH))
    states = np.concatenate([window(run.episode().states, RADIAL_LAGS)[::20] for run in runs])
    found[f"{RADIAL_LAGS} delays and Gaussians"] = Delays(
        RADIAL_LAGS, Gaussians.from_states(states, CENTRES, rng, columns=newest)
    )
    found[f"{RADIAL_LAGS} delays and second powers"] = Delays(RADIAL_LAGS, Polynomials(2, newest))
    return {name: Edmd(dictionary) for name, dictionary in found.items()}


def fit(scene: str, runs: Sequence[Recording], *, rng: np.random.Generator) -> Trained:
    """Predictors of a scene from recorded runs.

    The dictionary is chosen by cross-validation over whole runs at `CHOSEN_AT` ticks; everything else follows from the
    one-step and later errors of the operator that is fitted to all runs.

    Raises
    ------
    InputError
        If there are fewer runs than folds, or they cannot be learnt from.
    """
    if len(runs) < FOLDS:
        raise InputError(f"trials must leave at least {FOLDS} to learn from, got {len(runs)}: use more")
    episodes = [run.episode() for run in runs]
    offered = candidates(runs, rng)
    rms = np.sqrt(np.mean([(run.force_N**2).mean(axis=0) for run in runs], axis=0))
    felt = [3 + axis for axis in range(3) if rms[axis] > FELT * rms.max()]
    choice = choose(offered, episodes[:COMPARED], horizon=CHOSEN_AT, folds=FOLDS, columns=felt)
    operator = offered[choice.name].fit(episodes) if len(runs) > COMPARED else choice.operator
    control = Edmd(Identity()).fit([run.driven_episode() for run in runs])
    statistics = operator.statistics
    facts = {
        "dictionary": choice.name,
        "scores": {name: float(scores.mean()) for name, scores in choice.scores.items() if np.isfinite(scores).all()},
        "refused": sorted(choice.refused),
        "observables": len(operator.offset),
        "samples": statistics.samples,
        "radius_before_cap": statistics.radius_before,
        "capped": statistics.capped,
        "seeds": [run.seed for run in runs],
    }
    return Trained(scene, operator, control, loop_terms(operator, episodes), facts)


def loop_terms(operator: Operator, episodes: Sequence[Episode]) -> LoopTerms:
    """What the loop needs besides the operator, from its errors on the training runs."""
    lags, steps, powers = operator.dictionary.lags, HORIZON_TICKS, operator.predicted_states(HORIZON_TICKS)
    along, square = np.zeros(steps), 0.0
    sizes, running, quiet, reach, growth = [], [], [], 0.0, 0.0
    moved, pushed = np.zeros((3, 3)), np.zeros((3, 3))
    for episode in episodes:
        lifted = operator.dictionary.lift(window(episode.states, lags))
        states = episode.states[lags:]
        spread = (lifted - operator.middle) / operator.scale
        growth = max(growth, float((spread**2).mean(axis=1).max()))
        missed = states[1:] - lifted[:-1] @ powers[0][0].T - powers[0][1]
        error = missed[:, 3:]
        size = np.linalg.norm(error, axis=1)
        sizes.append(size)
        running.append(_smoothed(size))
        touching = np.abs(states[1:, 3:]).max(axis=1) > 1e-4
        moved += missed[touching, :3].T @ missed[touching, :3]
        pushed += missed[touching, :3].T @ error[touching]
        count = len(states) - 1 - steps
        square += float((error[:count] ** 2).sum())
        for step, (matrix, offset) in enumerate(powers):
            predicted = lifted[1 : 1 + count] @ matrix[3:].T + offset[3:]
            came = states[2 + step : 2 + step + count, 3:]
            along[step] += float((error[:count] * (came - predicted)).sum())
        predicted = lifted @ powers[CHOSEN_AT - 1][0][3:].T + powers[CHOSEN_AT - 1][1][3:]
        reach = max(reach, float(np.linalg.norm(predicted - states[:, 3:], axis=1).max()))
        quiet.append(np.linalg.norm(predicted, axis=1)[_free(states[:, 3:])])
    errors, free = np.concatenate(sizes), np.concatenate(quiet)
    return LoopTerms(
        gains=tuple(np.clip(along / square, -1.0, 1.0).tolist()),
        residual_N=MARGIN * float(np.quantile(np.concatenate(running), 0.999)),
        correction_N=float(np.quantile(errors, 0.999)),
        quiet_N=float(np.quantile(free, 0.995)) if len(free) else 0.0,
        reach_N=MARGIN * reach,
        growth=MARGIN * growth,
        following=np.asarray(np.linalg.lstsq(moved, pushed, rcond=1e-9)[0].T, dtype=np.float64),
    )


def _smoothed(sizes: Array) -> Array:
    """The running error that the loop keeps."""
    from scipy.signal import lfilter

    return np.asarray(lfilter([SMOOTHING], [1.0, SMOOTHING - 1.0], sizes))


def _free(forces_N: Array) -> NDArray[np.bool_]:
    """Ticks in which the device has been free for a while and stays so."""
    touching = np.abs(forces_N).max(axis=1) > 1e-4
    near = np.convolve(touching, np.ones(2 * HORIZON_TICKS + 1), "same") > 0.0
    return np.asarray(~near & (np.arange(len(near)) >= RELEASED))
