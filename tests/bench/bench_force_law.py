"""Parts of the error of a flat block's force against exact geometry.

Run: `python tests/bench/bench_force_law.py [--quick]`.

A ball burr of 3 mm plunges into a slanted plate (1800 kg/m3) over spongy bone (400 kg/m3), cuts a
slot out of its flank and leaves, in frames and shifts at random. Printed is the root mean square
over them of the error over 50 ms, as it is, with elements half as far apart, with surface or layer
distances kept in steps four times as coarse (what that adds, in squares, is 15 times the steps' own
part), and with layer distances along the normal.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
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


def wanted_of(cut: VoxelCut, *shape: object) -> ReferenceForce:
    """Force of the exact geometry, kept by what is known of its bone."""
    return cut.reference(cache_key=(*shape, CUTTER, BONE))


def slot() -> tuple[VoxelCut, ReferenceForce]:
    """The slot in a slanted plate, and its reference."""
    cut = VoxelCut(CUTTER, layered(SLANT, plate_m=PLATE_M), SLOT_MM, FEED_M_S)
    return cut, wanted_of(cut, "slanted plate", SLANT, PLATE_M)


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="fewer spacings and frames")
    quick = parser.parse_args().quick
    print(machine())
    parts((0.4, 0.1) if quick else (0.57, 0.4, 0.28, 0.2, 0.14, 0.1), 2 if quick else 8)


if __name__ == "__main__":
    main()
