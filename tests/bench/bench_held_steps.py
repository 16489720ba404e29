"""Course of a tool in a hand against that with a step ten times smaller.

Run: `python tests/bench/bench_held_steps.py [--hands 30] [--seconds 3] [SCENE ...]`.

For each scene and hand, the closed loop runs once, and what the tool follows is recorded: position,
orientation and velocity of the device behind its observer. The tool then follows the record in new
bone, once in steps of a tick and once in a tenth of it. In between, the record is interpolated.
Compared are means over ticks:

- speed: power of the tool's velocity above 50 Hz with a step of a tick, over that with a tenth.
- touch: difference of the impulses within 20 ms of the first contact, over the impulse there.
- peak: largest difference of the forces there, over the largest force.
- end: largest difference of the velocities within 40 ms after the last contact, over the largest
  velocity there.
- force: RMS difference of the forces, over the RMS force.
- drops: ticks in contact with less than a tenth of the mean force of 50 ms, with a step of a tick
  and with a tenth.

The bench fails if steps of a tick do not repeat the course of the closed loop.
"""

import argparse
from dataclasses import dataclass

import numpy as np
from bench_held_tool import SEED, scene_of
from harness import machine, table
from scipy.ndimage import uniform_filter1d

from meshes.base.arrays import Array
from meshes.base.progress import silent
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.proxy.cutting_tool import CuttingTool
from tissue.models.tissue_model import TICK_S, Response, ToolMotion
from tissue.motion.motion import matrix_of
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts
from tissue.simulation.simulate import RunObserver, build, simulate

SCENES = ("milling", "glenoid", "caries", "molar", "pedicle")
FINER = 10
LOWEST_Hz = 50.0
HEAD = ("scene", "value", "median", "90 %", "largest")


class FollowObserver(RunObserver):
    """Observer that records what the tool follows: positions, orientations and velocities."""

    def __init__(self) -> None:
        self.rows: list[Array] = []
        self.tips_m: list[Array] = []

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        tool = parts.motion.tool
        assert isinstance(tool, CuttingTool)
        follow = tool.follow

        def recorded(device_m, device, velocity, response, step_s):
            self.rows.append(np.concatenate((device_m, device, velocity)))
            self.tips_m.append(follow(device_m, device, velocity, response, step_s).copy())
            return tool.tip_m

        tool.follow = recorded


@dataclass
class Course:
    """Means over ticks: force [N] and velocity [m/s], shape (n, 3), and ticks in contact."""

    forces_N: Array
    velocities_m_s: Array
    touches: Array
    tips_m: Array


def followed(scene: Scene, rows: Array, steps: int) -> Course:
    """Let the tool of a scene follow a record in a number of steps a tick."""
    parts = build(scene, compute="cpu", cores=1, report=silent, allow_unstable=True)
    motion = parts.motion
    assert isinstance(motion, HandMotion)
    tool, tissue, pose = motion.tool, parts.tissue, ToolMotion()
    motion.set_tissue(tissue)
    motion.begin(pose)
    start = pose.rotation.copy()
    tissue.place(pose)
    response = Response.empty(len(tissue.layer_names))
    step_s = TICK_S / steps
    tips = [tool.tip_m.copy()]
    forces = np.zeros((len(rows), 3))
    touches = np.zeros(len(rows), bool)
    before = rows[0]
    for tick, row in enumerate(rows):
        for part in range(1, steps + 1):
            now = row if part == steps else before + part / steps * (row - before)
            device = tuple((now[3:7] / np.linalg.norm(now[3:7])).tolist())
            if part == steps:
                device = tuple(row[3:7].tolist())
            pose.tip_m[:] = tool.follow(now[:3], device, now[7:], response, step_s)
            pose.rotation[:] = matrix_of(np.array(tool.quaternion)) @ start
            speed = float(np.linalg.norm(tool.velocity[:3]))
            if speed > 0.0:
                pose.heading[:] = (tool.velocity / speed).reshape(2, 3)
            pose.speed_m_s = speed
            tissue.advance(pose)
            response = tissue.respond(pose)
            forces[tick] += response.wrench[:3] / steps
            touches[tick] |= response.engaged_m2.sum() > 0.0
        tips.append(tool.tip_m.copy())
        before = row
    tips = np.array(tips)
    return Course(forces, np.diff(tips, axis=0) / TICK_S, touches, tips[1:])


def fast_power(velocities: Array) -> float:
    """Return the power of velocities above `LOWEST_Hz` [m2/s2]."""
    window = np.hanning(len(velocities))[:, None]
    spectrum = np.abs(np.fft.rfft(window * velocities, axis=0)) ** 2
    high = np.fft.rfftfreq(len(velocities), TICK_S) > LOWEST_Hz
    return float(spectrum[high].sum())


def drops(course: Course) -> int:
    """Count the ticks within contact whose force falls to less than a tenth of its mean."""
    size = np.linalg.norm(course.forces_N, axis=1)
    inside = uniform_filter1d(course.touches.astype(float), 51) > 0.999
    return int((inside & (size < 0.1 * uniform_filter1d(size, 51))).sum())


def compared(scene: Scene) -> dict[str, float]:
    """Measure one hand in a scene."""
    observer = FollowObserver()
    simulate(scene, allow_unstable=True, observers=[observer])
    rows = np.array(observer.rows)
    coarse, fine = followed(scene, rows, 1), followed(scene, rows, FINER)
    off_m = np.abs(coarse.tips_m - np.array(observer.tips_m)).max()
    if off_m > 0.0:
        raise SystemExit(f"the course of the closed loop is not repeated: {off_m:g} m")
    found = {}
    contact = np.flatnonzero(fine.touches)
    found["speed"] = fast_power(coarse.velocities_m_s) / fast_power(fine.velocities_m_s)
    off = np.linalg.norm(coarse.forces_N - fine.forces_N, axis=1)
    size = np.linalg.norm(fine.forces_N, axis=1)
    touch = slice(contact[0], contact[0] + 20)
    impulses = [each.forces_N[touch].sum(axis=0) for each in (coarse, fine)]
    found["touch %"] = 100.0 * np.linalg.norm(np.subtract(*impulses)) / np.linalg.norm(impulses[1])
    found["peak %"] = 100.0 * off[touch].max() / size[touch].max()
    found["force %"] = 100.0 * np.linalg.norm(off) / np.linalg.norm(size)
    end = slice(contact[-1] + 1, contact[-1] + 41)
    if contact[-1] + 41 < len(rows):
        apart = np.linalg.norm(coarse.velocities_m_s - fine.velocities_m_s, axis=1)[end]
        speeds = np.linalg.norm(fine.velocities_m_s, axis=1)[end]
        found["end %"] = 100.0 * apart.max() / speeds.max()
    found["drops"] = drops(coarse)
    found["drops, fine"] = drops(fine)
    return found


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--hands", type=int, default=30, help="number of hands (seeds)")
    parser.add_argument("--seconds", type=float, default=3.0, help="duration of a run")
    given = parser.parse_args()
    print(machine())
    for name in given.scenes:
        hands = [compared(scene_of(name, SEED + k, given.seconds)) for k in range(given.hands)]
        rows = []
        for value in dict.fromkeys(key for each in hands for key in each):
            values = np.array([each[value] for each in hands if value in each])
            numbers = *np.percentile(values, [50, 90]), values.max()
            rows.append((name, f"{value} ({len(values)})", *(f"{each:.3g}" for each in numbers)))
        print(table(rows, HEAD), flush=True)


if __name__ == "__main__":
    main()
