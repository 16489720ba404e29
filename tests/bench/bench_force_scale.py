"""Sensitivity d' to softer tissue over the force scale, simulated and expected.

Run: `python tests/bench/bench_force_scale.py [--device touch] [--people 3] [--scale C ...] [TASK ...]`.

For each of the study's tasks T1 (palpation), T2 (wall) and T3 (milling), simulated people of the
middle group feel the softer and the middle specimen. Printed are the mean forces at the skin in
contact, the d' of simulated observers for these means, and the d' that
`tissue.simulation.builders.force_met` expects, for the same ratio of stiffnesses.
"""

import argparse

import numpy as np
from harness import machine, table

from tissue.evaluation.calibration.observers import Stimulus, draw_observers, sensitivity
from tissue.evaluation.study.plan import TASKS
from tissue.haptics.device.device import device_parameters
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.simulation.builders.force_met import STIFFER, Series, chosen_scale, force_met
from tissue.simulation.simulate import simulate

OBSERVERS = 200
SCALES = {
    "T1": (0.07, 0.14, 0.25, 0.5, 1.0, 2.0, 4.0),
    "T2": (0.003, 0.01, 0.02, 0.03, 0.05, 0.1, 0.3, 1.0),
    "T3": (0.01, 0.02, 0.04, 0.08, 0.16),
}
RATIO = {"T1": 0.7, "T2": 0.7, "T3": 0.9}
"""Stiffness of the softer specimen over that of the middle one."""


def skin_N(scene: Scene) -> float:
    """Return the mean force at the skin of a run while the tool is in contact [N]."""
    trace = simulate(scene).trace
    # The hand's force is that of the tick before each row.
    force = np.linalg.norm(trace.vectors("hand_force", "N")[1:], axis=1)
    touches = trace.vectors("model_force", "N")[:-1].any(axis=1)
    return float(force[touches].mean())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("tasks", nargs="*", default=list(SCALES))
    parser.add_argument("--device", default="touch")
    parser.add_argument("--people", type=int, default=3)
    parser.add_argument("--scale", type=float, nargs="*")
    given = parser.parse_args()
    print(machine())
    observers = draw_observers("intermediate", OBSERVERS, np.random.default_rng(0))
    rows = []
    for name in given.tasks:
        task = TASKS[name]
        by_hand = {"device": given.device, "hand": "intermediate"}
        soft, middle = (
            changed(load_scene(task.scene), task.changes | each | by_hand)
            for each in task.specimens[:2]
        )
        met = force_met(middle)
        series = Series.of(device_parameters(given.device, middle.constants), middle.constants)
        ratio = np.log(RATIO[name]) / -np.log(STIFFER)
        for scale in given.scale or SCALES[name]:
            felt = [
                np.mean(
                    [
                        skin_N(changed(each, {"coupling.force_scale": scale, "seed": seed}))
                        for seed in range(given.people)
                    ]
                )
                for each in (soft, middle)
            ]
            found = sensitivity(observers, Stimulus(felt[0]), Stimulus(felt[1])).mean()
            # A smaller force on the stiffer specimen is taken for a softer one.
            found *= np.sign(felt[1] - felt[0])
            expected = ratio * series.sensitivity(met, scale) if met.stiffness_N_m else np.nan
            rows.append(
                (
                    name,
                    f"{scale:g}",
                    f"{felt[0]:.3f}",
                    f"{felt[1]:.3f}",
                    f"{found:.2f}",
                    "-" if np.isnan(expected) else f"{expected:.2f}",
                )
            )
        auto = changed(middle, {"coupling.force_scale": "auto"})
        rows.append((name, f"auto: {chosen_scale(auto).factor:g}", "", "", "", ""))
    head = ("task", "scale", "softer / N", "middle / N", "d' simulated", "d' expected")
    print(table(rows, head))


if __name__ == "__main__":
    main()
