"""
Your bone, your toolpath
========================

Two bones with different densities are made from a closed surface. A burr follows a path of points
at two feeds in each bone. The four cuts are compared and written for MATLAB.

Expected:

- At twice the feed, the mean force is only 1.19 times as large. Chips are thin, so most of the
  force is the edge force, which does not depend on the chip thickness.
- At 1.5 times the density, the force is 1.84 times as large. This is the density ratio to the power
  1.5, as in the cutting coefficients.
- All four cuts remove 12.5 mm3.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)

# %%
# Use any closed STL, OBJ, PLY or VTK file in millimetres. This example first writes such a file: a
# shaft with a thicker end.

z = np.linspace(-20.0, 20.0, 60)
profile = np.column_stack([8.0 + 2.0 * (z / 20.0) ** 2, np.zeros(60), z])
outline = np.vstack([[0.0, 0.0, -20.0], profile, [0.0, 0.0, 20.0]])
shaft = pyvista.lines_from_points(outline).extrude_rotate(resolution=80, capping=False)
shaft = shaft.extract_surface(algorithm=None).triangulate().clean().rotate_y(90.0)
burr = tissue.cutters.ball_burr(diameter_mm=4.0, flutes=6, spin_rpm=2_000)

# %%
# The path follows the shaft in three waves, 0.4 mm below its highest line.

x = np.linspace(-8.0, 8.0, 81)
path_mm = np.column_stack(
    [x, 1.5 * np.sin(3.0 * np.pi * x / 8.0), 8.0 - 0.4 + 2.0 * (x / 20.0) ** 2]
)
cuts: dict[tuple[float, float], tissue.Cut] = {}
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "shaft.stl"
    shaft.save(file)
    for density in (1200.0, 1800.0):
        whole = tissue.Bone.from_file(
            file, spacing_mm=0.2, scale_mm=1.0, cortical_density_kg_m3=density
        )
        for feed in (5.0, 10.0):
            bone = whole.uncut()
            cuts[density, feed] = bone.cut(burr, *tissue.feed_along(path_mm, feed_mm_s=feed))
    exported = cuts[1800.0, 10.0].save(Path(folder) / "cut.mat")
    print(f"{exported.name} for MATLAB: {exported.stat().st_size / 1024:.0f} KiB")

means = {}
for (density, feed), cut in cuts.items():
    means[density, feed] = float(np.linalg.norm(cut.force_N, axis=1)[len(cut) // 4 :].mean())
    print(
        f"{density:g} kg/m3, {feed:g} mm/s: {means[density, feed]:.3f} N, "
        f"{cut.removed_mm3[-1]:.1f} mm3"
    )
by_feed = means[1800.0, 10.0] / means[1800.0, 5.0]
by_density = means[1800.0, 5.0] / means[1200.0, 5.0]
print(
    f"twice the feed: {by_feed:.2f} times the force; 1.5 times the density: {by_density:.2f} times"
)
assert abs(by_feed - 1.19) < 0.02 and abs(by_density - 1.84) < 0.02
assert all(abs(cut.removed_mm3[-1] - 12.5) < 0.2 for cut in cuts.values())

# %%
# Plot the force of the four cuts as a function of the position along the shaft.

figure, axes = plt.subplots(figsize=(8, 4.2), layout="constrained")
for ((density, feed), cut), line in zip(cuts.items(), ("--", "-", "--", "-"), strict=True):
    colour = "#D55E00" if density > 1500.0 else "#0072B2"
    force = np.linalg.norm(cut.force_N, axis=1)
    axes.plot(
        cut.tip_mm[1:, 0], force[1:], line, color=colour, label=f"{density:g} kg/m³, {feed:g} mm/s"
    )
axes.set(xlabel="position along the shaft / mm", ylabel="force on the burr / N", ylim=(0.0, None))
axes.set_title("Ball burr of 4 mm along a wavy groove")
axes.grid(alpha=0.3)
axes.legend(ncols=2)
figure.savefig(FIGURES / "14_cuts.png", dpi=150)

# %%
# Show the bone after the cuts.

plotter = pyvista.Plotter(off_screen=True, window_size=[1000, 560])
plotter.add_mesh(bone.surface(), color="#E8DCC8", smooth_shading=True, split_sharp_edges=True)
plotter.camera_position = [(18.0, -38.0, 50.0), (0.0, 0.0, 2.0), (0.0, 0.0, 1.0)]
plotter.screenshot(FIGURES / "14_bone.png")
