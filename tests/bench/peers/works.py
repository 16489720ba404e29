"""Work that peers and this project both do, in NumPy alone, and the line that reports its time."""

import gc
import json
import platform
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from itertools import permutations
from time import process_time

import numpy as np

__all__ = [
    "BALL_M",
    "BLOCK_M",
    "BURR_M",
    "CLAMPED_CELLS",
    "CUBE_CELLS",
    "DELAYS",
    "FEED_M_S",
    "HORIZON",
    "POISSON",
    "SLABS",
    "SLAB_M",
    "SPACING_M",
    "STEP_S",
    "YOUNG_PA",
    "ball_centre",
    "ball_tip",
    "bricks_in_tetrahedra",
    "burr_centre",
    "burr_tip",
    "contacts",
    "print_result",
    "timed",
]

STEP_S = 1e-3
YOUNG_PA, POISSON = 5e3, 0.45
CUBE_CELLS, CLAMPED_CELLS = (17, 17, 17), (12, 12, 12)
SLAB_M, SLABS = (0.1, 0.1, 0.04), ((8, 5, 4), (10, 10, 5))
"""A slab [m] and bricks along its edges."""
BALL_M, DEPTH_M = 0.01, 4e-3
"""Radius of the ball that presses the slab, and how deep [m]."""
BURR_M, SPACING_M, BLOCK_M, FEED_M_S = 3e-3, 1e-4, 25.6e-3, 5e-3
"""Radius of the burr, voxel, edge of the block [m]; the feed."""
DELAYS, HORIZON = 10, 10
"""Earlier samples that a predictor looks at, and ticks that it looks ahead."""


def timed(call: Callable[[int], object], *, count: int, warm_up: int = 0) -> list[float]:
    """Return the processor seconds that ``call(i)`` takes.

    The first ``warm_up`` calls are made but not counted.

    Wall-clock time would add the machine's other work to long calls, and only to these.
    """
    times = []
    gc.collect()
    gc.disable()
    try:
        for index in range(warm_up + count):
            start = process_time()
            call(index)
            times.append(process_time() - start)
    finally:
        gc.enable()
    return times[warm_up:]


def print_result(
    name: str, work: str, size: str, times_s: list[float], packages: str, *, value: float, unit: str
) -> None:
    """One line of JSON: what was done, what a call cost [us], and a number that came out of it."""
    us = 1e6 * np.asarray(times_s)
    found = {}
    for package in packages.split():
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "here"
    line = {
        "name": name,
        "work": work,
        "size": size,
        "median_us": float(np.median(us)),
        "p99_us": float(np.percentile(us, 99)),
        "calls": len(us),
        "value": float(value),
        "unit": unit,
        "versions": {**found, "python": platform.python_version()},
    }
    print(json.dumps(line), flush=True)


def bricks_in_tetrahedra(
    size_m: tuple[float, ...], cells: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [m] and tetrahedra of a box, six a brick (Kuhn 1960)."""
    axes = [np.linspace(0.0, size, count + 1) for size, count in zip(size_m, cells, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape([count + 1 for count in cells])
    found = []
    for order in permutations(range(3)):
        odd = sum(order[i] > order[j] for i, j in ((0, 1), (0, 2), (1, 2))) % 2
        at, corners = np.zeros(3, dtype=int), []
        for axis in (None, *order):
            if axis is not None:
                at[axis] += 1
            corners.append(
                number[tuple(slice(a, a + n) for a, n in zip(at, cells, strict=True))].ravel()
            )
        if odd:
            corners[2], corners[3] = corners[3], corners[2]
        found.append(np.stack(corners, axis=1))
    return nodes, np.concatenate(found)


def ball_tip(tick: int, top_m: float = SLAB_M[2]) -> np.ndarray:
    """Lowest point of the ball: down to its depth in 200 ticks, then along at 20 mm/s."""
    travel = max(0, tick - 200) * 20e-3 * STEP_S
    return np.array(
        [0.5 * SLAB_M[0] + travel, 0.5 * SLAB_M[1], top_m - DEPTH_M * min(1.0, tick / 200)]
    )


def ball_centre(tick: int) -> np.ndarray:
    """Middle of the ball on the slab's top [m]."""
    return ball_tip(tick, SLAB_M[2]) + np.array([0.0, 0.0, BALL_M])


def burr_centre(tick: int) -> np.ndarray:
    """Middle of the burr [m]."""
    return burr_tip(tick) + np.array([0.0, 0.0, BURR_M])


def burr_tip(tick: int) -> np.ndarray:
    """Lowest point of a burr that goes through a block about the origin, all of it inside [m]."""
    return np.array([-8e-3 + FEED_M_S * STEP_S * tick, 2e-5, -BURR_M])


def contacts(seed: int, seconds: float = 2.0) -> np.ndarray:
    """Return position [m] and force [N] of a tool that strokes a wall, (n, 6), one row per tick.

    The tool leaves the wall again and again.
    """
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds / STEP_S)) * STEP_S
    rates_Hz, phases = (
        rng.uniform((0.5, 1.5, 4.0), (1.0, 3.0, 8.0), (3, 3)),
        rng.uniform(0.0, 6.0, (3, 3)),
    )
    waves = np.sin(2.0 * np.pi * rates_Hz[:, :, None] * time_s + phases[:, :, None])
    at = 1e-3 * np.einsum("w,cwt->tc", (1.5, 0.6, 0.2), waves)
    speed = np.gradient(at, STEP_S, axis=0)
    depth = np.maximum(-at[:, 2], 0.0)
    press = (depth > 0.0) * np.maximum(800.0 * depth - 2.0 * speed[:, 2], 0.0)
    force = np.column_stack([-0.3 * press[:, None] * np.tanh(speed[:, :2] / 1e-3), press])
    return np.hstack([at, force + rng.normal(0.0, 5e-3, force.shape)])
