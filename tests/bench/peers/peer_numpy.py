"""NumPy: the same box of voxels, array by array."""

import numpy as np
from works import BLOCK_M, BURR_M, SPACING_M, burr_centre, print_result, timed

BOX = int(2 * BURR_M / SPACING_M) + 4


def main() -> None:
    cells = round(BLOCK_M / SPACING_M)
    remaining = np.full((cells,) * 3, 65535, dtype=np.uint16)
    grid = np.indices((BOX,) * 3).astype(np.float32) + 0.5
    counted = []

    def tick(index: int) -> None:
        at = burr_centre(index) / SPACING_M + cells / 2
        low = np.floor(at - BOX / 2).astype(int)
        offset = (at - low).astype(np.float32)
        distance = np.sqrt(((grid - offset[:, None, None, None]) ** 2).sum(axis=0)) - np.float32(
            BURR_M / SPACING_M
        )
        left = (65535 * (1 - np.clip(0.5 - distance, 0, 1))).astype(np.uint16)
        part = remaining[tuple(slice(a, a + BOX) for a in low)]
        new = np.minimum(part, left)
        counted.append(int(part.sum(dtype=np.int64) - new.sum(dtype=np.int64)))
        part[:] = new

    times = timed(tick, count=40, warm_up=3)
    gone = np.mean(counted[3:]) / 65535 * (1e3 * SPACING_M) ** 3
    print_result(
        "NumPy",
        "mill, carve alone",
        "6 mm ball, 0.1 mm",
        times,
        "numpy",
        value=gone,
        unit="mm3 a tick",
    )


if __name__ == "__main__":
    main()
