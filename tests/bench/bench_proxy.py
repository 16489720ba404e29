"""Cost of a proxy's tick: `python tests/bench/bench_proxy.py [--quick]`.

A burr of 6 mm diameter as a shell of about 250, 700 and 1,500 points against the glenoid in voxels, at 1 kHz, in three
and six degrees of freedom: in the air, pressed and dragged, in a pocket it milled before, and fast. Friction is 0.3.
Then the same levels in NumPy, as a baseline for one evaluation of the shell, and the cost of the first against the last
ticks of a long contact: nothing may grow.
"""

import argparse

import numpy as np
from harness import Cost, cost_of, machine, table
from scipy.spatial.transform import Rotation

from kernels.voxmap import SURFACE
from meshes.surfaces.glenoid import glenoid
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.haptics.proxy.proxy import Proxy, ProxyOutcome
from tissue.haptics.proxy.tool_shell import ToolShell
from tissue.haptics.proxy.voxmap import ContactField
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

CUTTER = Cutter(ball_burr(diameter_m=6e-3), 6, 1000.0)
FRICTION, LEVER_M, TICK_S = 0.3, 0.02, 1e-3


def bone(spacing_m: float) -> BoneModel:
    """The middle of the glenoid's face."""
    volume = voxelise(glenoid(), spacing_m=spacing_m, region_m=((-9e-3, -9e-3, -8e-3), (9e-3, 9e-3, 8e-3)))
    coefficients = (cutting_coefficients("bone"),) * len(volume.layer_names)
    return BoneModel(volume, CUTTER, coefficients, cores=1)


def mill(model: BoneModel) -> None:
    """A pocket 3 mm deep and 4 mm long."""
    motion = ToolMotion(speed_m_s=1e-2)
    motion.heading[0] = (1.0, 0.0, 0.0)
    motion.tip_m[:] = (-2e-3, 0.0, -3e-3)
    model.place(motion)
    for share in np.linspace(0.0, 1.0, 400):
        motion.tip_m[0] = -2e-3 + 4e-3 * share
        model.advance(motion)
    model.finish()


def circle(speed_m_s: float, *, radius_m: float, height_m: float):
    """Device on a circle, its axis nodding: position and quaternion of a tick."""

    def pose(tick: int) -> tuple[np.ndarray, np.ndarray]:
        angle = speed_m_s * TICK_S * tick / radius_m
        turn = Rotation.from_rotvec([0.2 * np.sin(0.7 * angle), 0.1 * np.cos(angle), 0.0]).as_quat()
        return np.array([radius_m * np.cos(angle), radius_m * np.sin(angle), height_m]), turn

    return pose


def crossing(speed_m_s: float):
    """Device up and down through the face."""

    def pose(tick: int) -> tuple[np.ndarray, np.ndarray]:
        travel = (speed_m_s * TICK_S * tick) % 0.024
        return np.array([0.0, 0.0, 8e-3 - abs(travel - 0.012)]), np.array([0.0, 0.0, 0.0, 1.0])

    return pose


def run(field: ContactField, path, *, points: int, lever_m: float | None, ticks: int) -> tuple[Cost, np.ndarray, float]:
    """Costs, steps and solves of every tick, and the share of ticks that ran out of steps."""
    proxy = Proxy(ToolShell.of_cutter(CUTTER, point_count=points), field, lever_m=lever_m, friction=FRICTION)
    start = path(0)[0] * [1.0, 1.0, 0.0] + [0.0, 0.0, 8e-3]
    proxy.place(start)
    for share in np.linspace(0.0, 1.0, 500):
        proxy.advance(start + share * (path(0)[0] - start), path(0)[1])
    poses = [path(tick) for tick in range(ticks)]
    work = np.zeros((ticks, 3))

    def tick(index: int) -> None:
        result = proxy.advance(*poses[index])
        work[index] = result.steps, result.solves, result.outcome is ProxyOutcome.BEHIND

    return cost_of(tick, count=ticks), work, float(work[:, 2].mean())


def numpy_levels(model: BoneModel, points: int) -> Cost:
    """One evaluation of the shell's levels in NumPy."""
    fraction = model.remaining().astype(np.float32) / np.float32(255)
    volume, shell = model.store.volume, ToolShell.of_cutter(CUTTER, point_count=points)

    def evaluate(index: int) -> np.ndarray:
        shift = np.array([1e-6 * index, 0.0, 1e-3]) - volume.origin_m
        at = (shell.points_m + shift) / volume.spacing_m - 0.5
        low = np.floor(at).astype(int)
        part = at - low
        low = np.clip(low, 0, np.array(fraction.shape) - 2)
        total = np.zeros(len(at))
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, part, 1.0 - part).prod(axis=1)
            total += weight * fraction[tuple((low + corner).T)]
        return (SURFACE - total) * volume.spacing_m

    return cost_of(evaluate, count=400)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer ticks")
    quick = parser.parse_args().quick
    ticks = 1500 if quick else 6000
    print(machine(), "\n")
    rows = []
    for spacing in (1e-4,) if quick else (2e-4, 1e-4):
        whole, pocket = bone(spacing), bone(spacing)
        mill(pocket)
        scenes = (
            ("in the air", whole, circle(0.05, radius_m=2e-3, height_m=4e-3)),
            ("pressed 1 mm, 50 mm/s", whole, circle(0.05, radius_m=2e-3, height_m=-1e-3)),
            ("pressed 1 mm, 0.5 m/s", whole, circle(0.5, radius_m=4e-3, height_m=-1e-3)),
            ("in a pocket, 50 mm/s", pocket, circle(0.05, radius_m=2e-3, height_m=-3.5e-3)),
            ("through the face, 0.5 m/s", whole, crossing(0.5)),
            ("through the face, 2 m/s", whole, crossing(2.0)),
        )
        for name, model, path in scenes:
            field = ContactField(store=model.store)
            for points in (700,) if quick else (250, 700, 1500):
                for lever in (None, LEVER_M):
                    cost, work, behind = run(field, path, points=points, lever_m=lever, ticks=ticks)
                    rows.append((f"{spacing * 1e3:g}", name, f"{points}", "3" if lever is None else "6",
                                 f"{np.median(work[:, 0]):.0f}", f"{np.percentile(work[:, 0], 99):.0f}",
                                 f"{np.percentile(work[:, 1], 99):.0f}", f"{100 * behind:.1f} %",
                                 f"{cost.median:.0f}", f"{cost.p99:.0f}", f"{cost.worst:.0f}"))  # fmt: skip
    print(table(rows, ("voxel mm", "scene", "points", "DOF", "steps", "99 %", "solves 99 %", "behind", "us", "99 % us",
                       "worst us")))  # fmt: skip
    print(f"\nNumPy, the levels of 700 points once: {numpy_levels(whole, 700).median:.0f} us")
    field = ContactField(store=whole.store)
    cost, _, _ = run(field, circle(0.05, radius_m=2e-3, height_m=-1e-3), points=700, lever_m=LEVER_M, ticks=10 * ticks)
    tenth = len(cost.us) // 10
    print(f"first and last tenth of {10 * ticks} ticks: median {np.median(cost.us[:tenth]):.0f} and "
          f"{np.median(cost.us[-tenth:]):.0f} us")  # fmt: skip


if __name__ == "__main__":
    main()
