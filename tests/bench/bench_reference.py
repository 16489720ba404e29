"""Error of scenes' cutting force against the reference on exact geometry.

Run: `python tests/bench/bench_reference.py SCENE ...`.

`python tests/bench/bench_reference.py glenoid caries voxels.spacing_mm=0.1` runs each
scene with the changes and prints its error over ticks, over 50 ms and on average in %, the
reference's own uncertainty, and the tick's cost. Stress is left out: the force does not depend on
it. The reference is computed once for each motion, anatomy and tool (a minute), then read from the
cache.
"""

import argparse
from time import perf_counter

import numpy as np
from harness import machine, table
from reference_errors import error_of_force

import tissue
from tissue.evaluation.reference.history import reference_force
from tissue.scene.load import parse_override


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "scenes", nargs="+", help="scenes, and changes such as voxels.spacing_mm=0.1"
    )
    arguments = parser.parse_args()
    changes = dict(parse_override(word) for word in arguments.scenes if "=" in word)
    rows = []
    for name in (word for word in arguments.scenes if "=" not in word):
        scene = tissue.load_scene(name, {**changes, "stress": None})
        run = tissue.simulate(scene, cores=1)
        start = perf_counter()
        reference = reference_force(scene, run.trace)
        seconds = perf_counter() - start
        force = run.trace.vectors("model_force", "N")
        error = error_of_force(force, reference)
        ticks = run.timing["tick_us"]
        percent = (error.over_ticks, error.over_50_ms, error.bias, error.reference_uncertainty)
        rows.append(
            (
                name,
                *(f"{100.0 * value:.2f}" for value in percent),
                f"{np.linalg.norm(reference.force_N, axis=1).max():.3g}",
                f"{seconds:.1f}",
                f"{np.median(ticks):.0f}",
                f"{np.percentile(ticks, 99):.0f}",
            )
        )
    head = (
        "scene",
        "ticks %",
        "50 ms %",
        "bias %",
        "own %",
        "peak N",
        "s",
        "tick us",
        "99 %",
    )
    print(machine())
    print(table(rows, head))


if __name__ == "__main__":
    main()
