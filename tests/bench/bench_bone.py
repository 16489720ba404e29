"""Cost of a tick of bone.

Run: `python tests/bench/bench_bone.py [--quick]`.

1. Carving and force of a ball burr of 3 mm radius, all of it in a solid cube of 25.6 mm, with 0.1
   mm voxels, at 1 mm/s and 1 kHz. In the same run it is compared with a brute-force Warp kernel
   over the burr's box, and with NumPy over the same box.
2. The glenoid scene at 0.2, 0.1 and 0.05 mm: cost against the engaged area and the volume.
3. The same burr at other speeds. Work that is spread over ticks at low speed falls into one tick at
   high speed.
"""

import argparse
import resource
import sys
from time import perf_counter

import numpy as np
import warp as wp
from harness import Cost, cost_of, machine, table

import tissue
from meshes.shapes.anatomy import cortical_block
from meshes.voxels.voxelise import voxelise
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion

SPACING_M, RADIUS_M, FEED_M_S, TICK_S = 1e-4, 3e-3, 1e-3, 1e-3
START_M = np.array([-8e-3, 2e-5, -1.3e-2])
UP_M = np.array([0.0, 0.0, RADIUS_M])
BOX = int(2 * RADIUS_M / SPACING_M) + 4


@wp.kernel
def carve(
    centre: wp.array(dtype=wp.vec3),
    low: wp.array(dtype=wp.vec3i),
    radius: float,
    remaining: wp.array3d(dtype=wp.uint16),
    removed: wp.array(dtype=wp.int64),
):
    """Every voxel of the burr's box loses what lies inside the ball by a linear ramp."""
    i, j, k = wp.tid()
    x, y, z = low[0][0] + i, low[0][1] + j, low[0][2] + k
    at = wp.vec3(float(x) + 0.5, float(y) + 0.5, float(z) + 0.5)
    inside = wp.clamp(0.5 - (wp.length(at - centre[0]) - radius), 0.0, 1.0)
    left = int(65535.0 * (1.0 - inside))
    old = int(remaining[x, y, z])
    if left < old:
        remaining[x, y, z] = wp.uint16(left)
        wp.atomic_add(removed, 0, wp.int64(old - left))


def position(index: int) -> np.ndarray:
    return START_M + np.array([FEED_M_S * TICK_S * index, 0.0, 0.0])


def brute_force_warp(volume, count: int) -> Cost:
    remaining = wp.full(volume.shape, 65535, dtype=wp.uint16, device="cpu")
    centre, low = (
        wp.zeros(1, dtype=wp.vec3, device="cpu"),
        wp.zeros(1, dtype=wp.vec3i, device="cpu"),
    )
    removed = wp.zeros(1, dtype=wp.int64, device="cpu")
    inputs = [centre, low, RADIUS_M / SPACING_M, remaining, removed]
    command = wp.launch(carve, dim=(BOX,) * 3, inputs=inputs, device="cpu", record_cmd=True)
    centre_view, low_view = centre.numpy(), low.numpy()

    def tick(index: int) -> None:
        at = (position(index) + UP_M - volume.origin_m) / SPACING_M
        centre_view[0] = at
        low_view[0] = np.floor(at - BOX / 2)
        command.launch()

    return cost_of(tick, count=count)


def numpy_box(volume, count: int) -> Cost:
    remaining = np.full(volume.shape, 65535, dtype=np.uint16)
    grid = np.indices((BOX,) * 3).astype(np.float32) + 0.5

    def tick(index: int) -> None:
        at = (position(index) + UP_M - volume.origin_m) / SPACING_M
        low = np.floor(at - BOX / 2).astype(int)
        offset = (at - low).astype(np.float32)
        distance = np.sqrt(((grid - offset[:, None, None, None]) ** 2).sum(axis=0)) - np.float32(
            RADIUS_M / SPACING_M
        )
        left = (65535 * (1 - np.clip(0.5 - distance, 0, 1))).astype(np.uint16)
        part = tuple(slice(a, a + BOX) for a in low)
        np.minimum(remaining[part], left, out=remaining[part])

    return cost_of(tick, count=count, warm_up=3)


def burr(volume, *, feed_m_s: float = FEED_M_S, cores: int = 1, **options) -> BoneModel:
    return BoneModel(
        volume,
        Cutter(ball_burr(diameter_m=2 * RADIUS_M), 6, 1000.0),
        (cutting_coefficients("bone"),),
        cores=cores,
        **options,
    )


def milling(
    volume, count: int, *, feed_m_s: float = FEED_M_S, **options
) -> tuple[Cost, Cost, Cost]:
    """Costs of carving, force and both."""
    model = burr(volume, **options)
    motion = ToolMotion(speed_m_s=feed_m_s)
    motion.heading[0] = (1, 0, 0)
    motion.tip_m[:] = START_M
    model.place(motion)
    carving, forces = [], []

    def tick(index: int) -> None:
        motion.tip_m[:] = START_M + np.array([feed_m_s * TICK_S * index, 0.0, 0.0])
        start = perf_counter()
        model.advance(motion)
        middle = perf_counter()
        model.respond(motion)
        carving.append(middle - start)
        forces.append(perf_counter() - middle)

    both = cost_of(tick, count=count)
    return Cost(carving[50:]), Cost(forces[50:]), both


def glenoid(spacing_mm: float, *, duration_s: float | None) -> tuple[str, ...]:
    overrides = {"voxels.spacing_mm": spacing_mm}
    if duration_s is not None:
        overrides |= {"duration_s": duration_s, "motion.points_mm": [[0, 0, -0.9], [0, 0, -2.0]]}
    start = perf_counter()
    run = tissue.simulate(tissue.load_scene("glenoid", overrides))
    wall = perf_counter() - start
    ticks = Cost(run.timing["tick_us"] * 1e-6)
    store = run.parts.tissue.store
    peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return (
        f"{spacing_mm:g} mm",
        f"{store.brick_of.size * 512 / 1e6:.1f} M",
        f"{run.trace['contact_mm2'].max():.0f} mm2",
        *(f"{value:.0f}" for value in (ticks.median, ticks.p99, ticks.worst)),
        f"{(run.timing['tick_us'] > 1000.0).sum()} of {len(ticks.us)}",
        f"{peak_MB:.0f} MB",
        f"{wall:.1f} s",
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="fewer ticks, and no 0.05 mm")
    quick = parser.parse_args().quick
    count = 1000 if quick else 4000
    print(machine())
    start = perf_counter()
    volume = voxelise(cortical_block(size_mm=(25.6, 25.6, 25.6)), spacing_m=SPACING_M)
    voxels_s = perf_counter() - start
    start = perf_counter()
    burr(volume)
    print(
        f"voxels {voxels_s:.2f} s, bricks and kernels (compiled or from cache) "
        f"{perf_counter() - start:.2f} s\n"
    )

    carving, forces, both = milling(volume, count)
    compared = [
        ("sub-voxel bricks: carve + force", both),
        ("  carve", carving),
        ("  force, 6000 elements", forces),
        ("binary bricks: carve + force", milling(volume, count, removal="binary")[2]),
        ("brute-force Warp: carve", brute_force_warp(volume, 400)),
        ("NumPy: carve", numpy_box(volume, 20 if quick else 60)),
    ]
    rows = [
        (name, *(f"{v:.0f}" for v in (c.median, c.p99, c.worst)), f"{c.median / both.median:.2f}")
        for name, c in compared
    ]
    print("ball burr r = 3 mm in solid bone, 0.1 mm, 1 mm/s, one core [us a tick]")
    print(table(rows, ("what", "median", "99 %", "max", "ratio")), "\n")

    rows = []
    for feed in (0.1e-3, 1e-3, 5e-3, 20e-3, 100e-3):
        cost = milling(volume, min(count, int(1.4e-2 / (feed * TICK_S))), feed_m_s=feed, cores=2)[2]
        rows.append(
            (f"{feed * 1e3:g} mm/s", *(f"{v:.0f}" for v in (cost.median, cost.p99, cost.worst)))
        )
    print("the same at other feeds, two cores [us a tick]")
    print(table(rows, ("feed", "median", "99 %", "max")), "\n")

    print("glenoid scene [us a tick]")
    rows = [
        glenoid(s, duration_s=1.2 if quick else None)
        for s in ((0.2, 0.1) if quick else (0.2, 0.1, 0.05))
    ]
    print(
        table(
            rows, ("voxel", "voxels", "engaged", "median", "99 %", "max", "missed", "peak", "wall")
        )
    )


if __name__ == "__main__":
    sys.exit(main())
