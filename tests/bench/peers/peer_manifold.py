"""Peer manifold3d, which subtracts the burr's ball from a block tick by tick.

It uses exact booleans of triangle meshes.
"""

import numpy as np
from manifold3d import Manifold
from works import BLOCK_M, BURR_M, burr_centre, print_result, timed

SEGMENTS = 64
TICKS = 60


def main() -> None:
    block = Manifold.cube((BLOCK_M * 1e3,) * 3, True)
    ball = Manifold.sphere(BURR_M * 1e3, SEGMENTS)
    left = {"it": block, "first": 0.0}

    def tick(index: int) -> None:
        left["it"] = left["it"] - ball.translate(list(1e3 * burr_centre(index)))
        gone = left["it"].volume()
        if index == 0:
            left["first"] = gone

    times = timed(tick, count=TICKS)
    gone = (left["first"] - left["it"].volume()) / (TICKS - 1)
    print_result(
        "manifold3d",
        "mill, carve alone",
        f"6 mm ball, {SEGMENTS} segments",
        times[1:],
        "manifold3d numpy",
        value=gone,
        unit="mm3 a tick",
    )
    growth = np.median(times[-15:]) / np.median(times[5:20])
    print_result(
        "manifold3d",
        "mill, growth of a tick over 60",
        f"6 mm ball, {SEGMENTS} segments",
        times[-15:],
        "manifold3d numpy",
        value=float(growth),
        unit="times the first ones",
    )


if __name__ == "__main__":
    main()
