"""
Your organ with a stiff cyst
============================

A kidney with a modulus of 10 kPa and a cyst of 60 kPa are made from two closed surfaces. A ball
presses the kidney at five places to locate the cyst.

Expected at a depth of 3 mm with a ball of 20 mm: the force is about 0.3 N. Above the cyst, it is
0.56 to 0.67 N, which is twice as much.

The tetrahedra differ each time the mesh is made. They are linear, because this is faster. Forces
are therefore somewhat too large (use `order=2` for accurate values). The moduli are invented.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pyvista

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)

# %%
# Your own surfaces come from files or from pyvista. In this example, the surfaces are a bean and a
# ball inside the bean.

kidney = pyvista.Sphere(radius=1.0, theta_resolution=24, phi_resolution=24)
x, y, z = np.asarray(kidney.points).T
dent = 0.35 * np.exp(-((y / 0.35) ** 2)) * (x > 0.0) * x**2
kidney.points = np.column_stack([27.0 * (x - dent), 55.0 * y, 20.0 * z])
cyst = pyvista.Sphere(radius=9.0, center=(-6.0, 20.0, 8.0), theta_resolution=12, phi_resolution=12)

organ = tissue.Organ.from_surface(
    kidney,
    modulus_kPa=10.0,
    poisson_ratio=0.45,
    edge_mm=8.0,
    inclusions={"cyst": cyst},
    parts={"cyst": 60.0},
    order=1,
)
places_mm = [(-6.0, y, 18.0) for y in (-40.0, -20.0, 0.0, 20.0, 40.0)]
organ = organ.refined(edge_mm=3.0, near_mm=places_mm)
print(organ)

# %%
# Each press starts from the undeformed organ. Earlier presses have no effect.

ball = tissue.ball(diameter_mm=20.0)
presses = [
    organ.press(ball, depth_mm=3.0, at_mm=place, along=(0.0, 0.0, -1.0)) for place in places_mm
]
for press in presses:
    print(press)
forces = np.array([press.force_magnitude_N for press in presses])
elsewhere = np.delete(forces, 3)
assert np.argmax(forces) == 3 and 1.6 < forces[3] / np.median(elsewhere) < 2.5
assert 0.5 < forces[3] < 0.75 and np.all(np.abs(elsewhere - 0.31) < 0.06)

# %%
# Plot the force as a function of depth at the five places.

figure, axes = plt.subplots(figsize=(7.5, 4.4), layout="constrained")
for place, press, colour in zip(
    places_mm, presses, ("#0072B2", "#56B4E9", "#009E73", "#D55E00", "#E69F00"), strict=True
):
    axes.plot(
        press.depth_mm,
        -press.forces_N @ press.along,
        color=colour,
        lw=2,
        label=f"y = {place[1]:g} mm",
    )
axes.set(
    xlabel="depth / mm", ylabel="force against the ball / N", xlim=(0.0, 3.0), ylim=(0.0, None)
)
axes.set_title("A ball of 20 mm on a kidney: the cyst lies at y = 20 mm")
axes.grid(alpha=0.3)
axes.legend()
figure.savefig(FIGURES / "15_force.png", dpi=150)

# %%
# Show the organ pressed above the cyst, cut open through the places. The stress passes through the
# cyst, which hardly deforms.

half = presses[3].mesh.clip("x", origin=(-6.0, 0.0, 0.0), crinkle=True)
plotter = pyvista.Plotter(off_screen=True, window_size=[1100, 620])
plotter.add_mesh(
    half,
    scalars="von_mises_kPa",
    cmap="viridis",
    clim=[0.0, 4.0],
    show_edges=True,
    scalar_bar_args={
        "title": "von Mises stress / kPa",
        "fmt": "%.0f",
        "position_x": 0.3,
        "position_y": 0.86,
    },
)
plotter.add_mesh(cyst, color="#D55E00", style="wireframe", line_width=2)
plotter.camera_position = [(140.0, 0.0, 25.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0)]
plotter.screenshot(FIGURES / "15_inside.png")
