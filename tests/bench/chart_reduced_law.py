"""Methods to follow a hyperelastic organ at 1 kHz: `python tests/bench/chart_reduced_law.py --out DIR [--speeds 20 100]`.

The press of `chart_law`, neo-Hookean, Poisson's ratio 0.45, moving at each speed and at rest: by the linear law, by the
offset that is solved between ticks, by reduced models of several sizes, and by Newton's method, which is the reference.
Errors of the force while it moves and at rest and of the surface's displacement at rest; processor time of a tick and of
what is done between ticks, in one run of one core. Writes `reduced_law.csv` and `reduced_law.png`.
"""

import argparse
import csv
from pathlib import Path
from time import thread_time

import numpy as np
from harness import machine, table  # adds the fixtures to the path
from pressed_deep import DEPTHS_M, by_newton, scene_of, surface_error

from tissue.models.organ.model import LiverModel
from tissue.scene.load import changed
from tissue.simulation.simulate import simulate

RATIO = 0.45
METHODS = {
    "linear": [{}],
    "offset": [
        {"law_edge_ratio": 1.0},
        {},
        {"law_interval_ms": 100.0},
    ],
    "reduced": [
        {"law_basis_size": 24},
        {},
        {"law_basis_size": 60},
        {"law_sampling_error": 0.1},
    ],
}
"""Entries of [organ] by which each method differs from what it does unless notices otherwise."""
HEAD = ("method", "set", "speed mm/s", "modes", "points", "set-up s", "tick us", "99 %", "between ms", "99 %", "moving %",
        "at rest %", "surface %", "notices")  # fmt: skip
TOUCHED_N = 1e-3
"""Force from which a tick counts."""


def measured(scene):
    """A run, processor time of its set-up [s], of its ticks in contact [s], and between these [s]."""
    ticks, between, started = [], [], thread_time()
    first: list[float] = []
    plain = LiverModel.advance, LiverModel.respond, LiverModel.wait_for_background

    def advance(self, motion):
        first.append(thread_time()) if not first else None
        start = thread_time()
        plain[0](self, motion)
        ticks.append(thread_time() - start)

    def wait(self, time_s):
        start = thread_time()
        plain[2](self, time_s)
        between.append(thread_time() - start)

    LiverModel.advance, LiverModel.wait_for_background = advance, wait
    try:
        run = simulate(scene, cores=1)
    finally:
        LiverModel.advance, LiverModel.wait_for_background = plain[0], plain[2]
    touched = run.trace["force_z_N"][: len(ticks)] > TOUCHED_N
    return run, first[0] - started, np.array(ticks)[touched], np.array(between)[: len(touched)][touched]


def row_of(method, speed, change, exact):
    """What a method costs and how far off it is."""
    law = {} if method == "linear" else {"law": "neo-hookean"}
    if method == "reduced":
        law["law_method"] = "reduced"
    scene = changed(scene_of(poisson_ratio=RATIO, **law, **change), {"motion.feed_mm_s": float(speed)})
    run, set_up_s, ticks, between = measured(scene)
    force_N, depth_m = run.trace["force_z_N"], -1e-3 * run.trace["tool_z_mm"]
    down = int(np.argmax(depth_m >= DEPTHS_M[-1])) + 1
    moving_N = np.interp(DEPTHS_M, depth_m[:down], force_N[:down])
    moving = np.linalg.norm(moving_N - exact.force_N) / np.linalg.norm(exact.force_N)
    rest = abs(force_N[-1] / exact.force_N[-1] - 1.0)
    few = run.parts.tissue._law if method == "reduced" else None
    size = (few._body.size, len(few._body.points)) if few else (0, 0)
    done = between[between > 1e-4]
    took = [1e3 * np.percentile(done, share) for share in (50, 99)] if len(done) else [0.0, 0.0]
    what = ", ".join(f"{name.removeprefix('law_')} {value:g}" for name, value in change.items()) or "as shipped"
    notices = "; ".join(each for _, each in run.events if "law" in each and "solving the law took" not in each)
    row = [method, what, float(speed), *size, set_up_s, *(1e6 * np.percentile(ticks, share) for share in (50, 99)),
           *took, 100.0 * moving, 100.0 * rest, 100.0 * surface_error(run, exact), notices]  # fmt: skip
    print(row, flush=True)
    return row


def draw(rows, speeds, path):
    """Errors over the time of a tick, 99 of 100, and that of the fastest press over what is done between ticks."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"font.size": 13})
    figure, axes = pyplot.subplots(2, 3, figsize=(19, 12), layout="constrained")
    moving = "force moving at {:g} mm/s, error / %"
    tick = "processor time of a tick, 99 % / us"
    shown = [(7, tick, moving.format(speed), 10, speed) for speed in (speeds[0], speeds[-1])]
    shown += [
        (7, tick, "force at rest, error / %", 11, speeds[0]),
        (7, tick, "surface at rest, error / %", 12, speeds[0]),
    ]
    shown += [(9, "processor time between two ticks, 99 % / ms", moving.format(speed), 10, speed)
              for speed in (speeds[0], speeds[-1])]  # fmt: skip
    looks = {"linear": ("0.4", "D"), "offset": ("#0072B2", "o"), "reduced": ("#D55E00", "s")}
    for axis, (place, across, label, column, speed) in zip(axes.ravel(), shown, strict=True):
        for method, (colour, marker) in looks.items():
            some = [row for row in rows if row[0] == method and row[2] == speed and row[place] > 0.0]
            some.sort(key=lambda row: row[place])
            axis.plot([row[place] for row in some], [row[column] for row in some], color=colour, marker=marker,
                      markersize=10, linestyle="none", label=method)  # fmt: skip
            for number, row in enumerate(some):
                axis.annotate(
                    row[1].replace("_", " "), (row[place], row[column]), textcoords="offset points",
                    xytext=(9, 7 if number % 2 else -13), fontsize=10, color=colour,
                )  # fmt: skip
        axis.axhline(2.0, color="0.6", linestyle="--")
        axis.axvline(800.0 if place == 7 else 0.8, color="0.6", linestyle="--")
        axis.set(xscale="log", yscale="log", xlabel=across, ylabel=label)
        axis.grid(True, which="major", color="0.92")
        axis.margins(x=0.3)
    axes[0, 0].legend(frameon=False)
    figure.savefig(path, dpi=60)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--speeds", type=float, nargs="+", default=[20.0, 100.0], help="of the tool [mm/s]")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    print(machine())
    exact = by_newton(scene_of(law="neo-hookean", poisson_ratio=RATIO))
    rows = [
        row_of(method, speed, change, exact)
        for speed in asked.speeds
        for method, changes in METHODS.items()
        for change in changes
    ]
    with (asked.out / "reduced_law.csv").open("w", newline="") as file:
        csv.writer(file).writerows([HEAD, *rows])
    text = [[f"{value:.3g}" if isinstance(value, float) else str(value) for value in row] for row in rows]
    print(table(text, HEAD))
    draw(rows, asked.speeds, asked.out / "reduced_law.png")


if __name__ == "__main__":
    main()
