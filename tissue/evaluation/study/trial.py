"""Trial of a study and its metrics.

In a trial, all methods are run with the same person, specimen and random numbers.
"""

import re
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import floor
from pathlib import Path
from time import perf_counter
from typing import Annotated

import numpy as np
from pydantic import Field

from meshes.base.hints import suggests_arguments
from tissue.evaluation.calibration.observers import draw_observers
from tissue.evaluation.study.plan import (
    LATENCY_MS,
    PERSONAL,
    TASKS,
    Plan,
    TrialKey,
    method_settings,
)
from tissue.evaluation.study.puncture import RATE_N_S, pierce
from tissue.evaluation.study.trial_metrics import measured
from tissue.perception.adaptive import MAGNITUDE_FORCES_N, fit_magnitudes
from tissue.perception.observer import PARAMETERS, Observer, write_observer
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion
from tissue.simulation.builders.force_scale import chosen_scale
from tissue.simulation.builders.loop import judged_loop, loop_settings
from tissue.simulation.simulate import simulate

Row = dict[str, str | float]
"""Row of a table: the name of a method with its metrics, or with the reason of its failure."""

PACE_SPREAD = 0.15
WITHIN_SPREAD = 0.05
"""Standard deviation, between trials of a person, of the logarithm of the pace (assumed).

The pace is a factor on the speed of the hand. `PACE_SPREAD` is the standard deviation between
people (assumed too).
"""
NUMBERS = 24
"""Number of forces that a person rates in the calibration: the default of a calibration session."""


@suggests_arguments
@dataclass(frozen=True)
class Trial:
    """Result of a trial under all methods of a study.

    Attributes
    ----------
    key
        Key of the trial.
    seed
        Seed of the scenes in the trial.
    rows
        One row for each method, see `Row`.
    took_s
        Wall time of the trial [s].
    plan_sha256, code_sha256
        Hash of the registered plan, and hash of the code that ran the trial.
    whole
        False if the trial's file was edited and its content does not match the recorded hash.
    """

    key: TrialKey
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    rows: tuple[Row, ...]
    took_s: float
    plan_sha256: str = ""
    code_sha256: str = ""
    whole: bool = True

    @property
    def failed(self) -> bool:
        """True if at least one method failed in the trial."""
        return any("failure" in row for row in self.rows)

    def values(self, metric: str) -> dict[str, float]:
        """Return the value of a metric for each method that has it, keyed by method."""
        return {str(row["method"]): float(row[metric]) for row in self.rows if metric in row}


@dataclass(frozen=True)
class TrialScene:
    """Scenes and person of a trial.

    Attributes
    ----------
    scenes
        Scene for each method. All scenes have the same coupling stiffness, with which the coupling
        is stable for all methods. The forces of the methods can therefore be compared.
    specimen
        Number of the specimen.
    person
        Person of the trial, with the true perceptual parameters. Methods use only the parameters
        that a calibration estimates.
    pace
        Factor that multiplies the speed of the hand along its path, or the rate at which a pushing
        force increases.
    """

    scenes: Mapping[str, Scene]
    specimen: int
    person: Observer
    pace: float


def run_trial(plan: Plan, key: TrialKey) -> Trial:
    """Run a trial under every method of its plan.

    If a method fails, its row contains the reason, and the other methods are still run. A single
    call such as ``run_trial(Plan(seed=0), TrialKey.named("T1-novice-0007"))`` gives the same result
    for this trial as a run of the whole study.
    """
    started = perf_counter()
    rows: list[Row] = []
    trial: TrialScene | None = None
    with tempfile.TemporaryDirectory() as folder:
        for method in plan.methods:
            try:
                trial = trial or trial_scene(plan, key, Path(folder) / f"{method}.json")
                rows.append({"method": method, **_metrics(trial, method, key)})
            except Exception as error:
                # a trial that fails must not end the study, whatever the fault
                rows.append({"method": method, "failure": error_sentence(error)})
    return Trial(key, trial_seed(plan, key), tuple(rows), perf_counter() - started)


def failures_of(trials: Iterable[Trial]) -> dict[str, list[str]]:
    """Return the names of failed trials, keyed by a text with the method and the failure.

    Two texts that differ only in the time of the failure are counted as the same reason.
    """
    found: dict[str, list[str]] = {}
    for trial in trials:
        for row in trial.rows:
            if "failure" in row:
                what = re.sub(r"\b[\d.e+-]+ s\b", "... s", str(row["failure"]))
                found.setdefault(f"{row['method']}: {what}", []).append(trial.key.name)
    return found


def trial_seed(plan: Plan, key: TrialKey) -> int:
    """Return the seed of the scenes in a trial."""
    # the first number of the trial's generator, as in `trial_scene`
    return int(plan.rng(key).integers(2**62))


def error_sentence(error: Exception) -> str:
    """Return the type and the message of an error on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def trial_scene(plan: Plan, key: TrialKey, observer: Path) -> TrialScene:
    """Return the scenes and person of a trial; write the person's calibration to `observer`."""
    rng = plan.rng(key)
    person = plan.person(key)
    task = TASKS[key.task]
    # a seed is a signed 64-bit integer in tables
    seed = int(rng.integers(2**62))
    spread = PACE_SPREAD * person.standard_normal() + WITHIN_SPREAD * rng.standard_normal()
    pace = float(np.exp(spread))
    truth, known = _calibrated(key, person)
    write_observer(known, observer)
    specimen = task.specimens[key.specimen]
    scene = changed(load_scene(task.scene), {**task.changes, **specimen})
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
    }
    scene = changed(scene, by_hand)
    felt = {name: {"perception": f"observer:{observer}"} for name in PERSONAL}
    scenes = {
        name: changed(scene, {**method_settings(name), **felt.get(name, {})})
        for name in plan.methods
    }
    # one stiffness for all methods, so that only the method differs; the smallest is stable under
    # each
    common_N_m = min(map(_stiffness_N_m, scenes.values()))
    for name, scene in scenes.items():
        scenes[name] = changed(scene, {**per_trial, "coupling.stiffness_N_m": common_N_m})
    return TrialScene(scenes, key.specimen, truth, pace)


# the cache size limits the memory; a scene that was dropped is computed again with the same result
@lru_cache(maxsize=64)
def _force_scale(scene: Scene) -> float:
    """Return the force scale that is automatically chosen for a scene with the study's device.

    A trial uses the smallest force scale of all specimens of its task. With a separate scale for
    each specimen, differences between the specimens could not be felt.
    """
    return chosen_scale(changed(scene, {"device": "touch"}))[0]


def _all_specimens(task: str) -> list[Scene]:
    """Return the scene of a task with each of its specimens."""
    usual = TASKS[task]
    return [changed(load_scene(usual.scene), {**usual.changes, **each}) for each in usual.specimens]


def _stiffness_N_m(scene: Scene) -> int:
    """Return the coupling stiffness [N/m] that is automatically chosen for a scene.

    The value is rounded down.
    """
    return floor(judged_loop(loop_settings(scene)).stiffness_N_m)


def _calibrated(key: TrialKey, rng: np.random.Generator) -> tuple[Observer, Observer]:
    """Draw a person; return the true parameters and their estimates by a calibration.

    The calibration estimates the parameters of Stevens' law from rated forces. All other parameters
    keep their true values.
    """
    drawn = draw_observers(key.group, 1, rng)
    name = f"{key.group} {key.user}"
    medians = {each: getattr(drawn, each)[0] for each in PARAMETERS}
    truth = Observer.known(name, **medians)
    forces = np.resize(MAGNITUDE_FORCES_N, NUMBERS)
    fit = fit_magnitudes(forces, np.array([drawn.number(force, rng)[0] for force in forces]))
    mean = truth.mean.copy()
    covariance = truth.covariance.copy()
    mean[:2] = fit.mean
    covariance[:2, :2] = fit.covariance
    return truth, Observer(name=name, mean=mean, covariance=covariance, trials=NUMBERS)


def _metrics(trial: TrialScene, method: str, key: TrialKey) -> dict[str, float]:
    """Return the metrics of a trial under one method."""
    scene = trial.scenes[method]
    person = trial.person
    # a needle is pushed by force and stopped by a reaction, not moved along a path
    if key.task == "needle":
        run = pierce(
            scene, kappa=person.kappa, offset_N=person.offset_N, rate_N_s=trial.pace * RATE_N_S
        )
    else:
        run = simulate(scene, cores=1)
    assert isinstance(run.scene.motion, PathMotion)
    wanted = np.array(TASKS[key.task].wanted_mm or run.scene.motion.points_mm)
    return measured(run, key.task, person, wanted_mm=wanted) | {"specimen": float(trial.specimen)}
