"""Velocity from encoder steps on every scene, by three estimators.

They are the raw difference, the first-order adaptive window and constant acceleration.

Run: python tests/bench/bench_velocity.py [SCENE ...]

Hands of all groups move the device for two seconds a scene. Error is the root mean square over the
ticks and axes against the velocity of the device's true position, central differences of it; delay
is the shift at which both correlate best.
"""

import sys
from functools import partial

import numpy as np
from harness import machine, table

from meshes.base.arrays import Array
from tissue import load_scene, simulate
from tissue.evaluation.statistics.metrics import latency_ms
from tissue.haptics.device.device import device_parameters
from tissue.haptics.loop.filters import ConstantAcceleration
from tissue.models.tissue_model import TICK_S
from tissue.scene.registry import GROUPS

SCENES = ("wall", "palpation", "liver-press", "needle", "milling", "glenoid", "molar", "caries")
SECONDS = 2.0
MEMORIES = (0.7, 0.75, 0.8, 0.85, 0.9, 0.93)
WINDOWS = (5, 8, 15, 30)
"""Longest windows of the adaptive one [ticks]."""


def recorded(name: str, index: int) -> tuple[Array, Array, float]:
    """Return encoder and true positions [m], each shape (n, 3), and the encoder step [m]."""
    entries = {
        "device": "touch",
        "hand": GROUPS[index % len(GROUPS)],
        "seed": 600 + index,
        "duration_s": SECONDS,
        "prediction": "none",
        "coupling.delay_ms": 0,
        "stress": None,
    }
    trace = simulate(load_scene(name, entries)).trace
    step = device_parameters("touch").encoder_step_m
    return 1e-3 * trace.vectors("device", "mm"), 1e-3 * trace.vectors("device_true", "mm"), step


def difference(position_m: Array, step_m: float) -> Array:
    """Raw difference of each tick [m/s]."""
    return np.diff(position_m, axis=0, prepend=position_m[:1]) / TICK_S


def adaptive(position_m: Array, step_m: float, *, longest: int) -> Array:
    """First-order adaptive window, end-fit (Janabi-Sharifi, Hayward and Chen 2000) [m/s].

    In each axis the longest window is taken whose line from its first to its last sample passes all
    within it by no more than the noise, a whole step of the encoder for the difference of two
    rounded samples.
    """
    found = np.zeros_like(position_m)
    for axis, places in enumerate(position_m.T):
        for now in range(1, len(places)):
            for length in range(1, min(now, longest) + 1):
                window = places[now - length : now + 1]
                slope = (window[-1] - window[0]) / length
                line = window[-1] - slope * np.arange(length, -1, -1)
                if np.abs(window - line).max() > step_m * (1.0 + 1e-9):
                    break
                found[now, axis] = slope / TICK_S
    return found


def smooth(position_m: Array, step_m: float, *, memory: float) -> Array:
    """Constant acceleration with fading memory [m/s]."""
    estimate = ConstantAcceleration(memory, step_s=TICK_S)
    return np.array([estimate.step(place) for place in position_m])


ESTIMATES = {
    "raw difference": difference,
    **{f"adaptive window, at most {n}": partial(adaptive, longest=n) for n in WINDOWS},
    **{f"constant acceleration, memory {m:g}": partial(smooth, memory=m) for m in MEMORIES},
}


def main() -> None:
    """Record, estimate, print."""
    print(machine())
    rows, over_all = [], {name: [] for name in ESTIMATES}
    for index, scene in enumerate(sys.argv[1:] or SCENES):
        position, truth, step = recorded(scene, index)
        velocity = np.gradient(truth, TICK_S, axis=0)
        size = float(np.sqrt((velocity**2).mean()))
        for name, estimate in ESTIMATES.items():
            found = estimate(position, step)[50:-1]
            error = float(np.sqrt(((found - velocity[50:-1]) ** 2).mean()))
            delay = latency_ms(found, velocity[50:-1], tick_s=TICK_S)
            over_all[name].append((error / size, delay))
            rows.append(
                (scene, name, f"{1e3 * error:.2f}", f"{100.0 * error / size:.1f}", f"{delay:.1f}")
            )
    for name, each in over_all.items():
        error, delay = np.mean(each, axis=0)
        worst = max(found[0] for found in each)
        rows.append(
            ("all", name, f"worst {100.0 * worst:.1f} %", f"{100.0 * error:.1f}", f"{delay:.1f}")
        )
    print(table(rows, ("scene", "velocity", "error mm/s", "% of the velocity", "delay ms")))


if __name__ == "__main__":
    main()
