"""One trial of a study: the same person, specimen and noise under every method, and the metrics of each."""

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

from tissue.builders.force_met import chosen_scale
from tissue.builders.loop import judged_loop
from tissue.builders.loop_settings import loop_settings
from tissue.evaluation.calibration.simulated_observer import draw_observers
from tissue.evaluation.charts.settings import finest
from tissue.evaluation.statistics import metrics
from tissue.evaluation.study.measures import measured
from tissue.evaluation.study.plan import LATENCY_MS, REFERENCE, Plan, TrialKey
from tissue.evaluation.study.puncture import RATE_N_S, pierce
from tissue.evaluation.study.tasks import METHODS, PERSONAL, TASKS, VARIANTS, Variant
from tissue.perception.magnitude import MAGNITUDE_FORCES_N, fit_magnitudes
from tissue.perception.observer import PARAMETERS, Observer, write_observer
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion
from tissue.simulation.reference_force import ideal_force_N
from tissue.simulation.simulate import TICK_S, simulate

__all__ = ["Row", "Trial", "TrialScene", "error_sentence", "failures_of", "run_trial", "trial_scene", "trial_seed"]

Row = dict[str, str | float]
"""A method's name and its metrics, or the sentence of its failure."""

PACE_SPREAD, WITHIN_SPREAD = 0.15, 0.05
"""Spread of the logarithm of people's pace, and of one person's from trial to trial; assumed."""
NUMBERS = 24
"""Numbers that a person gave to forces when they were calibrated."""
PLAIN = Variant("", "", {})


@dataclass(frozen=True)
class Trial:
    """What came of a trial.

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
        """Whether a method failed in it."""
        return any("failure" in row for row in self.rows)

    def values(self, metric: str) -> dict[str, float]:
        """A metric by the methods that have it."""
        return {str(row["method"]): float(row[metric]) for row in self.rows if metric in row}


@dataclass(frozen=True)
class TrialScene:
    """What a trial is made of.

    Attributes
    ----------
    scenes
        The scene under each method. The coupling stiffness is the smallest of those chosen for the methods. It is
        stable under all methods, so that their forces can be compared.
    specimen
        Number of the specimen.
    person
        Who feels, known exactly; the scene with perception has only what their calibration knows of them.
    pace
        Factor on the speed of a path, or on the rise of a force.
    """

    scenes: Mapping[str, Scene]
    specimen: int
    person: Observer
    pace: float


def run_trial(plan: Plan, key: TrialKey) -> Trial:
    """Run a trial under every method of its plan; one that fails leaves its sentence, and the others go on.

    Alone it gives what it gives in its study: ``run_trial(Plan(seed=0), TrialKey.named("T1-novice-0007"))``.
    """
    started = perf_counter()
    rows: list[Row] = []
    trial: TrialScene | None = None
    with tempfile.TemporaryDirectory() as folder:
        for method in _methods(plan, key):
            try:
                trial = trial or trial_scene(plan, key, Path(folder) / f"{method}.json")
                rows.append({"method": method, **_metrics(trial, method, key)})
            except Exception as error:  # a trial that fails must not take the study with it, whatever the fault
                rows.append({"method": method, "failure": error_sentence(error)})
    return Trial(key, trial_seed(plan, key), tuple(rows), perf_counter() - started)


def failures_of(trials: Iterable[Trial]) -> dict[str, list[str]]:
    """Names of trials by method and sentence of a failure; one that happened at another time is the same."""
    found: dict[str, list[str]] = {}
    for trial in trials:
        for row in trial.rows:
            if "failure" in row:
                what = re.sub(r"\b[\d.e+-]+ s\b", "... s", str(row["failure"]))
                found.setdefault(f"{row['method']}: {what}", []).append(trial.key.name)
    return found


def trial_seed(plan: Plan, key: TrialKey) -> int:
    """Seed of a trial's scenes."""
    return int(plan.rng(key).integers(2**62))


def error_sentence(error: Exception) -> str:
    """Kind and words of an error on one line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())}"


def trial_scene(plan: Plan, key: TrialKey, observer: Path) -> TrialScene:
    """Scenes of a trial, and its person, whose calibration is written to a file."""
    rng, person, task = plan.rng(key), plan.person(key), TASKS[key.task]
    variant = VARIANTS.get(key.variant, PLAIN)
    seed = int(rng.integers(2**62))
    pace = variant.pace * float(np.exp(PACE_SPREAD * person.standard_normal() + WITHIN_SPREAD * rng.standard_normal()))
    truth, known = _calibrated(key, person)
    write_observer(known, observer)
    specimen = int(rng.integers(len(task.specimens)))
    met = task.specimens[specimen] if variant.extreme is None else task.extremes[variant.extreme]
    scene = changed(load_scene(task.scene), {**task.changes, **met})
    assert isinstance(scene.motion, PathMotion)
    per_trial = {
        "seed": seed,
        "motion.feed_mm_s": round(pace * scene.motion.feed_mm_s, 3),
        "coupling.force_scale": min(map(_force_scale, (scene, *_all_specimens(key.task)))),
    }
    by_hand = {"device": "touch", "hand": key.group, "coupling.delay_ms": LATENCY_MS, **variant.changes}
    scene = changed(scene, by_hand)
    felt = {name: {"perception": f"observer:{observer}"} if name in PERSONAL else {} for name in METHODS}
    scenes = {name: changed(scene, {**method, **felt[name]}) for name, method in METHODS.items()}
    common_N_m = min(floor(_stiffness_N_m(each)) for each in scenes.values())
    for name, scene in scenes.items():
        scenes[name] = changed(scene, {**per_trial, "coupling.stiffness_N_m": common_N_m})
    return TrialScene(scenes, specimen, truth, pace)


@lru_cache(maxsize=64)
def _force_scale(scene: Scene) -> float:
    """Newtons at the device for each newton at the tool that are chosen for a scene on the device of the study.

    The least over a task's specimens is taken for all of them: a scale for each would play them all alike.
    """
    return chosen_scale(changed(scene, {"device": "touch"}))[0]


def _all_specimens(task: str) -> list[Scene]:
    """Scenes of a task with each of its specimens."""
    usual = TASKS[task]
    return [changed(load_scene(usual.scene), {**usual.changes, **each}) for each in usual.specimens]


@lru_cache(maxsize=64)
def _stiffness_N_m(scene: Scene) -> float:
    """Stiffness that is chosen for a scene [N/m]; neither seed nor pace counts, so that few are ever asked for."""
    return judged_loop(loop_settings(scene), step_s=TICK_S).stiffness_N_m


def _calibrated(key: TrialKey, rng: np.random.Generator) -> tuple[Observer, Observer]:
    """A person, and what the map fitted to their numbers; thresholds are known as they are."""
    drawn = draw_observers(key.group, 1, rng)
    name = f"{key.group} {key.user}"
    alpha, beta, kappa, offset_N, lapse, sigma = (float(getattr(drawn, each)[0]) for each in PARAMETERS)
    truth = Observer.known(name, alpha=alpha, beta=beta, kappa=kappa, offset_N=offset_N, lapse=lapse, sigma=sigma)
    forces = np.resize(MAGNITUDE_FORCES_N, NUMBERS)
    fit = fit_magnitudes(forces, np.array([drawn.number(force, rng)[0] for force in forces]))
    mean, covariance = truth.mean.copy(), truth.covariance.copy()
    mean[:2], covariance[:2, :2] = fit.mean, fit.covariance
    return truth, Observer(name=name, mean=mean, covariance=covariance, trials=NUMBERS)


def _methods(plan: Plan, key: TrialKey) -> tuple[str, ...]:
    """Methods of a trial; variants are run for the headline alone, the reference under one."""
    if not key.variant:
        return plan.methods
    wanted = ("penalty",) if key.variant == REFERENCE else ("penalty", "koopman")
    return tuple(method for method in plan.methods if method in wanted) or plan.methods[:1]


def _metrics(trial: TrialScene, method: str, key: TrialKey) -> dict[str, float]:
    """Metrics of a trial under one method."""
    scene, person = trial.scenes[method], trial.person
    if key.task == "needle":
        run = pierce(scene, kappa=person.kappa, offset_N=person.offset_N, rate_N_s=trial.pace * RATE_N_S).run
    else:
        run = simulate(scene, cores=1)
    if key.variant == REFERENCE:
        prompt = ideal_force_N(run, cores=1)
        converged = ideal_force_N(run, finest(run.scene, quick=True), cores=1)
        return {"reference_error": metrics.force_error(prompt, converged)}
    assert isinstance(run.scene.motion, PathMotion)
    wanted = np.array(TASKS[key.task].wanted_mm or run.scene.motion.points_mm)
    return measured(run, key.task, person, wanted_mm=wanted) | {"specimen": float(trial.specimen)}
