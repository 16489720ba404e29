"""Error that each refinement of the cutting law buys, and its cost.

Run: `python tests/bench/bench_law.py [--rounds N] [SCENE ...]`.

Each scene runs as it is, with one refinement left out, and on its coarsest voxels without any. The
error is that of the force against the scene's own law on the exact geometry, along the motion of
the run. It is not an error against measured forces. The runs take turns. The cost is the median
tick in contact over that of the refined run of the same round, as the median of the rounds.
`--exponent M` gives bone a size effect.
"""

import argparse

import numpy as np
from harness import machine, table

from tissue.evaluation.charts.measure import force_and_reference_N, short_of
from tissue.evaluation.charts.settings import Setting, settings_of
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.load import changed, load_scene
from tissue.scene.scene import Scene
from tissue.simulation.run import Run
from tissue.simulation.simulate import simulate

SCENES = ("milling", "pedicle", "glenoid", "molar")


def run_at(scene: Scene, setting: Setting) -> Run:
    """Run a scene at a setting on one core."""
    return simulate(changed(scene, setting.changes), cores=1)


def tick_us(run: Run) -> float:
    """Return the median tick in contact [us], without the first ticks, which load code."""
    touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)[20:]
    return float(np.median(run.timing["tick_us"][touching]))


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
        force_N, reference_N = force_and_reference_N(runs[0][index], scene, quick=True)
        ticks = np.array([tick_us(each[index]) for each in runs])
        refined = np.array([tick_us(each[0]) for each in runs])
        error = 100.0 * force_error(force_N, reference_N)
        cost = float(np.median(ticks / refined))
        rows.append((name, setting.name, f"{error:.2g}", f"{cost:.2f}", f"{np.median(ticks):.0f}"))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--exponent", type=float)
    arguments = parser.parse_args()
    rows = []
    for name in arguments.scenes or SCENES:
        rows += compare(name, arguments.rounds, arguments.exponent)
    head = ("scene", "setting", "error %", "tick over refined", "tick us")
    print(machine() + "\n\n" + table(rows, head))


if __name__ == "__main__":
    main()
