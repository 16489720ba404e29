"""Error and cost of the tooth over cells and particles.

Run: `python tests/bench/chart_tooth.py [--out FILE.png]`.

The procedural molar with a cavity is loaded by 1 N. Compared are the displacement of the tooth in
its ligament, and the stress in the dentin next to and under the cavity's bottom. Several cell sizes
and particles per cell are compared with the finest. The force at the bur does not depend on them.
"""

import argparse
from time import perf_counter

import numpy as np
from harness import machine, table

from meshes.shapes.sdf import cylinder
from meshes.tooth.molar import molar
from meshes.voxels.voxelise import voxelise
from tissue.models.tooth.field import StressField
from tissue.models.tooth.recovery import REACH_M, StressRecovery

SETTINGS = ((1.0, 2), (0.7, 2), (0.5, 1), (0.5, 2), (0.5, 4), (0.4, 2), (0.3, 2), (0.2, 2))
"""Edge of a cell [mm] and particles along it; the last is the reference."""
CAVITY = cylinder(1.0e-3, (0.0, 0.0, -2.5e-3), (0.0, 0.0, 5e-3))
POINT_M, FORCE_N = np.array([0.0, 0.0, -2.5e-3]), np.array([0.3, 0.0, -0.95])
PROBES_M = np.array(
    [
        [x, y, z]
        for z in (-2.6e-3, -2.9e-3, -3.4e-3, -4.2e-3)
        for x in (-7e-4, 0.0, 7e-4)
        for y in (-7e-4, 0.0, 7e-4)
    ]
)


def measure(cell_mm: float, along: int) -> dict[str, float | np.ndarray]:
    """Displacement [um], stress at the probes [kPa], unknowns and costs of one setting."""
    tooth = voxelise(molar(), spacing_m=1e-3 * cell_mm / along, minus=CAVITY)
    start = perf_counter()
    field = StressField(tooth, cell_m=1e-3 * cell_mm, ligament_thickness_m=0.22e-3, cores=1)
    setup = perf_counter() - start
    frame = field.solve(0.0, FORCE_N, POINT_M)
    warm = []
    stressed = field.body.displacement_m.copy()
    for k in range(3):
        start = perf_counter()
        field.solve(0.1, FORCE_N * (1.05 + 0.05 * k), POINT_M)
        warm.append(perf_counter() - start)
    moved = np.average(frame.points["displacement_um"], axis=0, weights=field.body.carrying)
    dentin = np.full(len(PROBES_M), tooth.layer_names.index("dentin"))
    recovery = StressRecovery(
        field.body.particles,
        field.body.cells,
        PROBES_M,
        dentin,
        reach_m=max(REACH_M, tooth.spacing_m),
    )
    probes = recovery(stressed)
    return {
        "unknowns": field.unknown_count,
        "particles": len(field.body.particles.volume_m3),
        "moved": float(np.linalg.norm(moved)),
        "probes": probes,
        "setup_s": setup,
        "warm_s": float(np.median(warm)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", help="picture to write")
    out = parser.parse_args().out
    print(machine())
    found = {setting: measure(*setting) for setting in SETTINGS}
    reference = found[SETTINGS[-1]]
    rows, points = [], []
    for (cell, along), values in found.items():
        displacement = abs(values["moved"] / reference["moved"] - 1.0)
        stress = np.linalg.norm(values["probes"] - reference["probes"]) / np.linalg.norm(
            reference["probes"]
        )
        points.append((cell, along, displacement, stress, values["warm_s"]))
        rows.append(
            (
                f"{cell:g} mm",
                f"{along**3}",
                f"{values['unknowns']}",
                f"{values['particles']}",
                f"{values['moved']:.3f}",
                f"{displacement:.2%}",
                f"{stress:.1%}",
                f"{values['setup_s']:.2f}",
                f"{1e3 * values['warm_s']:.0f}",
            )
        )
    print(
        table(
            rows,
            (
                "cell",
                "particles/cell",
                "unknowns",
                "particles",
                "moved um",
                "error",
                "stress error",
                "set-up s",
                "warm solve ms",
            ),
        )
    )
    if out:
        draw(points, out)


def draw(points: list[tuple[float, int, float, float, float]], out: str) -> None:
    """Error against the cost of a warm solve, log-log, every setting named."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7.5, 5), layout="constrained")
    for column, label, colour, marker in (
        (2, "displacement", "#0072B2", "o"),
        (3, "stress", "#D55E00", "s"),
    ):
        chosen = [(1e3 * p[4], 100 * p[column], f"{p[0]:g} mm, {p[1] ** 3}") for p in points[:-1]]
        axes.scatter(
            *zip(*[c[:2] for c in chosen], strict=True),
            color=colour,
            marker=marker,
            label=label,
            s=50,
        )
        for cost, error, name in chosen:
            axes.annotate(
                name, (cost, error), textcoords="offset points", xytext=(6, 4), fontsize=8
            )
    axes.axvline(100.0, color="0.5", linestyle="--")
    axes.text(100.0, axes.get_ylim()[1], " 10 Hz", va="top", color="0.4")
    axes.set(
        xscale="log", yscale="log", xlabel="warm solve / ms", ylabel="error to 0.2 mm cells / %"
    )
    axes.grid(alpha=0.3, which="both")
    axes.legend(title="cell, particles a cell")
    figure.savefig(out, dpi=150)
    print("picture in", out)


if __name__ == "__main__":
    main()
