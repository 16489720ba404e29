"""Excess travel of a needle after a puncture.

It is given by noticed signal, latency, prediction, and a cue before the puncture.

The needle of the scene ``needle`` is pushed through the capsule by an intermediate's hand on a
Touch. The measures are defined in `tissue.evaluation.study.puncture`. Each seed is a person with a
force threshold, pace, noise and tremor; all cells have the same persons. At each latency all cells
have the coupling that is stable with every predictor, except for rows that name another one.

Run: python tests/bench/bench_puncture.py [--seeds 20] [--workers 2] [--out FOLDER]. It prints a
table with means and 95 % intervals over seeds (t), and draws puncture.png. It writes every run to
runs.csv, from which an interrupted call continues.
"""

import argparse
import csv
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from math import floor, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
from harness import machine, table

from tissue.evaluation.calibration.observers import draw_observers
from tissue.evaluation.study.plan import TASKS
from tissue.evaluation.study.puncture import RATE_N_S, Pierced, pierce
from tissue.evaluation.study.trial import PACE_SPREAD
from tissue.scene.load import load_scene
from tissue.simulation.builders.loop import judged_loop, loop_settings
from tissue.simulation.simulate import TICK_S

SCENE = {"device": "touch", "hand": "intermediate", **TASKS["needle"].changes}
LATENCIES_MS, PREDICTIONS = (0, 4, 8, 16), ("none", "koopman")
COLUMNS = ("excess_mm", "noticed_ms", "puncture_s", "early")


class Cell(NamedTuple):
    """Conditions of runs, and the stiffness of their coupling [N/m]."""

    notice: str
    cue: bool
    prediction: str
    latency_ms: int
    stiffness_N_m: int


def cells() -> list[Cell]:
    """Return all cells: the grid, an ideal reaction, and two kinds of coupling.

    The ideal reaction is one that no person can have. The couplings are each predictor's stiffest
    one and one coupling for all latencies.
    """
    found = {}
    for prediction, latency in product(PREDICTIONS, LATENCIES_MS):
        scene = load_scene(
            "needle", SCENE | {"prediction": prediction, "coupling.delay_ms": latency}
        )
        found[prediction, latency] = floor(
            judged_loop(loop_settings(scene), step_s=TICK_S).stiffness_N_m
        )
    shared = {
        latency: min(found[each, latency] for each in PREDICTIONS) for latency in LATENCIES_MS
    }
    grid = product(("force", "sight"), (False, True), PREDICTIONS, LATENCIES_MS)
    listed = [Cell(*each, shared[each[-1]]) for each in grid]
    listed += [Cell("at once", False, "none", latency, shared[latency]) for latency in LATENCIES_MS]
    listed += [Cell("force", False, each, latency, found[each, latency]) for each, latency in found]
    listed += [
        Cell("force", False, "none", latency, min(shared.values())) for latency in LATENCIES_MS
    ]
    return list(dict.fromkeys(listed))


def pushed(cell: Cell, seed: int) -> Pierced:
    """A run of a cell by the person of a seed."""
    rng = np.random.default_rng([seed, 18])
    person = draw_observers("intermediate", 1, rng)
    rate = RATE_N_S * float(np.exp(PACE_SPREAD * rng.standard_normal()))
    scene = load_scene(
        "needle",
        SCENE
        | {
            "seed": seed,
            "prediction": cell.prediction,
            "coupling.delay_ms": cell.latency_ms,
            "coupling.stiffness_N_m": cell.stiffness_N_m,
        },
    )
    kappa, offset = float(person.kappa[0]), float(person.offset_N[0])
    return pierce(
        scene, kappa=kappa, offset_N=offset, notice=cell.notice, cue=cell.cue, rate_N_s=rate
    )  # type: ignore[arg-type]


def measured(job: tuple[Cell, int]) -> tuple[Cell, int, list[float]]:
    """Return the results of a run, in the order of `COLUMNS`."""
    run = pushed(*job)
    noticed = 1e3 * (run.noticed_s - run.puncture_s)
    return *job, [run.excess_mm, noticed, run.puncture_s, float(run.early)]


def all_runs(
    listed: Sequence[Cell], seeds: int, workers: int, path: Path
) -> dict[tuple[Cell, int], list[float]]:
    """All runs; those that a file holds are not run again."""
    found: dict[tuple[Cell, int], list[float]] = {}
    if path.exists():
        for row in csv.reader(path.open(encoding="utf-8", newline="")):
            cell = Cell(row[0], row[1] == "True", row[2], int(row[3]), int(row[4]))
            found[cell, int(row[5])] = [float(each) for each in row[6:]]
    left = [(cell, seed) for seed in range(seeds) for cell in listed if (cell, seed) not in found]
    with ProcessPoolExecutor(workers) as pool, path.open("a", encoding="utf-8", newline="") as file:
        for cell, seed, values in pool.map(measured, left):
            found[cell, seed] = values
            csv.writer(file).writerow([*cell, seed, *values])
            file.flush()
    return found


def interval(values: Iterable[float]) -> tuple[float, float]:
    """Mean and half of its 95 % interval by t."""
    from scipy.stats import t

    kept = np.array([each for each in values if np.isfinite(each)])
    if len(kept) < 2:
        return float("nan"), float("nan")
    return float(kept.mean()), float(
        t.ppf(0.975, len(kept) - 1) * kept.std(ddof=1) / sqrt(len(kept))
    )


def report(listed: Sequence[Cell], found: dict[tuple[Cell, int], list[float]], seeds: int) -> None:
    """Print the table of cells with paired differences.

    Each difference is taken to the cell without prediction and without a cue.
    """
    rows = []
    for cell in listed:
        runs = np.array([found[cell, seed] for seed in range(seeds)])
        plain = cell._replace(cue=False, prediction="none")
        mean, half = interval(runs[:, 0])
        change = ""
        if plain != cell and plain in listed:
            shift, reach = interval(
                runs[:, 0] - np.array([found[plain, seed][0] for seed in range(seeds)])
            )
            change = f"{shift:+.2f} ± {reach:.2f}"
        noticed = interval(runs[runs[:, 3] == 0.0, 1])
        rows.append(
            (
                cell.notice,
                "cue" if cell.cue else "",
                cell.prediction,
                str(cell.latency_ms),
                str(cell.stiffness_N_m),
                f"{mean:.2f} ± {half:.2f}",
                change,
                f"{noticed[0]:.0f}",
                str(int(runs[:, 3].sum())),
                str(int(np.isposinf(runs[:, 1]).sum())),
            )
        )
    head = (
        "noticed by",
        "cue",
        "prediction",
        "latency ms",
        "coupling N/m",
        "excess mm",
        "change mm",
        "noticed ms",
        "early",
        "missed",
    )
    print(table(rows, head))


def draw(
    listed: Sequence[Cell], found: dict[tuple[Cell, int], list[float]], seeds: int, path: Path
) -> None:
    """The tip's travel of one person around the puncture, and the excess over latency."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    colours = {"force": "#D55E00", "sight": "#0072B2", "at once": "#555555"}
    chosen = [each for each in listed if each.prediction == "none"]
    shared = {each.latency_ms: each.stiffness_N_m for each in chosen if each.notice == "at once"}
    for cell in (
        each for each in chosen if each.latency_ms == 4 and each.stiffness_N_m == shared[4]
    ):
        run = pushed(cell, 0)
        since = 1e3 * (run.run.trace["time_s"] - run.puncture_s)
        depth = -run.run.trace["tool_z_mm"]
        depth = depth - depth[round(run.puncture_s / TICK_S)]
        style = "--" if cell.cue else "-"
        label = {
            "force": "by force",
            "sight": "by force or sight",
            "at once": "stopped at the puncture",
        }[cell.notice]
        left.plot(
            since,
            depth,
            style,
            color=colours[cell.notice],
            label=label + ", after a cue" * cell.cue,
        )
        if cell.notice != "at once":
            at = 1e3 * (run.stop_s - run.puncture_s)
            left.plot(
                at,
                np.interp(at, since, depth),
                "o",
                color=colours[cell.notice],
                mfc="none" if cell.cue else None,
            )
    left.set(
        xlim=(-200, 700),
        ylim=(-2, 9),
        xlabel="time since the puncture ms",
        ylabel="travel of the tip since the puncture mm",
        title="one person, 4 ms; a circle is the stop",
    )
    left.legend(frameon=False, fontsize=8)
    lines = (
        ("force", False, "none"),
        ("force", False, "koopman"),
        ("force", True, "none"),
        ("sight", False, "none"),
        ("sight", True, "none"),
        ("at once", False, "none"),
    )
    for index, (notice, cue, prediction) in enumerate(lines):
        means = [
            interval(
                found[Cell(notice, cue, prediction, each, shared[each]), seed][0]
                for seed in range(seeds)
            )
            for each in LATENCIES_MS
        ]
        name = {"force": "by force", "sight": "by force or sight", "at once": "at the puncture"}[
            notice
        ]
        right.errorbar(
            np.array(LATENCIES_MS) + 0.12 * (index - 2.5),
            [each[0] for each in means],
            [each[1] for each in means],
            color="#009E73" if prediction != "none" else colours[notice],
            ls="--" if cue else "-",
            marker="o",
            ms=4,
            capsize=2,
            label=name + ", after a cue" * cue + ", Koopman" * (prediction != "none"),
        )
    right.set(
        xlabel="latency ms",
        ylabel="excess travel mm (95 %)",
        title=f"{seeds} people",
        ylim=(0, None),
    )
    right.set_xticks(LATENCIES_MS, [f"{each}\n{shared[each]} N/m" for each in LATENCIES_MS])
    right.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("puncture"))
    given = parser.parse_args()
    print(machine())
    given.out.mkdir(parents=True, exist_ok=True)
    listed = cells()
    found = all_runs(listed, given.seeds, given.workers, given.out / "runs.csv")
    report(listed, found, given.seeds)
    draw(listed, found, given.seeds, given.out / "puncture.png")


if __name__ == "__main__":
    main()
