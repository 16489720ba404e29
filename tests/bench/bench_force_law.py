"""Force law against exact geometry on bone made to be hard for it: `python tests/bench/bench_force_law.py [--quick]`.

1. Order: a ball burr of 3 mm plunges into a slanted plate (1800 kg/m3) over spongy bone (400 kg/m3), cuts a slot out
   of its flank and leaves; error over ticks and over 50 ms at falling spacings, and the order of the latter.
2. Rotations: the same cut in turned frames; how far the forces, turned back, spread about their mean.
3. Second pass: the same slot once more, in turned frames, at the same depth and 0.02 and 0.05 mm deeper; error in the
   second pass by the mean force of the first.
"""

import argparse
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from harness import machine, table
from scipy.spatial.transform import Rotation

from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import half_space
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.evaluation.reference.error import error_of_force
from tissue.evaluation.reference.history import ReferenceForce, force_on_path
from tissue.evaluation.reference.path import ToolPath
from tissue.evaluation.reference.solid import Solid
from tissue.materials.cutting import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import TICK_S, ToolMotion

RADIUS_M, FEED_M_S = 1.5e-3, 4e-3
CUTTER = Cutter(ball_burr(diameter_m=2.0 * RADIUS_M), 6, 1000.0)
SLANT = np.array([0.25, 0.15, 1.0]) / np.linalg.norm([0.25, 0.15, 1.0])
PLATE_M = 0.45e-3
SLOT_MM = [[0.2, 0.1, 0.5], [0.2, 0.1, -0.8], [1.7, 0.5, -1.0], [1.9, 0.6, 0.5]]
DEPTH_MM = 0.3


@dataclass(frozen=True)
class Cut:
    """A path through layered bone, in a frame turned by ``frame``."""

    corners_mm: tuple[tuple[float, float, float], ...]
    normal: tuple[float, float, float]
    plate_m: float
    frame: Rotation

    @property
    def solid(self) -> Solid:
        """Plate over spongy bone, both without end; a plate of 0 is all the bone there is."""
        normal = self.frame.apply(self.normal)

        def classify(points, depth):
            deep = depth > self.plate_m if self.plate_m > 0.0 else np.zeros(len(points), dtype=bool)
            return deep.astype(np.uint8), np.where(deep, 400.0, 1800.0).astype(points.dtype)

        anatomy = Anatomy("slanted plate", half_space(normal), ("cortical", "trabecular"), classify)
        return Solid(anatomy, (cutting_coefficients("bone"),) * 2)

    @property
    def path(self) -> ToolPath:
        """Poses of every tick along straight lines at the feed; every leg ends at a tick."""
        corners = 1e-3 * np.array(self.corners_mm)
        tips, velocities = [corners[0]], []
        for start, end in pairwise(corners):
            steps = max(round(np.linalg.norm(end - start) / (FEED_M_S * TICK_S)), 1)
            tips += [start + (end - start) * k / steps for k in range(1, steps + 1)]
            velocities += [(end - start) / (steps * TICK_S)] * steps
        velocities = np.array([velocities[0], *velocities])
        rotations = np.broadcast_to(self.frame.as_matrix(), (len(tips), 3, 3))
        turn = self.frame.apply
        return ToolPath(turn(np.array(tips)), rotations, turn(velocities), np.zeros((len(tips), 3)), 2.0 * RADIUS_M)

    @property
    def reference(self) -> ReferenceForce:
        """Force of the exact geometry."""
        known = (self.corners_mm, self.normal, self.plate_m, self.frame.as_matrix(), RADIUS_M, CUTTER)
        return force_on_path(self.path, CUTTER, self.solid, kept_by=known)

    def engine(self, spacing_m: float, *, shell_spacing_m: float | None = None) -> np.ndarray:
        """Force of the voxel model on the tool at every tick [N], in the frame of the cut, shape (n, 3)."""
        path, solid = self.path, self.solid
        lift = path.rotations[0][:, 2] * RADIUS_M
        low, high = (path.tips_m + lift).min(axis=0), (path.tips_m + lift).max(axis=0)
        margin = RADIUS_M + 10.0 * spacing_m
        volume = voxelise(solid.anatomy, spacing_m=spacing_m, region_m=(low - margin, high + margin))
        model = BoneModel(volume, CUTTER, solid.coefficients, shell_spacing_m=shell_spacing_m, cores=1)
        motion = ToolMotion(speed_m_s=1.0)
        forces = []
        for tick, tip in enumerate(path.tips_m):
            speed = float(np.linalg.norm(path.velocities[tick]))
            motion.tip_m[:], motion.rotation[:], motion.speed_m_s = tip, path.rotations[tick], speed
            motion.heading[0] = path.velocities[tick] / speed
            if tick == 0:
                model.place(motion)
            model.advance(motion)
            forces.append(model.respond(motion).wrench[:3].copy())
        return self.frame.inv().apply(np.array(forces))

    def wanted(self) -> ReferenceForce:
        """The reference in the frame of the cut."""
        found, back = self.reference, self.frame.inv()
        return ReferenceForce(
            np.hstack([back.apply(found.wrench[:, :3]), back.apply(found.wrench[:, 3:])]),
            found.uncertainty,
            found.evaluations,
        )


def frames(count: int) -> list[Rotation]:
    """The lattice's own frame, and turned ones."""
    return [Rotation.identity(), *Rotation.random(count - 1, random_state=7)]


def order(spacings_mm, shell_mm) -> None:
    """Print the error at each spacing, elements two voxels apart unless given."""
    cut = Cut(tuple(map(tuple, SLOT_MM)), tuple(SLANT), PLATE_M, Rotation.from_euler("xyz", [0.3, -0.2, 0.4]))
    wanted, rows, before = cut.wanted(), [], None
    for spacing in spacings_mm:
        found = error_of_force(cut.engine(1e-3 * spacing, shell_spacing_m=shell_mm and 1e-3 * shell_mm), wanted)
        rate = np.log(before[1] / found.over_50_ms) / np.log(before[0] / spacing) if before else float("nan")
        rows.append((f"{spacing:g}", *_percent(found), f"{rate:.2f}"))
        before = spacing, found.over_50_ms
    print(table(rows, ("spacing mm", "ticks %", "50 ms %", "bias %", "own %", "order")))


def rotations(spacing_mm: float, count: int) -> None:
    """Print the error in each frame and the spread of the forces."""
    rows, forces = [], []
    for frame in frames(count):
        cut = Cut(tuple(map(tuple, SLOT_MM)), tuple(SLANT), PLATE_M, frame)
        forces.append(cut.engine(1e-3 * spacing_mm))
        turn = np.degrees(frame.magnitude())
        rows.append((f"{turn:.0f}", *_percent(error_of_force(forces[-1], cut.wanted()))))
    print(table(rows, ("turned deg", "ticks %", "50 ms %", "bias %", "own %")))
    middle = np.mean(forces, axis=0)
    sizes = np.array([(each * middle).sum() / (middle * middle).sum() for each in forces])
    print(f"spread of the mean force over frames {100.0 * (sizes.max() - sizes.min()):.2f} % at {spacing_mm:g} mm")


def second_pass(spacing_mm: float, count: int) -> None:
    """Print the error in a second pass by the mean force of the first."""
    rows = []
    for deeper in (0.0, 0.02, 0.05):
        z, corners = -DEPTH_MM, [[-1.5, 0, 0.3], [-1.5, 0, -DEPTH_MM], [1.5, 0, -DEPTH_MM], [1.5, 0, 0.3]]
        corners += [[-1.5, 0, 0.3], [-1.5, 0, z - deeper], [1.5, 0, z - deeper]]
        for frame in frames(count):
            cut = Cut(tuple(map(tuple, corners)), (0.0, 0.0, 1.0), 0.0, frame)
            wanted, force = cut.wanted().force_N, cut.engine(1e-3 * spacing_mm)
            along = 1e3 * (cut.path.velocities @ frame.as_matrix()[:, 0])
            passes = np.split(np.flatnonzero(along > 0.5e3 * FEED_M_S), 2)
            full = np.linalg.norm(wanted[passes[0]], axis=1).mean()
            off = np.linalg.norm(force - wanted, axis=1)[passes[1]]
            values = (off.mean(), off.max(), np.linalg.norm(wanted[passes[1]], axis=1).mean())
            turn = np.degrees(frame.magnitude())
            rows.append((f"{deeper:g}", f"{turn:.0f}", *(f"{100.0 * value / full:.2f}" for value in values)))
    print(table(rows, ("deeper mm", "turned deg", "error %", "worst tick %", "true force %")))


def _percent(error) -> tuple[str, ...]:
    values = (error.over_ticks, error.over_50_ms, error.bias, error.reference_uncertainty)
    return tuple(f"{100.0 * value:.2f}" for value in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer spacings and frames")
    parser.add_argument("--shell-mm", type=float, help="distance between the cutter's elements in 1")
    parser.add_argument("--part", type=int, choices=(1, 2, 3), help="only this part")
    arguments = parser.parse_args()
    print(machine())
    if arguments.part in (None, 1):
        order((0.2, 0.1) if arguments.quick else (0.2, 0.14, 0.1, 0.07, 0.05), arguments.shell_mm)
    if arguments.part in (None, 2):
        rotations(0.1, 2 if arguments.quick else 5)
    if arguments.part in (None, 3):
        second_pass(0.1, 2 if arguments.quick else 4)


if __name__ == "__main__":
    main()
