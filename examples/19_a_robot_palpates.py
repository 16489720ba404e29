"""
A robot palpates soft tissue
============================

A SCARA robot in MuJoCo slides a fingertip over soft tissue under a constant force. The robot finds
a stiff nodule, because the finger sinks in less above the nodule. MuJoCo and `tissue.Loop` both
take steps of 2 ms.

Needs ``pip install mujoco``.
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import mujoco
import numpy as np
from numpy.typing import NDArray

import tissue

Floats = NDArray[np.float64]
FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
SLAB_M = np.array([0.4, 0.0, 0.1])
"""Origin of the scene, on the surface of the slab, in the frame of the robot [m]."""
STEP_S = 0.002

# %%
# Two links rotate in a plane, and a vertical slide carries the fingertip. In the plane, stiff
# position control moves the joints. Along the slide the robot is under force control.

ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <default><geom type="capsule" density="1500" contype="0" conaffinity="0"/></default>
  <worldbody><body pos="0 0 0.3">
    <joint name="shoulder" axis="0 0 1" damping="0.5"/><geom fromto="0 0 0 0.25 0 0" size="0.03"/>
    <body pos="0.25 0 0">
      <joint name="elbow" axis="0 0 1" damping="0.5"/><geom fromto="0 0 0 0.25 0 0" size="0.025"/>
      <body pos="0.25 0 0" name="finger">
        <joint name="slide" type="slide" axis="0 0 1" damping="2"/>
        <geom fromto="0 0 0 0 0 -0.18" size="0.008"/><site name="tip" pos="0 0 -0.188"/>
      </body></body></body></worldbody>
</mujoco>
"""
NATURAL_RAD_S = np.array([60.0, 60.0, 200.0])
"""Natural frequency of shoulder, elbow and slide under control; critically damped."""
LINKS_M = 0.25


def angles(x_m: float, y_m: float) -> Floats:
    """Return the angles of shoulder and elbow for a position of the finger [rad], shape (2,)."""
    square = (x_m**2 + y_m**2 - 2.0 * LINKS_M**2) / (2.0 * LINKS_M**2)
    elbow = -np.arccos(square)
    return np.array([np.arctan2(y_m, x_m) - 0.5 * elbow, elbow])


class Scara:
    """Robot whose joints follow the accelerations of a critically damped controller."""

    def __init__(self) -> None:
        self.model: Any = mujoco.MjModel.from_xml_string(ARM)
        self.data: Any = mujoco.MjData(self.model)
        self.tip = self.data.site("tip")
        self.finger = self.model.body("finger").id
        self.torque = np.zeros(3)

    def step(self, joints: Floats, rates: Floats, wrench: Floats) -> None:
        """Follow joint positions and rates for 2 ms, while the wrench of the tissue acts."""
        data = self.data
        damping = 2.0 * NATURAL_RAD_S * (rates - data.qvel)
        wanted = NATURAL_RAD_S**2 * (joints - data.qpos) + damping
        mujoco.mj_mulM(self.model, data, self.torque, wanted)
        data.qfrc_applied[:] = self.torque + data.qfrc_bias
        data.qfrc_applied[2] -= wrench[2]
        # MuJoCo applies the force at the centre of mass of the body.
        arm_m = self.tip.xpos - data.xipos[self.finger]
        data.xfrc_applied[self.finger] = wrench
        data.xfrc_applied[self.finger, 3:] += np.cross(arm_m, wrench[:3])
        mujoco.mj_step(self.model, data)


# %%
# The slab has a modulus of 5 kPa, and contains a nodule of 18 mm at x = -20 mm, 8 mm under the
# surface. The finger lands at x = -45 mm and slides at 20 mm/s. Admittance control moves the finger
# down while the force is below the wanted force, and up while the force is above the wanted force.

FORCE_N = 0.1
DAMPING_N_S_M = 3.0
DESCENT_M_S = 0.01
SLIDE_M_S = 0.02
FROM_M, TO_M = -0.045, 0.01

scene = tissue.load_scene("palpation", {"organ.young_end_kPa": 5.0})
loop = tissue.Loop(scene, step_ms=2)
robot = Scara()
robot.data.qpos[:2] = angles(SLAB_M[0] + FROM_M, 0.0)
# 2 mm above the surface: without the slide the tip is at a height of 112 mm.
height_m = robot.data.qpos[2] = SLAB_M[2] + 0.002 - 0.112
mujoco.mj_forward(robot.model, robot.data)
loop.reset(1e3 * (robot.tip.xpos - SLAB_M))
place_m = FROM_M
wrench = np.zeros(6)
rows = []
landed = 0
while place_m < TO_M:
    # The finger begins to slide after it has pressed for 0.5 s.
    landed += bool(wrench[2] > 0.5 * FORCE_N)
    slide = SLIDE_M_S if landed > 250 else 0.0
    rise = float(np.clip((wrench[2] - FORCE_N) / DAMPING_N_S_M, -DESCENT_M_S, DESCENT_M_S))
    place_m += slide * STEP_S
    height_m += rise * STEP_S
    before = angles(SLAB_M[0] + place_m - slide * STEP_S, 0.0)
    joints = angles(SLAB_M[0] + place_m, 0.0)
    rates = np.append((joints - before) / STEP_S, rise)
    robot.step(np.append(joints, height_m), rates, wrench)
    tip_mm = 1e3 * (robot.tip.xpos - SLAB_M)
    wrench = loop.step(tip_mm)
    rows.append([*tip_mm, wrench[2], slide])

# %%
# Expected: the force stays within 3 % of 0.1 N while the finger slides. The depth of the finger is
# 2.6 mm next to the nodule and 2.3 mm above the nodule. The robot takes the mean position of the
# highest quarter of the path. It is within 2 mm of the centre of the nodule.

x_mm, _, z_mm, force_N, slides = np.array(rows).T
slid = slides > 0.0
above = np.clip(z_mm[slid] - np.quantile(z_mm[slid], 0.75), 0.0, None)
found_mm = float(above @ x_mm[slid] / above.sum())
print(f"force {force_N[slid].min():.4f} to {force_N[slid].max():.4f} N while sliding")
print(f"height of the tip {z_mm[slid].min():.2f} to {z_mm[slid].max():.2f} mm")
print(f"nodule found at x = {found_mm:.1f} mm, its centre is at -20 mm")
assert np.abs(force_N[slid] / FORCE_N - 1.0).max() < 0.03
assert -2.8 < z_mm[slid].min() < -2.5 and -2.4 < z_mm[slid].max() < -2.1
assert abs(found_mm + 20.0) < 2.0 and not loop.events

figure, (top, bottom) = plt.subplots(2, 1, figsize=(7.5, 5.6), sharex=True, layout="constrained")
top.plot(x_mm[slid], z_mm[slid], color="#0072B2", label="tip of the finger")
top.axvspan(-29.0, -11.0, color="#D55E00", alpha=0.15, label="nodule, 8 mm under the surface")
top.axvline(found_mm, color="#D55E00", linestyle="--", label="estimated centre")
top.set(ylabel="height of the tip / mm")
top.legend()
bottom.plot(x_mm[slid], 1e3 * force_N[slid], color="#0072B2")
bottom.axhline(1e3 * FORCE_N, color="0.4", linestyle=":", label="target")
bottom.set(xlabel="x / mm", ylabel="force / mN", ylim=(90.0, 110.0))
bottom.legend()
for panel in (top, bottom):
    panel.grid(alpha=0.3)
figure.savefig(FIGURES / "19_palpation.png", dpi=150)
