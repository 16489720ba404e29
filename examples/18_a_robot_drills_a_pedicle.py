"""
A robot drills a pedicle
========================

A robot arm in MuJoCo drills the pedicle of a lumbar vertebra. `tissue.Loop` gives the force on the
drill in every millisecond, and MuJoCo moves the arm under this force.

The arm is under admittance control, which computes the feed of the drill from the thrust. The arm
pauses when the drill breaks through the cortex, and then continues to a depth of 15 mm. The arm
stops the drill 1 mm before the spinal canal.

Needs ``pip install mujoco``.
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import mujoco
import numpy as np
import pyvista
from numpy.typing import NDArray

import tissue

Floats = NDArray[np.float64]
FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
ENTRY_M = np.array([0.5, 0.0, 0.15])
"""Origin of the scene in the frame of the robot [m]; the axes of both frames are parallel."""

# %%
# The arm has six joints. The last joint carries the drill, whose tip is at the site ``tip``. A step
# of MuJoCo takes 1 ms, which is also the duration of a tick of the tissue.

ARM = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom type="capsule" size="0.04" density="1200" contype="0" conaffinity="0"/>
    <joint damping="1" armature="0.1"/></default>
  <worldbody><body pos="0 0 0.3">
    <joint axis="0 0 1"/><geom fromto="0 0 -0.1 0 0 0.1" size="0.06"/>
    <body pos="0 0 0.1">
      <joint axis="0 1 0"/><geom fromto="0 0 0 0 0 0.4" size="0.05"/>
      <body pos="0 0 0.4">
        <joint axis="0 1 0"/><geom fromto="0 0 0 0 0 0.1"/>
        <body pos="0 0 0.1">
          <joint axis="0 0 1"/><geom fromto="0 0 0 0 0 0.25" size="0.035"/>
          <body pos="0 0 0.25">
            <joint axis="0 1 0"/><geom fromto="0 0 0 0 0 0.08" size="0.035"/>
            <body pos="0 0 0.08" name="drill">
              <joint axis="0 0 1"/><geom fromto="0 0 0 0 0 0.1" size="0.03"/>
              <geom fromto="0 0 0.1 0 0 0.18" size="0.0016"/>
              <site name="tip" pos="0 0 0.18" euler="180 0 0"/>
            </body></body></body></body></body></body></worldbody>
</mujoco>
"""


class Arm:
    """Arm that holds a drill at a pose by torques at the joints.

    The torques are computed from the inertia of the arm at its tip (Khatib 1987, IEEE J. Robot.
    Autom. 3:43). The measured force of the bone is added.
    """

    stiffness_per_kg = 150.0**2  # natural frequency of 150 rad/s, 24 Hz, critically damped

    def __init__(self) -> None:
        self.model: Any = mujoco.MjModel.from_xml_string(ARM)
        self.data: Any = mujoco.MjData(self.model)
        self.tip = self.data.site("tip")
        self.drill = self.model.body("drill").id
        self.columns = np.zeros((6, self.model.nv))
        self.yields = np.zeros((6, self.model.nv))

    def place(self, tip_m: Floats, turn: Floats) -> None:
        """Find joint angles for a pose by damped Newton steps that start from a bent arm."""
        self.data.qpos[:] = [0.0, 0.2, 1.4, 0.0, 1.5, 0.0]
        for _ in range(200):
            mujoco.mj_forward(self.model, self.data)
            error = self.error(tip_m, turn)
            jacobian = self.jacobian()
            normal = jacobian @ jacobian.T + 1e-6 * np.eye(6)
            self.data.qpos += jacobian.T @ np.linalg.solve(normal, np.clip(error, -0.1, 0.1))
        assert np.abs(error).max() < 1e-6, "the arm reaches the entry"

    def jacobian(self) -> Floats:
        """Return the Jacobian of the tip: velocity and angular velocity per joint, shape (6, 6)."""
        mujoco.mj_jacSite(self.model, self.data, self.columns[:3], self.columns[3:], self.tip.id)
        return self.columns

    def poses(self) -> Floats:
        """Return poses of the arm's parts in the frame of the scene [mm], shape (parts, 4, 4)."""
        poses = np.tile(np.eye(4), (self.model.ngeom, 1, 1))
        poses[:, :3, :3] = self.data.geom_xmat.reshape(-1, 3, 3)
        poses[:, :3, 3] = 1e3 * (self.data.geom_xpos - ENTRY_M)
        return poses

    def error(self, tip_m: Floats, turn: Floats) -> Floats:
        """Return distance [m] and small rotation [rad] from the tip to a pose, shape (6,)."""
        now = self.tip.xmat.reshape(3, 3)
        about = 0.5 * sum(np.cross(now[:, axis], turn[:, axis]) for axis in range(3))
        return np.concatenate([tip_m - self.tip.xpos, about])

    def step(self, tip_m: Floats, velocity: Floats, turn: Floats, wrench: Floats) -> None:
        """Hold the tip at a moving pose for 1 ms, while the wrench of the bone acts."""
        data = self.data
        jacobian = self.jacobian()
        mujoco.mj_solveM(self.model, data, self.yields, jacobian)
        at_tip = np.linalg.inv(jacobian @ self.yields.T)
        rate = np.concatenate([velocity, np.zeros(3)]) - jacobian @ data.qvel
        stiffness = self.stiffness_per_kg
        wanted = stiffness * self.error(tip_m, turn) + 2.0 * np.sqrt(stiffness) * rate
        data.qfrc_applied[:] = data.qfrc_bias + jacobian.T @ (at_tip @ wanted - wrench)
        # MuJoCo applies the force at the centre of mass of the body.
        arm_m = self.tip.xpos - data.xipos[self.drill]
        data.xfrc_applied[self.drill] = wrench
        data.xfrc_applied[self.drill, 3:] += np.cross(arm_m, wrench[:3])
        mujoco.mj_step(self.model, data)


# %%
# Admittance control computes the feed v from the thrust: M dv/dt + D v = wanted thrust - thrust.
# The thrust is the measured force along the drill, after a low-pass filter of 5 ms. The drill has
# broken through if the thrust has fallen to 40 % of its maximum. The arm stops if the distance from
# the canal is too small.

THRUST_N = 30.0
DAMPING_N_S_M = 8e3
MASS_KG = 40.0
FASTEST_M_S = 2.5e-3
"""Largest feed [m/s]. The chips are 0.075 mm thick; the cutting law holds up to 0.1 mm."""
LOW_PASS = 1.0 - np.exp(-1.0 / 5.0)
FALLS_TO = 0.4
HOLD_TICKS = 300
"""Time for which the drill is held after an event [ms]."""
CLEAR_MM = 1.0
"""Distance from the canal at which the drill stops [mm]."""


FRAME_TICKS = 100
"""Time between two pictures of the movie [ms]. The movie plays at twice the speed."""


def drill(
    arm: Arm, loop: tissue.Loop, entry_mm: Floats, turn: Floats, depth_mm: float
) -> tuple[Floats, dict[str, int], list[Floats]]:
    """Drill from 1 mm above an entry to a depth.

    Return the record, the tick of each event and the poses of the arm.

    A row of the record holds thrust [N], feed [mm/s], depth [mm], distance from the canal [mm] and
    distance of the tip from the planned axis [mm]. For each picture of the movie there is an array
    with the poses of the arm's parts, shape (parts, 4, 4) [mm].
    """
    axis = turn[:, 2]
    above_m = 1e-3 * entry_mm + 1e-3 * axis
    arm.place(ENTRY_M + above_m, turn)
    pose = np.eye(4)

    def seen() -> Floats:
        """Return the pose of the drill in the frame of the scene [mm]."""
        pose[:3, :3] = arm.tip.xmat.reshape(3, 3)
        pose[:3, 3] = 1e3 * (arm.tip.xpos - ENTRY_M)
        return pose

    loop.reset(seen())
    rows: list[list[float]] = []
    poses: list[Floats] = []
    events: dict[str, int] = {}
    thrust = feed = travel_m = most = 0.0
    hold = 0
    for tick in range(9000):
        wrench = loop.step(seen())
        thrust += LOW_PASS * (wrench[:3] @ axis - thrust)
        moved_mm = 1e3 * (arm.tip.xpos - ENTRY_M) - entry_mm
        depth = float(-moved_mm @ axis)
        aside = float(np.linalg.norm(np.cross(moved_mm, axis)))
        canal = loop.row["distance_canal_mm"]
        rows.append([thrust, 1e3 * feed, depth, canal, aside])
        if tick % FRAME_TICKS == 0:
            poses.append(arm.poses())
        most = max(most, thrust)
        if "through" not in events and most > 0.5 * THRUST_N and thrust < FALLS_TO * most:
            events["through"] = tick
            hold = HOLD_TICKS
        if "end" not in events and (canal < CLEAR_MM or depth >= depth_mm):
            events["end"] = tick
            hold = HOLD_TICKS
        wanted = 0.0 if hold else THRUST_N - thrust
        feed += 1e-3 * (wanted - DAMPING_N_S_M * feed) / MASS_KG
        feed = 0.0 if hold else min(max(feed, 0.0), FASTEST_M_S)
        hold -= hold > 0
        if "end" in events and not hold:
            break
        travel_m += 1e-3 * feed
        arm.step(ENTRY_M + above_m - travel_m * axis, -feed * axis, turn, wrench)
    return np.array(rows), events, poses


def tilted(degrees: float) -> Floats:
    """Return the axes of a drill that is tilted towards the canal."""
    cosine = np.cos(np.radians(degrees))
    sine = np.sin(np.radians(degrees))
    return np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]])


# Voxels of 0.15 mm instead of 0.1 mm change the thrust by less than 1 %.
scene = tissue.load_scene("pedicle", {"voxels.spacing_mm": 0.15})
loop = tissue.Loop(scene, reach_mm=6.0)
arm = Arm()
vertebra = loop.surface()
planned, events, poses = drill(arm, loop, np.zeros(3), tilted(0.0), 15.0)
shape = np.array([arm.data.xpos[body] for body in range(1, arm.model.nbody)] + [arm.tip.xpos])
drilled = loop.surface()
aimed, guarded, _ = drill(arm, loop, np.array([2.0, 0.0, 0.0]), tilted(20.0), 20.0)

# %%
# Expected: the thrust in the cortex is 23 to 25 N. It is below the wanted 30 N because of the
# damping of the feed. The drill pauses at the break-through, 1.2 to 1.6 mm below the entry. It then
# reaches a depth of 15 mm, at a distance of 6 mm from the canal and within 0.02 mm of the planned
# axis. A second drill is aimed 20 degrees wrong. It reaches the cortex of the canal at a depth of
# 12.5 mm, and stops 1 mm before the canal.

through, end = events["through"], events["end"]
stopped = planned[through + HOLD_TICKS - 1]
print(f"largest thrust {planned[:, 0].max():.1f} N")
print(
    f"break-through at {1e-3 * through:.2f} s and {planned[through, 2]:.2f} mm, "
    f"stopped after {abs(stopped[2] - planned[through, 2]):.3f} mm"
)
print(
    f"planned: {planned[end, 2]:.2f} mm deep, canal {planned[:, 3].min():.2f} mm away, "
    f"{1e3 * planned[:, 4].max():.1f} um off the axis"
)
print(f"wrong aim: stopped at {aimed[-1, 2]:.2f} mm, canal {aimed[:, 3].min():.2f} mm away")
assert 22.0 < planned[:, 0].max() < 26.0
assert 1.2 < planned[through, 2] < 1.6 and abs(stopped[2] - planned[through, 2]) < 0.05
assert abs(planned[end, 2] - 15.0) < 0.05 and planned[:, 4].max() < 0.02
assert 5.8 < planned[:, 3].min() < 6.5
assert 0.95 < aimed[:, 3].min() <= CLEAR_MM and 12.0 < aimed[-1, 2] < 14.0

figure = plt.figure(figsize=(10, 6.4), layout="constrained")
halves: Any = figure.subfigures(1, 2, width_ratios=[1, 2])
left, right = halves
side = left.subplots()
side.plot(shape[:-1, 0], shape[:-1, 2], "-o", color="0.3", linewidth=5, markersize=9)
side.plot(shape[-2:, 0], shape[-2:, 2], color="#D55E00", linewidth=2, label="drill")
side.plot([0, 0], [0, shape[0, 2]], color="0.3", linewidth=9)
side.plot(*ENTRY_M[[0, 2]], "s", color="#8C6D46", markersize=14, zorder=0, label="vertebra")
side.set(xlabel="x / m", ylabel="z / m", aspect="equal", title="arm at 15 mm of depth")
side.legend(loc="lower left")
panels = right.subplots(3, 1, sharex=True)
for record, colour, name in ((planned, "#0072B2", "planned"), (aimed, "#CC79A7", "wrong aim")):
    time_s = 1e-3 * np.arange(len(record))
    for panel, column in zip(panels, (0, 1, 3), strict=True):
        panel.plot(time_s, record[:, column], color=colour, label=name)
panels[0].axvline(1e-3 * through, color="0.5", linestyle=":")
panels[0].annotate(
    "break-through", (1e-3 * through, 18.0), (2.6, 20.0), arrowprops={"arrowstyle": "->"}
)
panels[2].axhline(CLEAR_MM, color="0.5", linestyle="--", label="allowed distance")
for panel, label in zip(
    panels, ("thrust / N", "feed / mm/s", "distance from\nthe canal / mm"), strict=True
):
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)
panels[2].set_xlabel("time / s")
panels[2].legend(loc="upper right")
figure.savefig(FIGURES / "18_robot.png", dpi=150)

# %%
# The movie shows the whole arm, and the rear half of the vertebra's surface with the drill. The
# movie ends with the drilled bone.


def movie(vertebra: Any, drilled: Any, poses: list[Floats], record: Floats) -> None:
    """Write the movie of the planned drilling."""
    plotter = pyvista.Plotter(off_screen=True, shape=(1, 2), window_size=[700, 480])
    parts: list[Any] = []
    bones: list[Any] = []
    for view in range(2):
        plotter.subplot(0, view)
        shown = vertebra if view == 0 else vertebra.clip("-y", origin=(0.0, 0.0, 0.0))
        bones.append(plotter.add_mesh(shown, color="#E8D9B5", smooth_shading=view == 0))
        for part in range(arm.model.ngeom):
            radius, half = 1e3 * arm.model.geom_size[part, :2]
            rod = pyvista.Cylinder(direction=(0, 0, 1), radius=radius, height=2 * half)
            last = part == arm.model.ngeom - 1
            colour = "#D55E00" if last else "#8899AA"
            parts.append(plotter.add_mesh(rod, color=colour, show_edges=False))
    plotter.subplot(0, 0)
    plotter.camera_position = [(300, -1500, 450), (-250, 0, 250), (0, 0, 1)]
    plotter.subplot(0, 1)
    plotter.camera_position = [(8, -75, 18), (0, 0, -6), (0, 0, 1)]
    text = plotter.add_text("", position="upper_left", font_size=10, color="black")

    plotter.open_gif(FIGURES / "18_robot.gif", fps=20)
    for index, pose in enumerate(poses):
        for actor, matrix in zip(parts, [*pose, *pose], strict=True):
            actor.user_matrix = matrix
        thrust, _, depth, canal, _ = record[FRAME_TICKS * index]
        text.set_text(
            "upper_left",
            f"thrust {thrust:.0f} N\ndepth {depth:.1f} mm\ncanal {canal:.1f} mm away",
        )
        plotter.write_frame()
    bones[1].mapper.dataset = drilled.clip("-y", origin=(0.0, 0.0, 0.0))
    for actor in parts[len(parts) // 2 :]:
        actor.visibility = False
    for _ in range(10):
        plotter.write_frame()
    plotter.close()


movie(vertebra, drilled, poses, planned)
