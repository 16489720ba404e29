"""Trial of a study: one person, specimen and noise under every method, and its metrics."""

import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import floor, inf, isfinite
from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.evaluation.calibration.observers import draw_observers
from tissue.evaluation.charts.settings import finest
from tissue.evaluation.statistics import metrics
from tissue.evaluation.study.plan import (
    LATENCY_MS,
    METHODS,
    PERSONAL,
    REFERENCE,
    TASKS,
    VARIANTS,
    Plan,
    TrialKey,
    Variant,
)
from tissue.evaluation.study.puncture import NOTICED, RATE_N_S, pierce
from tissue.perception.adaptive import MAGNITUDE_FORCES_N, fit_magnitudes
from tissue.perception.observer import PARAMETERS, Observer, reference_observer, write_observer
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion
from tissue.simulation.builders.force_met import chosen_scale
from tissue.simulation.builders.loop import judged_loop, loop_settings
from tissue.simulation.reference_force import ideal_force_N, motor_forces
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S, simulate

__all__ = [
    "NUMBERS",
    "PACE_SPREAD",
    "WITHIN_SPREAD",
    "Row",
    "Trial",
    "TrialScene",
    "error_sentence",
    "failures_of",
    "intensity_ratios",
    "measured",
    "run_trial",
    "trial_scene",
    "trial_seed",
]

Row = dict[str, str | float]
"""A method's name and its metrics, or the sentence of its failure."""

PACE_SPREAD = 0.15
WITHIN_SPREAD = 0.05
"""Spread of the logarithm of people's pace, and of one person's pace between trials; assumed."""
NUMBERS = 24
"""Number of forces that a person rated in the calibration, the default of a session."""
ARRIVED_MM = 2.0
"""Distance from the path's end within which a task counts as done.

A trembling hand does not hold the end itself.
"""
LEAST_N = 1e-3
"""Force below which nothing is felt, for the logarithm [N]."""
TOUCHES = 0.05
"""Share of a trial's largest force above which a contact counts.

At the beginning and end of a contact, ratios of forces have no meaning.
"""
WINDOW_S = 0.1
"""Time over which a person averages a force; `integration_s` in perception.toml."""
PLAIN = Variant("", "", {})


@dataclass(frozen=True)
class Trial:
    """Result of a trial.

    Attributes
    ----------
    key
        Which.
    seed
        Seed of its scenes.
    rows
        For each method its name and metrics, or the sentence of its failure.
    took_s
        Wall time [s].
    """

    key: TrialKey
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    rows: tuple[Row, ...]
    took_s: float

    @property
    def failed(self) -> bool:
        """True if a method failed in the trial."""
        return any("failure" in row for row in self.rows)

    def values(self, metric: str) -> dict[str, float]:
        """Return a metric by the methods that have it."""
        return {str(row["method"]): float(row[metric]) for row in self.rows if metric in row}


@dataclass(frozen=True)
class TrialScene:
    """Scenes and person of a trial.

    Attributes
    ----------
    scenes
        The scene under each method. The coupling stiffness is the smallest of the stiffnesses
        chosen for the methods. It is stable under all methods, so that their forces can be
        compared.
    specimen
        Number of the specimen.
    person
        Person of the trial with exact parameters. The scene with perception uses only the
        calibrated parameters of this person.
    pace
        Factor on the speed of a path, or on the rise of a force.
    """

    scenes: Mapping[str, Scene]
    specimen: int
    person: Observer
    pace: float


def run_trial(plan: Plan, key: TrialKey) -> Trial:
    """Run a trial under every method of its plan.

    A failed method leaves its sentence, and the other methods continue. A single call gives the
    same result as in the study: ``run_trial(Plan(seed=0), TrialKey.named("T1-novice-0007"))``.
    """
    started = perf_counter()
    rows: list[Row] = []
    trial: TrialScene | None = None
    with tempfile.TemporaryDirectory() as folder:
        for method in _methods(plan, key):
            try:
                trial = trial or trial_scene(plan, key, Path(folder) / f"{method}.json")
                rows.append({"method": method, **_metrics(trial, method, key)})
            except Exception as error:
                # a trial that fails must not take the study with it, whatever the fault
                rows.append({"method": method, "failure": error_sentence(error)})
    return Trial(key, trial_seed(plan, key), tuple(rows), perf_counter() - started)


def failures_of(trials: Iterable[Trial]) -> dict[str, list[str]]:
    """Return the names of trials by method and sentence of a failure.

    Sentences that differ only in the time of the failure are counted as equal.
    """
    found: dict[str, list[str]] = {}
    for trial in trials:
        for row in trial.rows:
            if "failure" in row:
                what = re.sub(r"\b[\d.e+-]+ s\b", "... s", str(row["failure"]))
                found.setdefault(f"{row['method']}: {what}", []).append(trial.key.name)
    return found


def trial_seed(plan: Plan, key: TrialKey) -> int:
    """Return the seed of a trial's scenes."""
    # the first number of the trial's generator, as in `trial_scene`
    return int(plan.rng(key).integers(2**62))


def error_sentence(error: Exception) -> str:
    """Return the kind and words of an error on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def trial_scene(plan: Plan, key: TrialKey, observer: Path) -> TrialScene:
    """Return the scenes of a trial and its person; write the person's calibration to a file."""
    rng = plan.rng(key)
    person = plan.person(key)
    task = TASKS[key.task]
    variant = VARIANTS.get(key.variant, PLAIN)
    # a seed is a signed 64-bit integer in tables
    seed = int(rng.integers(2**62))
    pace = variant.pace * float(
        np.exp(PACE_SPREAD * person.standard_normal() + WITHIN_SPREAD * rng.standard_normal())
    )
    truth, known = _calibrated(key, person)
    write_observer(known, observer)
    met = (
        task.specimens[key.specimen] if variant.extreme is None else task.extremes[variant.extreme]
    )
    scene = changed(load_scene(task.scene), {**task.changes, **met})
    assert isinstance(scene.motion, PathMotion)
    per_trial = {
        "seed": seed,
        "motion.feed_mm_s": round(pace * scene.motion.feed_mm_s, 3),
        "coupling.force_scale": min(map(_force_scale, (scene, *_all_specimens(key.task)))),
    }
    by_hand = {
        "device": "touch",
        "hand": key.group,
        "coupling.delay_ms": LATENCY_MS,
        **variant.changes,
    }
    scene = changed(scene, by_hand)
    felt = {
        name: {"perception": f"observer:{observer}"} if name in PERSONAL else {} for name in METHODS
    }
    scenes = {name: changed(scene, {**method, **felt[name]}) for name, method in METHODS.items()}
    # one stiffness for all methods, so that only the method differs; the smallest is stable under
    # each
    common_N_m = min(floor(_stiffness_N_m(each)) for each in scenes.values())
    for name, scene in scenes.items():
        scenes[name] = changed(scene, {**per_trial, "coupling.stiffness_N_m": common_N_m})
    return TrialScene(scenes, key.specimen, truth, pace)


# the size bounds the memory; a scene that was dropped is computed again, with the same result
@lru_cache(maxsize=64)
def _force_scale(scene: Scene) -> float:
    """Return the chosen ratio of device force to tool force of a scene on the study's device.

    The smallest scale over a task's specimens is used for all of them. With a separate scale for
    each specimen, all specimens would feel alike.
    """
    return chosen_scale(changed(scene, {"device": "touch"}))[0]


def _all_specimens(task: str) -> list[Scene]:
    """Return the scenes of a task with each of its specimens."""
    usual = TASKS[task]
    return [changed(load_scene(usual.scene), {**usual.changes, **each}) for each in usual.specimens]


# the size bounds the memory; a scene that was dropped is computed again, with the same result
@lru_cache(maxsize=64)
def _stiffness_N_m(scene: Scene) -> float:
    """Return the chosen stiffness of a scene [N/m].

    It does not depend on seed and pace, so that few values are computed.
    """
    return judged_loop(loop_settings(scene), step_s=TICK_S).stiffness_N_m


def _calibrated(key: TrialKey, rng: np.random.Generator) -> tuple[Observer, Observer]:
    """Return a person and the person's calibration from rated numbers.

    The thresholds of the calibration are exact.
    """
    drawn = draw_observers(key.group, 1, rng)
    name = f"{key.group} {key.user}"
    alpha, beta, kappa, offset_N, lapse, sigma = (
        float(getattr(drawn, each)[0]) for each in PARAMETERS
    )
    truth = Observer.known(
        name, alpha=alpha, beta=beta, kappa=kappa, offset_N=offset_N, lapse=lapse, sigma=sigma
    )
    forces = np.resize(MAGNITUDE_FORCES_N, NUMBERS)
    fit = fit_magnitudes(forces, np.array([drawn.number(force, rng)[0] for force in forces]))
    mean = truth.mean.copy()
    covariance = truth.covariance.copy()
    mean[:2] = fit.mean
    covariance[:2, :2] = fit.covariance
    return truth, Observer(name=name, mean=mean, covariance=covariance, trials=NUMBERS)


def _methods(plan: Plan, key: TrialKey) -> tuple[str, ...]:
    """Return the methods of a trial.

    Variants are run only for the headline, and the reference variant under one method.
    """
    if not key.variant:
        return plan.methods
    wanted = ("penalty",) if key.variant == REFERENCE else ("penalty", "koopman")
    return tuple(method for method in plan.methods if method in wanted) or plan.methods[:1]


def _metrics(trial: TrialScene, method: str, key: TrialKey) -> dict[str, float]:
    """Return the metrics of a trial under one method."""
    scene = trial.scenes[method]
    person = trial.person
    # a needle is pushed by force and stopped by a reaction, not moved along a path
    if key.task == "needle":
        run = pierce(
            scene, kappa=person.kappa, offset_N=person.offset_N, rate_N_s=trial.pace * RATE_N_S
        ).run
    else:
        run = simulate(scene, cores=1)
    if key.variant == REFERENCE:
        prompt = ideal_force_N(run, cores=1)
        converged = ideal_force_N(run, finest(run.scene, quick=True), cores=1)
        return {"reference_error": metrics.force_error(prompt, converged)}
    assert isinstance(run.scene.motion, PathMotion)
    wanted = np.array(TASKS[key.task].wanted_mm or run.scene.motion.points_mm)
    return measured(run, key.task, person, wanted_mm=wanted) | {"specimen": float(trial.specimen)}


def measured(run: Run, task: str, person: Observer, *, wanted_mm: Array) -> dict[str, float]:
    """Compute the metrics of a run, by name with their unit.

    Parameters
    ----------
    run
        Run by a hand on a device.
    task
        Name of the task. Some tasks have special metrics.
    person
        Person who feels the force.
    wanted_mm
        Target path of the tool, corner by corner [mm], shape (corners, 3).

    Raises
    ------
    InputError
        If the tool touched nothing, or the required event of the task did not happen.
    """
    trace = run.trace
    played, ideal, nearest, _ = motor_forces(run, ideal_force_N(run, cores=1))
    skin = trace.vectors("hand_force", "N")[1:]  # of the tick before each row
    size = np.linalg.norm(ideal, axis=1)
    if not size.any():
        raise InputError("tool", "touch in a trial", "no contact", "look at the scene's path")
    touching = size > TOUCHES * size.max()
    velocity = trace.vectors("velocity", "mm_s")
    tip = trace.vectors("tool", "mm")
    assert isinstance(run.scene.motion, PathMotion)
    done = np.linalg.norm(tip - np.array(run.scene.motion.points_mm[-1]), axis=1) < ARRIVED_MM
    # a path may end where it begins: the tool must have left the end before
    took = metrics.completion_time_s(trace["time_s"], done & (np.cumsum(~done) > 0))
    error = metrics.force_error(played, ideal)
    least = metrics.force_error(nearest, ideal)
    found = {
        "force_error": error,
        "least_error": least,
        "excess_error": metrics.excess_error(error, least),
        **intensity_ratios(skin, nearest, ideal, person),
        "force_mae_N": metrics.force_mae_N(played, ideal),
        "force_rms_N": metrics.force_rms_N(played, ideal),
        "latency_ms": metrics.latency_ms(played, nearest, tick_s=TICK_S),
        "position_error_mm": float(_from_path(tip, wanted_mm).mean()),
        "time_s": took if isfinite(took) else float(trace["time_s"][-1]),
        "completed": float(isfinite(took)),
        "acceleration_change_m_s2": metrics.acceleration_change_m_s2(velocity, tick_s=TICK_S),
        "spectral_arc_length": metrics.spectral_arc_length(
            np.linalg.norm(velocity, axis=1), tick_s=TICK_S
        ),
        "peak_force_N": float(size.max()),
        "level_N": float(size[touching].mean()),
        "skin_N": float(np.linalg.norm(skin, axis=1)[touching].mean()),
    }
    if task == "needle":
        found |= _pierced(run)
    # compared in newtons at the reamer, while `force_rms_N` is at the device
    if task == "reaming":
        found["tracking_rms_N"] = found["force_rms_N"] / chosen_scale(run.scene)[0]
        found |= _reamed(run, touching)
    return found


def _pierced(run: Run) -> dict[str, float]:
    """Return the needle's travel after the capsule's puncture, and the force before and after it.

    A puncture that nobody notices is a result and not a failure. ``noticed`` is then 0, and the
    travel is the travel until the end of the trial, which is a lower bound. A hand that stops
    before the puncture leaves no puncture to measure.
    """
    puncture = next((time for time, what in run.events if "capsule" in what), inf)
    noticed = next((time for time, what in run.events if what == NOTICED), inf)
    if puncture == inf or noticed < puncture:
        raise InputError(
            "capsule",
            "be punctured before the hand stops in a trial",
            f"a hand that stopped at {noticed:g} s",
            "see its threshold",
        )
    at = round(puncture / TICK_S)
    window = round(WINDOW_S / TICK_S)
    size = np.linalg.norm(run.trace.vectors("hand_force", "N"), axis=1)
    return {
        "noticed": float(noticed < inf),
        "excess_mm": metrics.excess_travel_mm(-run.trace["tool_z_mm"], puncture_tick=at),
        "capsule_N": float(size[max(0, at - window) : at].mean()),
        "parenchyma_N": float(size[at + 1 : at + 1 + window].mean()),
    }


def _reamed(run: Run, touching: NDArray[np.bool_]) -> dict[str, float]:
    """Return the torque of a reamer while it cuts."""
    torque = np.abs(run.trace["model_torque_z_Nm"][:-1][touching])
    windows = [
        part.mean()
        for part in np.array_split(torque, max(1, round(len(torque) * TICK_S / WINDOW_S)))
    ]
    return {"torque_Nm": float(np.mean(windows)), "torque_scatter_Nm": float(np.std(windows))}


def intensity_ratios(
    skin_N: Array, nearest_N: Array, ideal_N: Array, person: Observer
) -> dict[str, float]:
    """Return the error of ratios of intensity, and the errors of three comparison forces.

    The error is the spread of ln S(F) - ln S_ref(F_ideal) over windows of a tenth of a second that
    lie entirely in contact. S is Stevens' law. A spread of 0.1 is a ratio error of a tenth, and 0
    is perfect. A common factor, which cannot be separated from a person's use of numbers, does not
    count. The exponents are the true exponents of the simulated people.

    Returns
    -------
    dict
        Spread of the force at the skin, and of three comparison forces: a perfect force through the
        same encoder steps as the reference feels it, the ideal force with only this person's
        exponent, and a constant force.
    """
    count = max(len(ideal_N) // round(WINDOW_S / TICK_S), 1)
    sizes = np.linalg.norm(ideal_N, axis=1)
    met = np.array([part.min() for part in np.array_split(sizes, count)]) > TOUCHES * sizes.max()
    # a spread needs two windows
    if met.sum() < 2:
        raise InputError(
            "tool",
            "touch for some tenths of a second in a trial",
            "less",
            "look at the scene's path",
        )

    def logarithm(force_N: Array) -> Array:
        """Return the logarithm of the size of the mean force in each window in contact."""
        means = np.array([part.mean(axis=0) for part in np.array_split(force_N, count)])
        return np.asarray(np.log(np.maximum(np.linalg.norm(means[met], axis=1), LEAST_N)))

    felt, least, meant = map(logarithm, (skin_N, nearest_N, ideal_N))
    beta = reference_observer().beta
    return {
        "ratio_error": float(np.std(person.beta * felt - beta * meant)),
        "ratio_floor": float(np.std(beta * (least - meant))),
        "ratio_unscaled": float(np.std((person.beta - beta) * meant)),
        "ratio_silent": float(np.std(beta * meant)),
    }


def _from_path(tip_mm: Array, path_mm: Array) -> Array:
    """Return the distance of tips from a path of straight legs [mm], shape (n,)."""
    nearest = np.full(len(tip_mm), np.inf)
    for start, end in pairwise(path_mm):
        leg = end - start
        # a leg without length is its start
        along = np.clip((tip_mm - start) @ leg / max(float(leg @ leg), 1e-12), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(tip_mm - start - along[:, None] * leg, axis=1))
    return nearest
