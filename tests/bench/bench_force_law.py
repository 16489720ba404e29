"""Force law against exact geometry, on bone that is difficult for it.

Run: `python tests/bench/bench_force_law.py [--quick]`.

1. Order: a ball burr of 3 mm plunges into a slanted plate (1800 kg/m3) over spongy bone (400
kg/m3), cuts a slot out
   of its flank and leaves; error over ticks and over 50 ms at falling spacings, and the order of
   the latter.
2. Rotations: the same cut in turned frames; how far the forces, turned back, spread about their
mean.
3. Second pass: the same slot once more, in turned frames, at the same depth and 0.02 and 0.05 mm
deeper; error in the
   second pass by the mean force of the first.
4. What a flat block's error consists of: the slot of 1 in frames and shifts at random, root mean
square over them of the
   error over 50 ms, as it is, with elements half as far apart, with surface or layer distances kept
   in steps four times as coarse (what that adds, in squares, is 15 times the steps' own part), and
   with layer distances along the normal.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from force_errors import error_of_force
from harness import machine, table
from scipy.spatial.transform import Rotation
from voxel_cuts import BONE, VoxelCut, layered, over_50_ms, relative

from meshes.voxels.distances import BOUNDARY_STEPS, FAR, INSIDE, OUTSIDE, SURFACE_ZERO
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.evaluation.reference.history import ReferenceForce

RADIUS_M, FEED_M_S = 1.5e-3, 4e-3
CUTTER = Cutter(ball_burr(diameter_m=2.0 * RADIUS_M), 6, 1000.0)
SLANT = np.array([0.25, 0.15, 1.0]) / np.linalg.norm([0.25, 0.15, 1.0])
PLATE_M = 0.45e-3
SLOT_MM = ((0.2, 0.1, 0.5), (0.2, 0.1, -0.8), (1.7, 0.5, -1.0), (1.9, 0.6, 0.5))
DEPTH_MM = 0.3


def wanted_of(cut: VoxelCut, *shape: object) -> ReferenceForce:
    """Force of the exact geometry, kept by what is known of its bone."""
    return cut.reference(kept_by=(*shape, CUTTER, BONE))


def slot() -> tuple[VoxelCut, ReferenceForce]:
    """The slot in a slanted plate, and its reference."""
    cut = VoxelCut(CUTTER, layered(SLANT, plate_m=PLATE_M), SLOT_MM, FEED_M_S)
    return cut, wanted_of(cut, "slanted plate", SLANT, PLATE_M)


def frames(count: int) -> list[Rotation]:
    """The lattice's own frame, and turned ones."""
    return [Rotation.identity(), *Rotation.random(count - 1, random_state=7)]


def order(spacings_mm, shell_mm) -> None:
    """Print the error at each spacing, elements two voxels apart unless given."""
    frame, shell_m = Rotation.from_euler("xyz", [0.3, -0.2, 0.4]), shell_mm and 1e-3 * shell_mm
    (cut, wanted), rows, before = slot(), [], None
    for spacing in spacings_mm:
        found = error_of_force(
            cut.engine(1e-3 * spacing, frame=frame, shell_spacing_m=shell_m), wanted
        )
        rate = (
            np.log(before[1] / found.over_50_ms) / np.log(before[0] / spacing)
            if before
            else float("nan")
        )
        rows.append((f"{spacing:g}", *_percent(found), f"{rate:.2f}"))
        before = spacing, found.over_50_ms
    print(table(rows, ("spacing mm", "ticks %", "50 ms %", "bias %", "own %", "order")))


def rotations(spacing_mm: float, count: int) -> None:
    """Print the error in each frame and the spread of the forces."""
    (cut, wanted), rows, forces = slot(), [], []
    for frame in frames(count):
        forces.append(cut.engine(1e-3 * spacing_mm, frame=frame))
        turn = np.degrees(frame.magnitude())
        rows.append((f"{turn:.0f}", *_percent(error_of_force(forces[-1], wanted))))
    print(table(rows, ("turned deg", "ticks %", "50 ms %", "bias %", "own %")))
    middle = np.mean(forces, axis=0)
    sizes = np.array([(each * middle).sum() / (middle * middle).sum() for each in forces])
    print(
        f"spread of the mean force over frames {100.0 * (sizes.max() - sizes.min()):.2f} % "
        f"at {spacing_mm:g} mm"
    )


def second_pass(spacing_mm: float, count: int) -> None:
    """Print the error in a second pass by the mean force of the first."""
    rows = []
    for deeper in (0.0, 0.02, 0.05):
        z, corners = (
            -DEPTH_MM,
            [[-1.5, 0, 0.3], [-1.5, 0, -DEPTH_MM], [1.5, 0, -DEPTH_MM], [1.5, 0, 0.3]],
        )
        corners += [[-1.5, 0, 0.3], [-1.5, 0, z - deeper], [1.5, 0, z - deeper]]
        cut = VoxelCut(CUTTER, layered(), corners, FEED_M_S)
        wanted = wanted_of(cut, "half space").force_N
        passes = np.split(np.flatnonzero(cut.path().velocities[:, 0] > 0.5 * FEED_M_S), 2)
        full = np.linalg.norm(wanted[passes[0]], axis=1).mean()
        for frame in frames(count):
            force = cut.engine(1e-3 * spacing_mm, frame=frame)
            off = np.linalg.norm(force - wanted, axis=1)[passes[1]]
            values = (off.mean(), off.max(), np.linalg.norm(wanted[passes[1]], axis=1).mean())
            turn = np.degrees(frame.magnitude())
            rows.append(
                (f"{deeper:g}", f"{turn:.0f}", *(f"{100.0 * value / full:.2f}" for value in values))
            )
    print(table(rows, ("deeper mm", "turned deg", "error %", "worst tick %", "true force %")))


def coarser_surface(volume: VoxelVolume) -> VoxelVolume:
    """Surface distances in steps four times as coarse."""
    steps = volume.surface_distance.astype(int) - SURFACE_ZERO
    coarse = np.clip(4 * np.rint(steps / 4) + SURFACE_ZERO, INSIDE + 1, OUTSIDE - 1)
    held = (volume.surface_distance > INSIDE) & (volume.surface_distance < OUTSIDE)
    return replace(
        volume, surface_distance=np.where(held, coarse, volume.surface_distance).astype(np.uint8)
    )


def coarser_layers(volume: VoxelVolume) -> VoxelVolume:
    """Distances to a change of layer in steps four times as coarse."""
    steps = volume.layer_distance.astype(int)
    return replace(
        volume, layer_distance=np.where(steps < FAR, 4 * np.rint(steps / 4), FAR).astype(np.uint8)
    )


def along_the_normal(frame: Rotation, shift_m: np.ndarray) -> Callable[[VoxelVolume], VoxelVolume]:
    """Distances to the slanted plate's lower face along its normal."""

    def change(volume: VoxelVolume) -> VoxelVolume:
        centres = np.stack(
            np.meshgrid(*(volume.centres_m(axis) for axis in range(3)), indexing="ij"), axis=-1
        )
        away = np.abs((centres - shift_m) @ frame.apply(SLANT) + PLATE_M) / volume.spacing_m
        steps = np.rint(np.minimum(BOUNDARY_STEPS * away, FAR - 1))
        return replace(
            volume,
            layer_distance=np.where(volume.layer_distance < FAR, steps, FAR).astype(np.uint8),
        )

    return change


def parts(spacings_mm, count: int) -> None:
    """Print the error of a flat block as it is and with one thing changed."""
    (cut, reference), rows = slot(), []
    wanted, shifts = (
        over_50_ms(reference.force_N),
        np.random.default_rng(0).uniform(-5e-4, 5e-4, (count, 3)),
    )
    for spacing in spacings_mm:
        errors = []
        for frame, shift in zip(Rotation.random(count, random_state=1), shifts, strict=True):
            variants = (
                (2e-5, None),
                (1e-5, None),
                (2e-5, coarser_surface),
                (2e-5, coarser_layers),
                (2e-5, along_the_normal(frame, shift)),
            )
            forces = [
                cut.engine(
                    1e-3 * spacing,
                    frame=frame,
                    shift_m=shift,
                    shell_spacing_m=shell_m,
                    change=change,
                )
                for shell_m, change in variants
            ]
            errors.append([relative(over_50_ms(force), wanted) for force in forces])
        rows.append(
            (
                f"{spacing:g}",
                *(f"{100.0 * e:.3f}" for e in np.sqrt(np.mean(np.square(errors), axis=0))),
            )
        )
    print(table(rows, ("spacing mm", "as it is %", "elements", "surface", "layers", "normal")))


def _percent(error) -> tuple[str, ...]:
    values = (error.over_ticks, error.over_50_ms, error.bias, error.reference_uncertainty)
    return tuple(f"{100.0 * value:.2f}" for value in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="fewer spacings and frames")
    parser.add_argument(
        "--shell-mm", type=float, help="distance between the cutter's elements in 1"
    )
    parser.add_argument("--part", type=int, choices=(1, 2, 3, 4), help="only this part")
    arguments = parser.parse_args()
    print(machine())
    if arguments.part in (None, 1):
        order((0.2, 0.1) if arguments.quick else (0.2, 0.14, 0.1, 0.07, 0.05), arguments.shell_mm)
    if arguments.part in (None, 2):
        rotations(0.1, 2 if arguments.quick else 5)
    if arguments.part in (None, 3):
        second_pass(0.1, 2 if arguments.quick else 4)
    if arguments.part in (None, 4):
        parts(
            (0.4, 0.1) if arguments.quick else (0.57, 0.4, 0.28, 0.2, 0.14, 0.1),
            2 if arguments.quick else 8,
        )


if __name__ == "__main__":
    main()
