"""Press a liver with a ball, then inspect what it did inside: force over depth, displacement, stress.

Expected: 0.285 N at 5 mm with a ball of 20 mm on 5.4 kPa, 0.86 of what Hertz gives for a half-space (the surface is a
dome that yields, and Hertz's parabola is steeper than the ball). The tissue under the ball has gone down nearly by
what the ball has; the von Mises stress is greatest within a radius under it. The scene's cells are quadratic and fine
under the ball only: halving the fine ones or the coarse ones elsewhere moves the force by about 1 %. The run
states from which depth linear elasticity is 5 % off. The modulus is that of a cited range of 2 to 15 kPa: the force
follows it in proportion.
Run: python examples/05_press_and_inspect.py [--out FILE.png]
"""

import sys
from pathlib import Path

import numpy as np

import tissue

DEPTH_MM, RADIUS_MM = 5.0, 10.0
YOUNG_PA, POISSON = 5.4e3, 0.49


def press() -> tissue.Run:
    """The built-in liver, straight down."""
    changes = {
        "motion.points_mm": [[0, 0, 1], [0, 0, -DEPTH_MM]],
        "motion.feed_mm_s": 50.0,
        "organ.interval_ms": 119.0,
    }
    return tissue.simulate(tissue.load_scene("liver-press", changes))


def hertz_N(depth_mm: np.ndarray) -> np.ndarray:
    """Force of a rigid ball on an elastic half-space (Hertz 1882)."""
    reduced = YOUNG_PA / (1.0 - POISSON**2)
    return 4.0 / 3.0 * reduced * np.sqrt(1e-3 * RADIUS_MM) * (1e-3 * np.maximum(depth_mm, 0.0)) ** 1.5


def main(out: Path | None = None) -> None:
    run = press()
    depth, force = -run.trace["tool_z_mm"], run.trace["model_force_z_N"]
    ratio = force[-1] / hertz_N(depth[-1:])[0]
    mesh = run.dataset()
    moved, stress = mesh.point_data["displacement_mm"], mesh.cell_data["von_mises_kPa"]
    middle = mesh.cell_centers().points
    under = int(np.argmin(np.linalg.norm(mesh.points, axis=1)))
    worst = middle[np.argmax(stress)]
    print(f"force at {depth[-1]:.1f} mm: {force[-1]:.3f} N, {ratio:.2f} of Hertz on a half-space")
    print(f"the surface at the ball's middle has moved by {-moved[under, 2]:.1f} mm")
    away = np.linalg.norm(worst)
    print(f"greatest von Mises stress {stress.max():.1f} kPa, {away:.1f} mm from where the ball came in")

    assert abs(force[-1] - 0.285) < 0.01
    assert abs(ratio - 0.86) < 0.03
    assert abs(-moved[under, 2] - DEPTH_MM) < 1.0
    assert away < RADIUS_MM
    assert [what.split(":")[0] for _, what in run.events] == ["pressed 3.7 mm deep"]
    if out is not None:
        draw(run, out)
        print("picture in", out)


def draw(run: tissue.Run, out: Path) -> None:
    """Force over depth beside Hertz's."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    depth, force = -run.trace["tool_z_mm"], run.trace["model_force_z_N"]
    figure, axes = pyplot.subplots(figsize=(7, 4.2), layout="constrained")
    axes.plot(depth, force, color="#0072B2", linewidth=2.2, label="liver")
    axes.plot(depth, hertz_N(depth), color="0.3", linestyle="--", label="Hertz, half-space of the same modulus")
    axes.set(xlabel="depth of the ball's tip / mm", ylabel="force / N", xlim=(0.0, DEPTH_MM), ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    axes.set_title(f"Ball of {2 * RADIUS_MM:g} mm on the dome of a liver of {1e-3 * YOUNG_PA:g} kPa")
    figure.savefig(out, dpi=150)
    pyplot.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
