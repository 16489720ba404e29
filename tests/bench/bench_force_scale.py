"""Sensitivity d' to softer tissue over the force scale, simulated and expected.

Run: `python tests/bench/bench_force_scale.py [--device touch] [--people 3] [--scale C ...] \
[--exponent 1.2] [TASK ...]`.

For each of the study's tasks T1 (palpation), T2 (wall) and T3 (milling), simulated people of the
middle group feel the softer and the middle specimen. Printed are the mean forces at the skin in
contact, the d' of simulated observers for these means, and the d' that
`tissue.simulation.builders.force_scale` expects, for the same ratio of stiffnesses.

With `--exponent 1.2` the same forces are mapped by limit (F / limit)^1.2, where the limit is the
knee of the device's range. Printed is the change of d' if the map is applied to the forces of the
unchanged runs (open loop), and if the runs are repeated with the map (closed loop).
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from harness import machine, table

from tissue.evaluation.calibration.observers import (
    SimulatedObservers,
    Stimulus,
    draw_observers,
    sensitivity,
)
from tissue.evaluation.study.plan import TASKS
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.filters import ForceRange
from tissue.perception.observer import Observer, reference_observer, write_observer
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.simulation.builders.force_scale import STIFFER, Series, chosen_scale, expected_force
from tissue.simulation.simulate import simulate

OBSERVERS = 200
SCALES = {
    "T1": (0.07, 0.14, 0.25, 0.5, 1.0, 2.0, 4.0),
    "T2": (0.003, 0.01, 0.02, 0.03, 0.05, 0.1, 0.3, 1.0),
    "T3": (0.01, 0.02, 0.04, 0.08, 0.16),
}
RATIO = {"T1": 0.7, "T2": 0.7, "T3": 0.6}
"""Stiffness of the softer specimen over that of the middle one."""


def skin_N(scene: Scene) -> float:
    """Return the mean force at the skin of a run while the tool is in contact [N]."""
    trace = simulate(scene).trace
    # The hand's force is that of the tick before each row.
    force = np.linalg.norm(trace.vectors("hand_force", "N")[1:], axis=1)
    touches = trace.vectors("model_force", "N")[:-1].any(axis=1)
    return float(force[touches].mean())


def mean_skin_N(scene: Scene, people: int) -> float:
    """Return the mean of `skin_N` over people, each with a seed."""
    return float(np.mean([skin_N(changed(scene, {"seed": seed})) for seed in range(people)]))


def d_prime(observers: SimulatedObservers, soft_N: float, middle_N: float) -> float:
    """Return the mean d', negative if the stiffer specimen has the smaller force."""
    found = sensitivity(observers, Stimulus(soft_N), Stimulus(middle_N)).mean()
    return float(found * np.sign(middle_N - soft_N))


def observer_with(exponent: float, folder: Path) -> str:
    """Return the perception whose map to the reference has an exponent.

    Its thresholds are so small that the deadband holds nothing back.
    """
    reference = reference_observer()
    one = Observer.known(
        "mapped",
        alpha=1.0,
        beta=reference.beta / exponent,
        kappa=1e-3,
        offset_N=reference.offset_N,
        lapse=reference.lapse,
        sigma=reference.sigma,
    )
    write_observer(one, folder / "observer.json")
    return f"observer:{folder / 'observer.json'}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=list(SCALES))
    parser.add_argument("--device", default="touch")
    parser.add_argument("--people", type=int, default=3)
    parser.add_argument("--scale", type=float, nargs="*")
    parser.add_argument("--exponent", type=float)
    given = parser.parse_args()
    print(machine())
    observers = draw_observers("intermediate", OBSERVERS, np.random.default_rng(0))
    with tempfile.TemporaryDirectory() as folder:
        mapped = observer_with(given.exponent, Path(folder)) if given.exponent else ""
        for name in given.tasks:
            measure(name, given, observers, mapped)


def measure(
    name: str, given: argparse.Namespace, observers: SimulatedObservers, mapped: str
) -> None:
    """Print the table of one task; `mapped` is the perception of the mapped runs."""
    task = TASKS[name]
    by_hand = {"device": given.device, "hand": "intermediate"}
    soft, middle = (
        changed(load_scene(task.scene), {**task.changes, **each, **by_hand})
        for each in task.specimens[:2]
    )
    met = expected_force(middle)
    limits = device_parameters(given.device, middle.constants)
    series = Series.of(limits, middle.constants)
    device = ForceRange(limit_N=limits.force_limit_N)
    knee_N = device.knee_N
    ratio = np.log(RATIO[name]) / -np.log(STIFFER)
    rows = []
    for scale in given.scale or SCALES[name]:
        scenes = [changed(each, {"coupling.force_scale": scale}) for each in (soft, middle)]
        felt = [mean_skin_N(each, given.people) for each in scenes]
        found = d_prime(observers, *felt)
        expected = ratio * series.sensitivity(met, scale) if met.stiffness_N_m else np.nan
        row = [
            name,
            f"{scale:g}",
            f"{felt[0]:.3f}",
            f"{felt[1]:.3f}",
            f"{found:.2f}",
            "-" if np.isnan(expected) else f"{expected:.2f}",
        ]
        if mapped:
            levels = [knee_N * (each / knee_N) ** given.exponent for each in felt]
            closed = [
                mean_skin_N(changed(each, {"perception": mapped}), given.people) for each in scenes
            ]
            row += [
                f"{100.0 * (d_prime(observers, *each) / found - 1.0):+.1f}"
                for each in (levels, closed)
            ]
        rows.append(tuple(row))
    auto = changed(middle, {"coupling.force_scale": "auto"})
    rows.append((name, f"auto: {chosen_scale(auto).factor:g}", *[""] * (len(rows[0]) - 2)))
    head: tuple[str, ...] = (
        "task",
        "scale",
        "softer / N",
        "middle / N",
        "d' simulated",
        "d' expected",
    )
    if mapped:
        head += ("open loop %", "closed loop %")
    print(table(rows, head))


if __name__ == "__main__":
    main()
