"""
Drill through the layers of a tooth
===================================

A bur moves straight down through enamel into dentin and stops above the pulp. The example
identifies the layers from the force.

Expected:

- The axial force is 1.12 N in enamel and 0.136 N in dentin. The ratio of these forces is 8.2. Both
  forces lie within the published range for preparing teeth, 0.1 to 4.9 N.
- The force falls to the middle between these two values at a depth of 1.40 mm. In the voxels,
  enamel ends 1.35 mm below the fossa.
- At the end, 0.60 mm of dentin are left above the pulp. The run gives a warning at 1 mm.

These values depend on cutting coefficients of low confidence (`tissue/materials/cutting.toml`). The
values are plausible, not validated. If the coefficients are drawn from the ranges of the cited
sources, 90 % of the forces lie between 0.3 and 5.4 N in enamel, and between 0.05 and 0.6 N in
dentin (`bench_band.py --published`).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
DEPTH_MM = 4.4
FEED_MM_S = 1.5
LAYERS = ("enamel", "dentin")
PUBLISHED_N = (0.1, 4.9)

# %%
# The bur moves straight down into the built-in molar. The stress computation is switched off. The
# margin of voxels around the path is only as large as needed to reach the pulp.

changes = {
    "voxels.margin_mm": 1.5,
    "motion.points_mm": [[0, 0, 0.2], [0, 0, -DEPTH_MM]],
    "motion.feed_mm_s": FEED_MM_S,
    "duration_s": (0.2 + DEPTH_MM) / FEED_MM_S,
    "stress": None,
}
run = tissue.simulate(tissue.load_scene("molar", changes))
depth = -run.trace["tool_z_mm"]
force = run.trace["model_force_z_N"]
layer = run.trace["layer"]

# %%
# For each layer, take the ticks in which the bur cuts mostly that layer. The mean axial force is
# computed from the middle half of these ticks.

levels_N = {}
for name in LAYERS:
    ticks = np.flatnonzero(layer == name)
    quarter = len(ticks) // 4
    levels_N[name] = float(force[ticks[quarter:-quarter]].mean())
enamel, dentin = levels_N.values()
print(
    f"axial force: {enamel:.3f} N in enamel, {dentin:.3f} N in dentin, ratio {enamel / dentin:.1f}"
)
assert abs(enamel - 1.120) < 0.01
assert abs(dentin - 0.136) < 0.002
assert all(PUBLISHED_N[0] < level < PUBLISHED_N[1] for level in levels_N.values())
assert abs(enamel / dentin - 8.2) < 0.1

# %%
# Compare two depths: the last depth at which the force is halfway between enamel and dentin, and
# the depth of the lowest enamel voxel below the fossa.

felt_mm = float(depth[np.flatnonzero(force > 0.5 * (enamel + dentin))[-1]])
volume = run.volume
i, j = np.floor(-volume.origin_m[:2] / volume.spacing_m).astype(int)
is_enamel = (volume.layer[i, j] == volume.layer_names.index("enamel")) & (volume.fraction[i, j] > 0)
true_mm = float(-1e3 * (volume.centres_m(2)[is_enamel].min() - 0.5 * volume.spacing_m))
left_mm = run.trace["dentin_over_pulp_mm"][-1]
print(f"enamel ends at {felt_mm:.2f} mm by the force, at {true_mm:.2f} mm by the voxels")
print(f"dentin left over the pulp: {left_mm:.2f} mm")
for time_s, event in run.events:
    print(f"after {time_s:.2f} s: {event}")
assert abs(felt_mm - 1.40) < 0.01 and abs(true_mm - 1.35) < 0.01
assert abs(left_mm - 0.60) < 0.02
assert [event for _, event in run.events] == ["less than 1 mm of dentin is left over the pulp"]

# %%
# Plot the force as a function of depth, with the layers in the background.

figure, axes = plt.subplots(figsize=(8, 4.4), layout="constrained")
ends = (0.0, true_mm, DEPTH_MM)
for name, colour, first, last in zip(
    LAYERS, ("#56B4E9", "#E69F00"), ends[:-1], ends[1:], strict=True
):
    axes.axvspan(first, last, color=colour, alpha=0.25, linewidth=0)
    label = f"{name}\n{levels_N[name]:.3g} N"
    axes.text(0.5 * (first + last), 1.04 * enamel, label, ha="center", va="bottom")
axes.plot(depth, force, color="0.1", linewidth=2)
axes.axvline(
    felt_mm,
    color="0.1",
    linestyle="--",
    linewidth=1,
    label=f"halfway by the force, {felt_mm:.2f} mm",
)
axes.axvline(
    true_mm,
    color="0.1",
    linestyle=":",
    linewidth=1,
    label=f"boundary in the voxels, {true_mm:.2f} mm",
)
axes.set(xlabel="depth of the tip under the fossa / mm", ylabel="axial force / N")
axes.set(xlim=(depth[0], DEPTH_MM), ylim=(0.0, 1.3 * enamel))
axes.grid(axis="y", alpha=0.3)
axes.legend(loc="center right")
axes.set_title(
    f"Round bur of {2e3 * run.cutter.profile.radius_m:.2g} mm fed into a molar at "
    f"{FEED_MM_S:g} mm/s"
)
figure.savefig(FIGURES / "03_force.png", dpi=150)
