"""Error and cost of a hyperelastic law that is solved in a region around the contact.

Run: `python tests/bench/bench_law_region.py [--scene liver-press] [--law neo-hookean]
[--seconds 1.2] [--regions 1 1.5 2] [--modes 24 48 96]`.

The scene runs as it is under the linear law, under the law in regions of several radii, and under
the law in the whole organ, which is the reference. With `--modes`, the region of the scene also
runs with other numbers of modes of its border. Printed: the error of the force (RMS over the
ticks in contact, and the largest one, over the largest force of the reference), the error of the
displacement of the touched surface at the end (L2), processor time of a solve, and the share of
ticks for which the offset would be older than its interval on this machine.
"""

import argparse
import os
from dataclasses import replace
from time import thread_time

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
from harness import machine, table  # noqa: E402

from tissue.fem import region  # noqa: E402
from tissue.models.organ.law import LawOffset  # noqa: E402
from tissue.models.organ.model import OrganModel  # noqa: E402
from tissue.scene.load import load_scene  # noqa: E402
from tissue.simulation.builders.organ import REGION  # noqa: E402
from tissue.simulation.run import Run  # noqa: E402
from tissue.simulation.simulate import simulate  # noqa: E402

LAWS: dict[str, dict[str, object]] = {
    "neo-hookean": {},
    "mooney-rivlin": {"second_share": 0.3},
    "yeoh": {"square_ratio": 0.5, "cube_ratio": 0.5},
    "ogden": {"exponent": 8.0},
    "exponential": {},
}


def run_with(
    changes: dict[str, object], scene: str, region_m: float, modes: int
) -> tuple[Run, np.ndarray]:
    """Run a scene with a region and return the run and the processor time of each solve [s]."""
    spare = region.LOADS - region.MODES
    region.MODES, region.LOADS = modes, modes + spare
    took_s: list[float] = []
    make, solve = OrganModel.__init__, LawOffset.solve

    def make_with(self, organ, *positional, **named):
        if organ.law is not None:
            organ.law = replace(organ.law, region_m=region_m)
        make(self, organ, *positional, **named)

    def timed(self, *arguments):
        started = thread_time()
        solved = solve(self, *arguments)
        took_s.append(thread_time() - started)
        return solved

    OrganModel.__init__, LawOffset.solve = make_with, timed
    try:
        run = simulate(load_scene(scene, changes), cores=1)
    finally:
        OrganModel.__init__, LawOffset.solve = make, solve
    return run, np.array(took_s)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scene", default="liver-press")
    parser.add_argument("--law", default="neo-hookean", choices=LAWS)
    parser.add_argument("--seconds", type=float, default=1.2)
    parser.add_argument("--regions", type=float, nargs="*", default=[1.0, 1.5, 2.0])
    parser.add_argument("--modes", type=int, nargs="*", default=[])
    parser.add_argument("--set", nargs="*", default=[], help="key=value, numbers only")
    arguments = parser.parse_args()
    plain: dict[str, object] = {
        "organ.law": "linear",
        "organ.interval_ms": 0.0,
        "duration_s": arguments.seconds,
    }
    for pair in arguments.set:
        key, value = pair.split("=")
        plain[key] = float(value)
    lawful = plain | {"organ.law": arguments.law}
    lawful |= {f"organ.{key}": value for key, value in LAWS[arguments.law].items()}
    radius_m = 0.5e-3 * load_scene(arguments.scene).tool.size_mm
    shipped = region.MODES
    kinds = [("whole", lawful, np.inf, shipped), ("linear", plain, np.inf, shipped)]
    kinds += [(f"{each:g} R", lawful, each * radius_m, shipped) for each in arguments.regions]
    kinds += [
        (f"{REGION:g} R, {each} modes", lawful, REGION * radius_m, each) for each in arguments.modes
    ]
    print(machine())
    rows = []
    for name, changes, region_m, modes in kinds:
        run, took_s = run_with(changes, arguments.scene, region_m, modes)
        force_N = run.trace.vectors("force", "N")
        moved_m = run.parts.tissue.displacement_m()
        if name == "whole":
            exact_N, exact_m = force_N, moved_m
            inside = np.linalg.norm(exact_m, axis=1) > 0.2 * np.linalg.norm(exact_m, axis=1).max()
        size_N = np.linalg.norm(exact_N, axis=1).max()
        off = np.linalg.norm(force_N - exact_N, axis=1)[np.linalg.norm(exact_N, axis=1) > 0.0]
        surface = np.linalg.norm((moved_m - exact_m)[inside]) / np.linalg.norm(exact_m[inside])
        times = ("", "", "")
        if len(took_s):
            late = np.maximum(took_s - 0.025, 0.0).sum() / np.maximum(took_s, 0.025).sum()
            times = (
                f"{1e3 * np.median(took_s):.1f}",
                f"{1e3 * np.percentile(took_s, 99):.0f}",
                f"{100 * late:.0f}",
            )
        rows.append(
            (
                name,
                f"{100 * np.sqrt(np.mean(off**2)) / size_N:.2f}",
                f"{100 * off.max() / size_N:.1f}",
                f"{100 * surface:.1f}",
                *times,
            )
        )
        print(rows[-1], flush=True)
    head = ("law in", "RMS %", "largest %", "surface %", "solve ms", "99 % ms", "late %")
    print("\n" + table(rows, head))


if __name__ == "__main__":
    main()
