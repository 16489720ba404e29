"""Warp as one would write it first: every voxel of the burr's box, every tick."""

import numpy as np
import warp as wp
from brute_force import carve
from works import BLOCK_M, BURR_M, SPACING_M, burr_centre, print_result, timed

BOX = int(2 * BURR_M / SPACING_M) + 4


def main() -> None:
    wp.config.quiet = True
    cells = round(BLOCK_M / SPACING_M)
    remaining = wp.full((cells,) * 3, 65535, dtype=wp.uint16, device="cpu")
    centre, low = (
        wp.zeros(1, dtype=wp.vec3, device="cpu"),
        wp.zeros(1, dtype=wp.vec3i, device="cpu"),
    )
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
    print_result(
        "brute-force Warp",
        "mill, carve alone",
        "6 mm ball, 0.1 mm",
        times,
        "warp-lang numpy",
        value=gone,
        unit="mm3 a tick",
    )


if __name__ == "__main__":
    main()
