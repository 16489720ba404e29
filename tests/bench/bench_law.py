"""Error that each refinement of the cutting law buys, and its cost.

Run: `python tests/bench/bench_law.py [--rounds N] [SCENE ...]`.

Each scene runs as it is, with one refinement left out, and on its coarsest voxels without any. The
error is that of the force against the scene's own law on the exact geometry, along the motion of
the run, at 32 ticks spread over the contact. It is not an error against measured forces. The runs take turns. The cost is the median
tick in contact over that of the refined run of the same round, as the median of the rounds.
`--exponent M` gives bone a size effect.
"""

import argparse

import numpy as np
from harness import machine, table

from tissue.evaluation.charts.measure import short_of
from tissue.evaluation.charts.settings import Setting, settings_of
from tissue.evaluation.reference.force import wrench_at
from tissue.evaluation.reference.history import path_of_trace, solid_of_scene
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.simulation.builders.cutting import cutter_of
from tissue.simulation.run import Run
from tissue.simulation.simulate import simulate

SCENES = ("milling", "pedicle", "glenoid", "molar")
EVALUATED = 32
"""Ticks at which the reference is evaluated.

A thrust moves the tool differently at each setting, and every motion has its own reference.
"""


def run_at(scene: Scene, setting: Setting) -> Run:
    """Run a scene at a setting on one core."""
    return simulate(changed(scene, setting.changes), cores=1)


def tick_us(run: Run) -> float:
    """Return the median tick in contact [us], without the first ticks, which load code."""
    touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)[20:]
    return float(np.median(run.timing["tick_us"][touching]))


def error_of(run: Run, scene: Scene) -> float:
    """Return the error of the force of a run against the law of a scene, on its motion."""
    cutter = cutter_of(scene.tool)
    solid = solid_of_scene(scene)
    path = path_of_trace(run.trace, cutter)
    touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)[20:]
    at = touching[np.linspace(0, len(touching) - 1, EVALUATED).astype(int)]
    reference_N = np.array([wrench_at(int(each), path, cutter, solid)[:3] for each in at])
    return force_error(run.trace.vectors("model_force", "N")[at], reference_N)


def compare(name: str, rounds: int, exponent: float | None) -> list[tuple[str, ...]]:
    """Return a row for each setting of a scene: error and cost."""
    changes: dict[str, object] = {"device": "none", "stress": None}
    if exponent is not None:
        changes["cutting.size_exponent"] = exponent
    scene = short_of(load_scene(name, changes), quick=True)
    simpler = [each for each in settings_of(scene, quick=True) if each.family == "cutting"]
    settings = [Setting("refined", "cutting"), *simpler]
    runs: list[list[Run]] = [[run_at(scene, each) for each in settings] for _ in range(rounds)]
    rows = []
    for index, setting in enumerate(settings):
        ticks = np.array([tick_us(each[index]) for each in runs])
        refined = np.array([tick_us(each[0]) for each in runs])
        error = 100.0 * error_of(runs[0][index], scene)
        cost = float(np.median(ticks / refined))
        rows.append((name, setting.name, f"{error:.2g}", f"{cost:.2f}", f"{np.median(ticks):.0f}"))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--exponent", type=float)
    arguments = parser.parse_args()
    head = ("scene", "setting", "error %", "tick over refined", "tick us")
    print(machine())
    for name in arguments.scenes or SCENES:
        rows = compare(name, arguments.rounds, arguments.exponent)
        print("\n" + table(rows, head), flush=True)


if __name__ == "__main__":
    main()
