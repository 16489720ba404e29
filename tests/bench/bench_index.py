"""Grid-convergence index of a scene's force.

Run: `python tests/bench/bench_index.py SCENE [key=value ...]`.

SCENE is a built-in scene, or one with real anatomy of `../shared/anatomy`: scapula, scapula-low,
tooth-surfaces, tooth-labels, liver-scan. It runs at its spacing, and with all lengths of the grid
at 0.58 and a third of it: voxels and elements of the cutter, or all edges of an organ and their
growth. Printed: observed order; for each grid the index, the distance to the finest and the signed
bias against it, in %, over ticks and over 50 ms; and the tick's cost on one core. The index bounds
what the discretisation makes of one file. An error that all three grids share it does not see.

`--meshes N`, for an organ that fTetWild meshes: every grid N times, the file's surface turned at
random and the scene with it. The force of a grid is then the mean of its meshes; printed too: the
standard deviation of one of them about it.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from harness import machine, table
from scipy.spatial.transform import Rotation

import tissue
from tissue.evaluation.charts.settings import refined
from tissue.evaluation.reference.history import grid_index, means_over_50_ms
from tissue.scene.load import changed, parse_override

ROOT = Path(__file__).resolve().parents[3] / "shared" / "anatomy"
SHARES = (1.0, 3.0**-0.5, 1.0 / 3.0)
"""Spacings over the scene's."""
LAYERS = {
    f"anatomy.{name.lower()}_file": f"tooth/openmandible_L6_{name}.stl"
    for name in ("Enamel", "Dentin", "Pulp")
}
REAL: dict[str, tuple[str, dict[str, Any]]] = {
    "scapula": (
        "glenoid",
        {"anatomy.file": "scapula/openforge_scapula_left.stl", "anatomy.scale_mm": 50.0},
    ),
    "scapula-low": ("glenoid", {"anatomy.file": "scapula/myosim_scapula.stl"}),
    "tooth-surfaces": ("molar", LAYERS),
    "tooth-labels": (
        "molar",
        {"anatomy.file": "tooth/caries_tooth_2.nii.gz", "anatomy.spacing_mm": 0.034},
    ),
    "liver-scan": ("liver-press", {"anatomy.file": "liver/liver.vtk", "anatomy.scale_mm": 1.0}),
}
"""Scene and changes by name of a real anatomy."""


def scene_of(name: str, changes: dict[str, Any]):
    """The scene of a name with changes."""
    library, real = REAL.get(name, (name, {}))
    placed = {
        key: str(ROOT / value) if key.endswith("file") else value for key, value in real.items()
    }
    return tissue.load_scene(library, placed | changes)


def turned(scene, seed: int, folder: str):
    """Return the scene turned at random, the surface in its file and all directions with it.

    Seed 0 turns nothing.
    """
    import pyvista

    if seed == 0:
        return scene
    turn, surface = Rotation.random(random_state=seed), pyvista.read(scene.anatomy.file)
    surface.points = turn.apply(surface.points)
    surface.save(file := str(Path(folder) / f"turned-{seed}.vtk"))
    axes = {
        f"anatomy.{name}": turn.apply(axis).tolist()
        for name, axis in (("normal", [0, 0, 1]), ("along", [1, 0, 0]))
    }
    return changed(scene, {"anatomy.file": file} | axes)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "words",
        nargs="+",
        metavar="SCENE",
        help="a scene, and changes such as voxels.spacing_mm=0.05",
    )
    parser.add_argument(
        "--shares",
        type=float,
        nargs=3,
        default=SHARES,
        help="lengths of the grids over the scene's",
    )
    parser.add_argument(
        "--meshes",
        type=int,
        default=1,
        help="meshes of each grid, of an organ meshed from a surface",
    )
    given = parser.parse_args()
    changes = dict(parse_override(word) for word in given.words if "=" in word)
    (name,) = (word for word in given.words if "=" not in word)
    scene = scene_of(name, changes)
    forces, ticks = [], []
    for share in given.shares:
        grid, of_meshes = changed(scene, refined(scene, share)), []
        with tempfile.TemporaryDirectory() as folder:
            for seed in range(given.meshes):
                run = tissue.simulate(turned(grid, seed, folder), cores=1)
                of_meshes.append(run.trace.vectors("model_force", "N"))
        ticks.append(run.timing["tick_us"][run.trace["contact_mm2"] > 0.0])
        forces.append(np.mean(of_meshes, axis=0))
        if given.meshes > 1:
            scatter = np.linalg.norm(np.std(of_meshes, axis=0, ddof=1)) / np.linalg.norm(forces[-1])
            print(
                (
                    f"grid {share:.3g}: {given.meshes} meshes, standard deviation "
                    f"{100.0 * scatter:.2f} %"
                ),
                flush=True,
            )
    ticks_index = grid_index(forces, given.shares)
    windows_index = grid_index([means_over_50_ms(force) for force in forces], given.shares)
    finest = forces[int(np.argmin(given.shares))]
    sizes = np.linalg.norm(finest, axis=1)
    along = finest / np.maximum(sizes, 1e-300)[:, None]
    print(machine())
    for norm, order in (("ticks", ticks_index), ("50 ms", windows_index)):
        print(
            f"{name}, {norm}: observed order "
            f"{order.order:.2f}{'' if order.asymptotic else ', not asymptotic'}"
        )
    rows = []
    for k, share in enumerate(given.shares):
        values = (
            ticks_index.index[k],
            windows_index.index[k],
            ticks_index.distance[k],
            windows_index.distance[k],
            ((forces[k] - finest) * along).sum() / max(sizes.sum(), 1e-300),
        )
        cost = f"{np.median(ticks[k]):.0f}", f"{np.percentile(ticks[k], 99):.0f}"
        lengths = ", ".join(
            f"{value:.3g}"
            for key, value in refined(scene, share).items()
            if key.endswith("_mm") and value
        )
        rows.append((f"{share:.3g}", lengths, *(f"{100.0 * value:.2f}" for value in values), *cost))
    head = (
        "grid",
        "lengths mm",
        "index %",
        "50 ms",
        "distance %",
        "50 ms",
        "bias %",
        "tick us",
        "99 %",
    )
    print(table(rows, head))


if __name__ == "__main__":
    main()
