"""
Latency hidden by prediction
============================

On a stiff wall, a force that is played 4 ms late has an error of nearly 4 %. This example shows how
much of this error a prediction can remove.

Three simulated hands, one of each expertise group, push a ball onto a wall. The latency between
force and device is 4 ms. The error of a run is ||F - ideal|| / ||ideal||, where F is the force at
the motor. The ideal force is the force of a loop without delay at the true position of the device.

Expected errors:

- 3.7 % without prediction,
- 1.6 % with a straight line through the last ten milliseconds,
- 0.6 % with a Koopman operator: the operator predicts the path from past positions, and the force
  is computed from the law of the wall at the end of this path,
- 0.3 % with a perfect prediction from the encoder steps.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
HANDS = ("novice", "intermediate", "expert")
PREDICTIONS = {
    "none": "no prediction",
    "linear": "straight line",
    "koopman-look-ahead": "predicted path, law of the wall",
}
LATENCY_MS = 4

# %%
# Run each hand with each predictor. `tissue.motor_forces` returns the played and the ideal force.

runs: dict[str, list[tissue.Run]] = {}
for kind in PREDICTIONS:
    runs[kind] = [
        tissue.simulate(
            tissue.load_scene(
                "wall",
                {
                    "hand": hand,
                    "seed": 500 + i,
                    "prediction": kind,
                    "coupling.delay_ms": LATENCY_MS,
                },
            )
        )
        for i, hand in enumerate(HANDS)
    ]
forces = {kind: [tissue.motor_forces(each) for each in of] for kind, of in runs.items()}


def error(force_N: NDArray[np.float64], ideal_N: NDArray[np.float64]) -> float:
    """Return the error of a force relative to the ideal force (ratio of L2 norms)."""
    return float(np.linalg.norm(force_N - ideal_N) / np.linalg.norm(ideal_N))


none, linear, predicted = (
    float(np.mean([error(each.played, each.ideal) for each in of])) for of in forces.values()
)
least = float(np.mean([error(each.nearest, each.ideal) for each in forces["koopman-look-ahead"]]))
trusted = float(np.mean([each.trace["predicted_by"].mean() for each in runs["koopman-look-ahead"]]))
for name, value in zip(PREDICTIONS.values(), (none, linear, predicted), strict=True):
    print(f"{name:>31}: {100.0 * value:.2f} % of the force, {LATENCY_MS} ms late")
print(f"{'predicted without error':>31}: {100.0 * least:.2f} %")
print(f"the operator was trusted in {100.0 * trusted:.1f} % of the ticks")
assert (
    abs(none - 0.037) < 0.004 and abs(predicted - 0.0061) < 0.001 and abs(least - 0.0031) < 0.0006
)
assert predicted < 0.5 * linear and linear < 0.6 * none

# %%
# Plot the first touch of the novice: ideal force, and played force with and without prediction.

figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
for panel, kind in zip(panels, ("none", "koopman-look-ahead"), strict=True):
    touch = forces[kind][0]
    start = int(np.flatnonzero(touch.ideal[:, 2])[0])
    shown = slice(start - 15, start + 75)
    time_ms = np.arange(-15, 75)
    panel.plot(time_ms, touch.ideal[shown, 2], color="0.15", linewidth=2.0, label="ideal")
    panel.plot(
        time_ms,
        touch.played[shown, 2],
        color="#D55E00",
        linestyle="--",
        linewidth=1.6,
        label="played",
    )
    panel.set(title=PREDICTIONS[kind], xlabel="time since the touch / ms")
    panel.grid(alpha=0.3)
panels[0].set_ylabel("force at the motor / N")
panels[0].legend(frameon=False)
figure.savefig(FIGURES / "09_touch.png", dpi=150)
