"""
A hand on a stiff wall
======================

A hand touches a rigid wall of 2 kN/m with three renderers, presses, and is jerked off it. The
device has six degrees of freedom (75 g, 0.4 N s/m, 1 kHz, 0.5 ms of delay, amplifiers of 300 Hz)
and is held by an expert. The eigenvalues allow 2906 N/m in that hand, so the wall is stable with a
margin of 31 %. Without the hand the device would be stable up to 262 N/m only, and the wall would
be refused.

Expected:

- The penalty and the proxy renderer give the hand 2.3 mJ more than they took. The force still
  oscillates by 0.09 N, 0.3 to 0.5 s after the jerk. On a flat wall both renderers have the same
  law.
- The passivity renderer takes 0.3 mJ, and its force does not oscillate.
- All three hold the device at the same depth, 0.65 mm.

Numbers of hand and device are priors (`tissue/materials`).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
STIFFNESS_N_M = 2000.0

# %%
# Stability is computed before the run.

held = tissue.stability.judge(tissue.stability.wall_loop("six-dof", STIFFNESS_N_M, hand="expert"))
free = tissue.stability.judge(tissue.stability.wall_loop("six-dof", STIFFNESS_N_M))
print("held:", held.sentence(STIFFNESS_N_M))
print("let go:", free.sentence(STIFFNESS_N_M))
assert held.stable and abs(held.critical_N_m - 2906.0) < 2.0 and abs(held.margin - 0.31) < 0.005
assert not free.stable and free.nearest_N_m == 261.0

# %%
# The hand moves onto the wall and presses. A pull of 2 N for 20 ms jerks it off. This is repeated
# with each force law.

RENDERERS = ("penalty", "passivity", "proxy")
runs = {
    kind: tissue.stability.knock("six-dof", STIFFNESS_N_M, hand="expert", renderer=kind)
    for kind in RENDERERS
}
for kind, run in runs.items():
    depth_mm = -1e3 * float(run.position_m[-200:, 2].mean())
    print(
        f"{kind}: {1e3 * run.given_J:+.2f} mJ given to the hand, ripple {run.ripple_N(0.2):.3f} N, "
        f"depth {depth_mm:.2f} mm"
    )
    assert abs(depth_mm - 0.65) < 0.02
assert np.array_equal(runs["penalty"].force_N, runs["proxy"].force_N)
assert (
    abs(1e3 * runs["penalty"].given_J - 2.3) < 0.1
    and abs(1e3 * runs["passivity"].given_J + 0.28) < 0.05
)
assert abs(runs["penalty"].ripple_N(0.2) - 0.09) < 0.01 and runs["passivity"].ripple_N(0.2) < 1e-3

# %%
# Plot the force over time, and the energy that the renderer took. The energy is computed as if
# commands acted at once. The energy that the lag gives back is not included.

figure, panels = plt.subplots(2, 1, figsize=(8, 5.4), sharex=True, layout="constrained")
styles = {"penalty": ("#0072B2", "-"), "passivity": ("#E69F00", "-"), "proxy": ("0.1", ":")}
for kind, run in runs.items():
    colour, line = styles[kind]
    panels[0].plot(run.time_s, run.force_N[:, 2], color=colour, linestyle=line, label=kind)
    panels[1].plot(run.time_s, 1e3 * run.taken_J, color=colour, linestyle=line)
panels[0].set(ylabel="force off the wall / N", xlim=(0.25, 1.3))
panels[1].set(ylabel="energy taken / mJ, lag not counted", xlabel="time / s")
panels[0].legend(loc="upper left")
panels[0].set_title(f"Meeting, holding and jerked off a wall of {STIFFNESS_N_M:g} N/m")
for panel in panels:
    panel.grid(alpha=0.3)
figure.savefig(FIGURES / "07_wall.png", dpi=150)
