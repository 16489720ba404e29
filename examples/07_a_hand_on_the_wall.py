"""A hand meets a rigid wall of 2 kN/m through three renderers, presses, and is jerked off it.

The device is the one with six degrees of freedom (75 g, 0.4 N s/m, 1 kHz, 0.5 ms of delay, amplifiers of 300 Hz), in
an expert's hand. Its eigenvalues allow 2906 N/m in that hand, so the wall is judged stable with a margin of 31 %; let
go, it would be stable up to 262 N/m only, and the wall is refused.
Expected: the penalty and the proxy renderer give the hand 2.3 mJ more than they took, and the force still ripples by
0.09 N, 0.3 to 0.5 s after the jerk. On a flat wall the two are one law. The passivity renderer takes 0.3 mJ and is
quiet. All three hold the device at the same depth, 0.65 mm. Numbers of hand and device are priors (`tissue/materials`).
Run: python examples/07_a_hand_on_the_wall.py [--out FILE.png]
"""

import sys
from pathlib import Path

import numpy as np

from tissue.haptics.device.device import device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.loop.critical_stiffness import judge
from tissue.haptics.rigid_wall import WallRun, knock
from tissue.scene.registry import RENDERERS

STIFFNESS_N_M = 2000.0


def main(out: Path | None = None) -> None:
    device, hand = device_parameters("six-dof"), hand_parameters("expert")
    loop = device.loop(STIFFNESS_N_M)
    held, free = judge(loop, [hand.grip[:3]]), judge(loop)
    print("held:", held.sentence(STIFFNESS_N_M))
    print("let go:", free.sentence(STIFFNESS_N_M))
    assert held.stable and abs(held.critical_N_m - 2906.0) < 2.0 and abs(held.margin - 0.31) < 0.005
    assert not free.stable and free.nearest_N_m == 261.0

    runs: dict[str, WallRun] = {}
    created_mJ, ripple_N, depth_mm = {}, {}, {}
    for kind in RENDERERS:
        runs[kind], simulated = knock(device, hand, kind, STIFFNESS_N_M)
        created_mJ[kind] = 1e3 * simulated.translation.motor_work_J
        ripple_N[kind] = runs[kind].ripple_N(0.2)
        depth_mm[kind] = -1e3 * float(runs[kind].position_m[-200:, 2].mean())
        print(
            f"{kind}: {created_mJ[kind]:+.2f} mJ given to the hand, ripple {ripple_N[kind]:.3f} N, "
            f"depth {depth_mm[kind]:.2f} mm"
        )
    assert np.array_equal(runs["penalty"].force_N, runs["proxy"].force_N)
    assert abs(created_mJ["penalty"] - 2.3) < 0.1 and abs(created_mJ["passivity"] + 0.28) < 0.05
    assert abs(ripple_N["penalty"] - 0.09) < 0.01 and ripple_N["passivity"] < 1e-3
    assert all(abs(depth - 0.65) < 0.02 for depth in depth_mm.values())
    if out is not None:
        draw(runs, out)
        print("picture in", out)


def draw(runs: dict[str, WallRun], out: Path) -> None:
    """Force over time, and the energy taken as if commands acted at once; what the lag gives back comes on top."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(2, 1, figsize=(8, 5.4), sharex=True, layout="constrained")
    styles = {"penalty": ("#0072B2", "-"), "passivity": ("#E69F00", "-"), "proxy": ("0.1", ":")}
    for kind, run in runs.items():
        colour, line = styles[kind]
        axes[0].plot(run.time_s, run.force_N[:, 2], color=colour, linestyle=line, label=kind)
        axes[1].plot(run.time_s, 1e3 * run.taken_J, color=colour, linestyle=line)
    axes[0].set(ylabel="force off the wall / N", xlim=(0.25, 1.3))
    axes[1].set(ylabel="energy taken / mJ, lag not counted", xlabel="time / s")
    axes[0].legend(loc="upper left")
    axes[0].set_title(f"Meeting, holding and jerked off a wall of {STIFFNESS_N_M:g} N/m")
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.savefig(out, dpi=150)
    pyplot.close(figure)


if __name__ == "__main__":
    main(Path(sys.argv[2]) if sys.argv[1:2] == ["--out"] else None)
