"""Drill straight down through enamel into dentin, stop above the pulp, and read the layers from the force.

Expected: the bur is pushed back with 1.12 N in enamel and 0.136 N in dentin, 8.2 times less, both within the 0.1 to
4.9 N that are published for preparing teeth. The force falls halfway at 1.39 mm; the voxels end enamel at 1.35 mm
under the fossa. 0.60 mm of dentin are left over the pulp, after a warning at 1 mm. The figures rest on cutting
coefficients of low confidence (`tissue/materials/cutting.toml`): they are plausible, not validated.
Run: python examples/03_drill_through_the_layers.py [--out FILE.png]
"""

import sys
from pathlib import Path

import numpy as np

import tissue

DEPTH_MM, FEED_MM_S = 4.4, 1.5
LAYERS = ("enamel", "dentin")
PUBLISHED_N = (0.1, 4.9)


def drill() -> tissue.Run:
    """The built-in molar, straight down, without its stress and with as little tooth around as the pulp needs."""
    return tissue.simulate(
        tissue.load_scene(
            "molar",
            {
                "voxels.margin_mm": 1.5,
                "motion.points_mm": [[0, 0, 0.2], [0, 0, -DEPTH_MM]],
                "motion.feed_mm_s": FEED_MM_S,
                "duration_s": (0.2 + DEPTH_MM) / FEED_MM_S,
                "stress": None,
            },
        )
    )


def steady_force_N(run: tissue.Run, layer: str) -> float:
    """Mean axial force in the middle half of the ticks in which the bur meets mostly one layer."""
    ticks = np.flatnonzero(run.trace["layer"] == layer)
    quarter = len(ticks) // 4
    return float(run.trace["model_force_z_N"][ticks[quarter:-quarter]].mean())


def felt_boundary_mm(run: tissue.Run, high_N: float, low_N: float) -> float:
    """Depth of the tip at which the force has fallen halfway from one level to the other, for good."""
    force, depth = run.trace["model_force_z_N"], -run.trace["tool_z_mm"]
    return float(depth[np.flatnonzero(force > 0.5 * (high_N + low_N))[-1]])


def true_boundary_mm(run: tissue.Run) -> float:
    """Depth of the lowest enamel voxel's lower face under the fossa."""
    volume = run.parts.volume
    i, j = np.floor(-volume.origin_m[:2] / volume.spacing_m).astype(int)
    enamel = (volume.layer[i, j] == volume.layer_names.index("enamel")) & (volume.fraction[i, j] > 0)
    return float(-1e3 * (volume.centres_m(2)[enamel].min() - 0.5 * volume.spacing_m))


def main(out: Path | None = None) -> None:
    run = drill()
    enamel, dentin = (steady_force_N(run, layer) for layer in LAYERS)
    felt, true = felt_boundary_mm(run, enamel, dentin), true_boundary_mm(run)
    left = run.trace["dentin_over_pulp_mm"][-1]
    print(f"axial force: {enamel:.3f} N in enamel, {dentin:.3f} N in dentin, ratio {enamel / dentin:.1f}")
    print(f"enamel ends at {felt:.2f} mm by the force, at {true:.2f} mm by the voxels")
    print(f"dentin left over the pulp: {left:.2f} mm")
    for time_s, event in run.events:
        print(f"after {time_s:.2f} s: {event}")

    assert abs(enamel - 1.120) < 0.01
    assert abs(dentin - 0.136) < 0.002
    assert all(PUBLISHED_N[0] < force < PUBLISHED_N[1] for force in (enamel, dentin))
    assert abs(enamel / dentin - 8.2) < 0.1
    assert abs(felt - 1.39) < 0.01 and abs(true - 1.35) < 0.01
    assert abs(left - 0.60) < 0.02
    assert [event for _, event in run.events] == ["less than 1 mm of dentin is left over the pulp"]
    if out is not None:
        draw(run, (enamel, dentin), felt, true, out)
        print("picture in", out)


def draw(run: tissue.Run, levels_N: tuple[float, float], felt_mm: float, true_mm: float, out: Path) -> None:
    """Axial force over depth, the layers behind it."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    depth, force = -run.trace["tool_z_mm"], run.trace["model_force_z_N"]
    figure, axes = pyplot.subplots(figsize=(8, 4.4), layout="constrained")
    ends = (0.0, true_mm, DEPTH_MM)
    for layer, colour, level, first, last in zip(
        LAYERS, ("#56B4E9", "#E69F00"), levels_N, ends, ends[1:], strict=False
    ):
        axes.axvspan(first, last, color=colour, alpha=0.25, linewidth=0)
        axes.text(0.5 * (first + last), 1.04 * levels_N[0], f"{layer}\n{level:.3g} N", ha="center", va="bottom")
    axes.plot(depth, force, color="0.1", linewidth=2)
    axes.axvline(felt_mm, color="0.1", linestyle="--", linewidth=1, label=f"halfway by the force, {felt_mm:.2f} mm")
    axes.axvline(true_mm, color="0.1", linestyle=":", linewidth=1, label=f"boundary in the voxels, {true_mm:.2f} mm")
    axes.set(xlabel="depth of the tip under the fossa / mm", ylabel="axial force / N")
    axes.set(xlim=(depth[0], DEPTH_MM), ylim=(0.0, 1.3 * levels_N[0]))
    axes.grid(axis="y", alpha=0.3)
    axes.legend(loc="center right")
    axes.set_title(f"Round bur of {run.scene.tool.diameter_mm:g} mm fed into a molar at {FEED_MM_S:g} mm/s")
    figure.savefig(out, dpi=150)
    pyplot.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
