"""Picture of the packages and their imports.

Run: ``python tests/bench/import_graph.py PICTURE.png [CHECKOUT]``.

A package, or a module at the top of ``tissue``, stands above all that it imports; a circle of
imports is orange. An arrow is as wide as there are modules that import.
"""

import ast
import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.sparse.csgraph import connected_components
from structure import imports, sources

CIRCLE, STRAIGHT, BOX = (
    "#D55E00",
    "#0072B2",
    {"boxstyle": "round,pad=0.35", "facecolor": "white", "linewidth": 0.8},
)


def measured(root: Path) -> tuple[list[str], np.ndarray, list[int], int]:
    """Return package names, a matrix of imports, modules per package, and all lines.

    An entry of the matrix counts the modules of the first package that import the second.
    """
    files = sources(root)
    files.pop("tissue", None)  # hands out names of all layers, each when it is asked for
    package = {
        name: ".".join(name.split(".")[: 2 if name.startswith("tissue.") else 1]) for name in files
    }
    names = sorted(set(package.values()))
    at = {name: names.index(package[name]) for name in files}
    count = np.zeros((len(names), len(names)), dtype=int)
    for name, path in files.items():
        for one in {
            at[each] for each in imports(ast.parse(path.read_text("utf-8")), set(files))
        } - {at[name]}:
            count[at[name], one] += 1
    lines = [len(path.read_text("utf-8").splitlines()) for path in files.values()]
    return names, count, np.bincount(list(at.values())).tolist(), sum(lines)


def layers_of(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the layer of each package, 0 the lowest, and the number of its circle.

    A package without a circle has a number of its own.
    """
    _, circle = connected_components(count, connection="strong")
    layer = np.zeros(len(count), dtype=int)
    above, below = np.nonzero((count > 0) & (circle[:, None] != circle))
    for _ in range(len(count)):
        np.maximum.at(layer, above, layer[below] + 1)
        layer = np.array([layer[circle == one].max() for one in circle])
    return layer, circle


def draw(root: Path, path: Path) -> None:
    """Draw the picture."""
    names, count, modules, lines = measured(root)
    layer, circle = layers_of(count)
    (x, y), base = np.zeros((2, len(names))), 0.0
    for level in range(layer.max() + 1):
        row = np.flatnonzero(layer == level)
        middle = [
            x[below].mean() if (below := (count[one] > 0) & (layer < level)).any() else 0.0
            for one in row
        ]
        row, lines_of = row[np.argsort(middle, kind="stable")], -(-len(row) // 7)
        x[row] = (np.arange(len(row)) - 0.5 * (len(row) - 1)) / max(len(row) - 1, 2)
        x[row] += 0.1 * (-1) ** level * (len(row) == 1)
        y[row] = base + 0.6 * (np.arange(len(row)) % lines_of)
        base += 1.0 + 0.6 * (lines_of - 1)
    chart = Figure(figsize=(9.5, 0.8 * base + 0.8), dpi=130)
    axes = chart.add_axes((0.04, 0.02, 0.92, 0.93))
    axes.set(xlim=(-0.56, 0.56), ylim=(-0.5, base - 0.4), frame_on=False, xticks=[], yticks=[])
    for i, j in np.argwhere(count):
        colour, bend = (CIRCLE, 0.3) if circle[i] == circle[j] else (STRAIGHT, 0.06)
        look = {"arrowstyle": "-|>", "color": colour, "alpha": 0.35, "shrinkA": 11, "shrinkB": 11}
        look |= {"linewidth": 0.5 * count[i, j] ** 0.5, "connectionstyle": f"arc3,rad={bend}"}
        axes.annotate("", (x[j], y[j]), (x[i], y[i]), arrowprops=look)
    several = np.bincount(circle)[circle] > 1
    for i, name in enumerate(names):
        text = name.removeprefix("tissue.") + (f"\n{modules[i]} modules" if modules[i] > 1 else "")
        box = BOX | {"edgecolor": CIRCLE if several[i] else "0.3"}
        axes.text(x[i], y[i], text, ha="center", va="center", size=10, bbox=box)
    chart.suptitle(
        f"{sum(modules)} modules, {lines} lines; {len(names)} packages in {layer.max() + 1} "
        "layers, "
        f"{(count > 0).sum()} arrows between them, {several.sum()} packages in "
        f"{len(set(circle[several]))} circles"
    )
    chart.savefig(path)


if __name__ == "__main__":
    draw(
        Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).resolve().parents[2],
        Path(sys.argv[1]),
    )
