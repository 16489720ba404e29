"""
Press a liver and look inside
=============================

A ball presses a liver. The example shows the force as a function of depth, and the displacement and
stress in the liver.

Expected:

- The force is 0.285 N at a depth of 5 mm, with a ball of 20 mm on tissue with a modulus of 5.4 kPa.
  This is 0.86 of the Hertz force for a half-space. There are two reasons: the surface is a dome
  that yields, and Hertz replaces the ball by a parabola that is steeper than the ball.
- The tissue under the ball moves down nearly as far as the ball.
- The von Mises stress is largest within one radius below the ball.

The cells of the mesh are quadratic, and small only under the ball. If the small cells or the large
cells are halved in size, the force changes by about 1 %. The run reports the depth above which the
error of linear elasticity exceeds 5 %. In the cited sources, the modulus is 2 to 15 kPa. The force
is proportional to the modulus, so nine of ten livers have a force between 0.11 and 0.79 N.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
DEPTH_MM = 5.0
RADIUS_MM = 10.0
YOUNG_PA = 5.4e3
POISSON = 0.49

# %%
# A ball presses the built-in liver straight down. The law is linear. The last frame of the run has
# the displacement and stress fields.

changes = {
    "organ.material": "liver",
    "organ.law": "linear",
    "motion.points_mm": [[0, 0, 1], [0, 0, -DEPTH_MM]],
    "motion.feed_mm_s": 50.0,
    "organ.interval_ms": 119.0,
}
run = tissue.simulate(tissue.load_scene("liver-press", changes))
depth = -run.trace["tool_z_mm"]
force = run.trace["model_force_z_N"]
hertz_N = (
    4
    / 3
    * YOUNG_PA
    / (1 - POISSON**2)
    * np.sqrt(1e-3 * RADIUS_MM)
    * (1e-3 * np.maximum(depth, 0.0)) ** 1.5
)
ratio = force[-1] / hertz_N[-1]
print(f"force at {depth[-1]:.1f} mm: {force[-1]:.3f} N, {ratio:.2f} of Hertz on a half-space")
print(run.events[0][1])
assert abs(force[-1] - 0.285) < 0.01
assert abs(ratio - 0.86) < 0.03
assert [what.split(":")[0] for _, what in run.events] == ["pressed 3.3 mm deep"]

# %%
# The mesh of the last frame is a pyvista mesh, with the displacement at the points and the stress
# in the cells.

mesh = run.dataset()
moved = mesh.point_data["displacement_mm"]
stress = mesh.cell_data["von_mises_kPa"]
under = int(np.argmin(np.linalg.norm(mesh.points, axis=1)))
away = float(np.linalg.norm(mesh.cell_centers().points[np.argmax(stress)]))
print(f"the surface at the ball's middle has moved by {-moved[under, 2]:.1f} mm")
print(f"largest von Mises stress {stress.max():.1f} kPa, {away:.1f} mm from where the ball came in")
assert abs(-moved[under, 2] - DEPTH_MM) < 1.0
assert away < RADIUS_MM

# %%
# Plot the force as a function of depth, compared with Hertz's solution.

figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
axes.plot(depth, force, color="#0072B2", linewidth=2.2, label="liver")
axes.plot(
    depth, hertz_N, color="0.3", linestyle="--", label="Hertz, half-space of the same modulus"
)
axes.set(
    xlabel="depth of the ball's tip / mm",
    ylabel="force / N",
    xlim=(0.0, DEPTH_MM),
    ylim=(0.0, None),
)
axes.grid(alpha=0.3)
axes.legend()
axes.set_title(f"Ball of {2 * RADIUS_MM:g} mm on the dome of a liver of {1e-3 * YOUNG_PA:g} kPa")
figure.savefig(FIGURES / "05_force.png", dpi=150)

# %%
# Show the deformed liver, cut open through the ball. At a distance of a few ball radii, the
# displacement is small.

bent = mesh.warp_by_vector("displacement_mm")
half = bent.clip("y", origin=(0.0, 0.0, 0.0), invert=False)
plotter = pyvista.Plotter(off_screen=True, window_size=[1100, 760])
plotter.add_mesh(
    half,
    scalars="displacement_mm",
    cmap="YlGnBu",
    lighting=False,
    scalar_bar_args={
        "title": "moved / mm\n",
        "fmt": "%.1f",
        "n_labels": 5,
        "position_x": 0.2,
        "position_y": 0.87,
    },
)
ball = pyvista.Sphere(radius=RADIUS_MM, center=(0.0, 0.0, RADIUS_MM - DEPTH_MM))
plotter.add_mesh(ball, color="lightgrey", smooth_shading=True)
plotter.camera_position = [(30.0, -330.0, 60.0), (20.0, 0.0, -20.0), (0.0, 0.0, 1.0)]
plotter.screenshot(FIGURES / "05_inside.png")
