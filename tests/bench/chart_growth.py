"""Growth of tick time and memory with the size of a model.

Run: `python tests/bench/chart_growth.py --out DIR [--quick] [NAME ...]`.

Voxels, voxels under the tool, points of a cutter's shell, tetrahedra, touchable nodes, contact
points, particles, observables of a predictor, length of a run: each over two decades where memory
allows, with exponents fitted over all sizes and over the upper half. Memory is that of all arrays
that a model holds on to. `growth.csv` and `growth.png`.
"""

import argparse
import csv
import os
from pathlib import Path

# threads that wait for each other on a busy machine are no growth
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
import numpy as np
from growth_series import SERIES, Point
from harness import machine, table

ABOVE = 1.2
"""Exponent above which a growth has to be explained."""
BECAUSE = {
    (
        "tetrahedra, factorise",
        "time",
    ): "a factor of a body in space takes n^2 operations (George 1973); once a mesh",
    ("tetrahedra, factorise", "memory"): "and n^4/3 entries",
    (
        "touchable nodes, area",
        "memory",
    ): "the compliance is a full matrix; as much is reserved, not taken, for rows",
    (
        "touchable nodes, density",
        "memory",
    ): "the compliance is a full matrix; as much is reserved, not taken, for rows",
    (
        "touchable nodes, density",
        "time",
    ): "each point in touch moves every node near the tool: their product",
    (
        "observables, fit",
        "time",
    ): "normal equations: samples x observables^2, and eigenvalues: observables^3",
    ("observables, fit", "memory"): "an operator is a full matrix of observables",
    ("observables, tick", "memory"): "an operator is a full matrix of observables",
}
"""Reason for each growth exponent."""


def exponent(points: list[Point], of: str, *, upper: bool) -> float:
    """Slope of log time or memory over log size."""
    taken = points[len(points) // 2 - (len(points) < 4) :] if upper else points
    values = [point.time_us if of == "time" else point.memory for point in taken]
    return float(np.polyfit(np.log([point.size for point in taken]), np.log(values), 1)[0])


def draw(found: dict[str, list[Point]], path: Path) -> None:
    """Draw time and memory over the size, side by side."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"font.size": 11})
    colours = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "0.1")
    marks = "os^vDP"
    figure, axes = pyplot.subplots(1, 2, figsize=(13, 6.4), layout="constrained")
    for index, (name, points) in enumerate(found.items()):
        sizes = [point.size for point in points]
        look = {
            "color": colours[index % len(colours)],
            "marker": marks[index % len(marks)],
            "markersize": 5,
        }
        style = "-" if index < len(colours) else "--"
        time, memory = (exponent(points, of, upper=True) for of in ("time", "memory"))
        axes[0].plot(
            sizes,
            [point.time_us for point in points],
            style,
            **look,
            label=f"{name}: {time:.2f}, {memory:.2f}",
        )
        axes[1].plot(sizes, [1e-6 * point.memory for point in points], style, **look)
    axes[0].set(xscale="log", yscale="log", xlabel="size / 1", ylabel="median time / us")
    axes[1].set(xscale="log", yscale="log", xlabel="size / 1", ylabel="arrays / MB")
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.legend(
        loc="outside lower center",
        ncols=3,
        fontsize=9.5,
        title="exponent of time, of memory (upper half)",
    )
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "names", nargs="*", help=f"of {', '.join(each.__name__ for each in SERIES)}; default all"
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--quick", action="store_true", help="fewer and smaller sizes")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    print(machine())
    found: dict[str, list[Point]] = {}
    for series in SERIES:
        if not given.names or series.__name__ in given.names:
            for name, point in series(given.quick):
                found.setdefault(name, []).append(point)
            print(series.__name__, flush=True)
    rows = []
    for name, points in found.items():
        exponents = [
            exponent(points, of, upper=upper)
            for of in ("time", "memory")
            for upper in (False, True)
        ]
        why = [
            BECAUSE.get((name, of), "NOT EXPLAINED")
            for of, power in (("time", exponents[1]), ("memory", exponents[3]))
            if power > ABOVE
        ]
        rows.append(
            (
                name,
                f"{points[0].size:.0f}-{points[-1].size:.0f}",
                f"{points[0].time_us:.0f}-{points[-1].time_us:.0f}",
                f"{points[-1].memory / 1e6:.3g}",
                *(f"{each:.2f}" for each in exponents),
                "; ".join(why),
            )
        )
    print(
        table(
            rows,
            (
                "growth with",
                "sizes",
                "us",
                "MB",
                "time",
                "upper half",
                "memory",
                "upper half",
                "above 1.2 because",
            ),
        )
    )
    with (given.out / "growth.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("series", "size", "time_us", "memory_bytes"))
        writer.writerows(
            (name, p.size, p.time_us, p.memory) for name, points in found.items() for p in points
        )
    draw(found, given.out / "growth.png")


if __name__ == "__main__":
    main()
