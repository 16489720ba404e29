"""
Ream a glenoid and read the force
=================================

This example runs a built-in scene, reads its trace by column names, and shows the bone after
reaming.

Expected for a glenoid reamed 2 mm deep:

- 234 mm3 of subchondral bone are removed,
- the thrust peaks at 94 N,
- the torque peaks at 0.90 N m.

These values depend on cutting coefficients of low confidence (`tissue/materials/cutting.toml`). The
values are plausible, not validated. If the coefficients are drawn from the ranges of the cited
sources, 90 % of the peak thrusts lie between 41 and 361 N. The interval for 90 % of the peak
torques is 0.38 to 3.5 N m (`tissue run glenoid --band 4096`).
"""

from pathlib import Path

import matplotlib.pyplot as plt
import pyvista

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)

# %%
# A scene contains bone, tool and path. `tissue.load_scene("glenoid", {"voxels.spacing_mm": 0.2})`
# would change one key of the scene. The trace of a run has a row for each tick of 1 ms.

run = tissue.simulate(tissue.load_scene("glenoid"))
removed = run.trace["removed_mm3"][-1]
thrust = run.trace["model_force_z_N"].max()
torque = run.trace["model_torque_z_Nm"].max()
print(f"removed {removed:.1f} mm3, peak thrust {thrust:.1f} N, peak torque {torque:.3f} N m")
print(f"tick: median {run.summary['tick_us']['median']:.0f} us")
assert abs(removed - 234.4) < 0.5
assert abs(thrust - 94.5) < 1.0
assert abs(torque - 0.901) < 0.01

# %%
# Thrust and torque increase with the contact area between reamer and bone, until the feed ends at a
# depth of 2 mm.

depth = -run.trace["tool_z_mm"]
fed = depth < 1.9995
figure, panels = plt.subplots(3, 1, sharex=True, figsize=(7.0, 6.0), layout="constrained")
for panel, column, label in zip(
    panels,
    ("model_force_z_N", "model_torque_z_Nm", "removed_mm3"),
    ("thrust / N", "torque / N m", "removed / mm³"),
    strict=True,
):
    panel.plot(depth[fed], run.trace[column][fed], color="#0072B2", linewidth=1.8)
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)
panels[0].set_title("Hemispherical reamer of 30 mm fed into a glenoid at 0.5 mm/s")
panels[2].set_xlabel("depth of the reamer / mm")
figure.savefig(FIGURES / "01_force.png", dpi=150)

# %%
# The carved surface is a pyvista mesh. Each point of the mesh has the depth of the bone that was
# removed above this point.

surface = run.surface()
plotter = pyvista.Plotter(off_screen=True, window_size=[1000, 800])
plotter.add_mesh(
    surface,
    scalars="removed_depth_mm",
    cmap="viridis",
    scalar_bar_args={
        "title": "removed / mm",
        "vertical": True,
        "fmt": "%.1f",
        "position_x": 0.82,
        "position_y": 0.2,
    },
)
plotter.camera_position = [(15.0, -55.0, 75.0), (5.0, 0.0, -4.0), (0.0, 1.0, 0.0)]
plotter.screenshot(FIGURES / "01_bone.png")
