"""Warp as one would write it first: every voxel of the burr's box, every tick."""

import numpy as np
import warp as wp
from works import BLOCK_M, BURR_M, SPACING_M, burr_centre, say, timed

BOX = int(2 * BURR_M / SPACING_M) + 4


@wp.kernel
def carve(
    centre: wp.array(dtype=wp.vec3),
    low: wp.array(dtype=wp.vec3i),
    radius: float,
    remaining: wp.array3d(dtype=wp.uint16),
    removed: wp.array(dtype=wp.int64),
):
    """Every voxel of the burr's box loses what a linear ramp says lies inside the ball."""
    i, j, k = wp.tid()
    x, y, z = low[0][0] + i, low[0][1] + j, low[0][2] + k
    at = wp.vec3(float(x) + 0.5, float(y) + 0.5, float(z) + 0.5)
    inside = wp.clamp(0.5 - (wp.length(at - centre[0]) - radius), 0.0, 1.0)
    left = int(65535.0 * (1.0 - inside))
    old = int(remaining[x, y, z])
    if left < old:
        remaining[x, y, z] = wp.uint16(left)
        wp.atomic_add(removed, 0, wp.int64(old - left))


def main() -> None:
    wp.config.quiet = True
    cells = round(BLOCK_M / SPACING_M)
    remaining = wp.full((cells,) * 3, 65535, dtype=wp.uint16, device="cpu")
    centre, low = wp.zeros(1, dtype=wp.vec3, device="cpu"), wp.zeros(1, dtype=wp.vec3i, device="cpu")
    removed = wp.zeros(1, dtype=wp.int64, device="cpu")
    inputs = [centre, low, BURR_M / SPACING_M, remaining, removed]
    command = wp.launch(carve, dim=(BOX,) * 3, inputs=inputs, device="cpu", record_cmd=True)
    counted = [0, 0]

    def tick(index: int) -> None:
        at = burr_centre(index) / SPACING_M + cells / 2
        centre.numpy()[0], low.numpy()[0] = at, np.floor(at - BOX / 2)
        command.launch()
        if index == 49:
            counted[0] = int(removed.numpy()[0])

    times = timed(tick, count=300, warm_up=50)
    counted[1] = int(removed.numpy()[0])
    gone = (counted[1] - counted[0]) / 65535 * (1e3 * SPACING_M) ** 3 / 300
    say("brute-force Warp", "mill, carve alone", "6 mm ball, 0.1 mm", times, "warp-lang numpy", value=gone,
        unit="mm3 a tick")  # fmt: skip


if __name__ == "__main__":
    main()
