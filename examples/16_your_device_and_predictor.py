"""
Your device and your predictor
==============================

A device with two methods, `read` and `command`, presses a soft block with 4 ms of latency. A
predictor with two methods, `observe` and `predict`, hides the latency.

Expected: the error of the force relative to its size is 4.2 % without the predictor, and 1.5 % with
the predictor.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import tissue

Floats = NDArray[np.float64]
FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
LATENCY_MS = 4

# %%
# A device returns its position in metres and takes forces in newtons. This device imitates a motor
# that moves up and down, whatever force is commanded, so that runs can be compared. A class for
# real hardware has the same two methods.


class Shaker:
    """Device that oscillates with 3 mm around 1 mm below its origin, twice a second."""

    def __init__(self) -> None:
        self.last_N = np.zeros(3)

    def read(self, time_s: float) -> tissue.Sample:
        """Return a sample with the position and velocity of the device at a time."""
        # two cycles a second
        turn = 4.0 * np.pi
        height = 3e-3 * np.cos(turn * time_s) - 3e-3
        return tissue.Sample(
            time_s, (0.0, 0.0, height), (0.0, 0.0, -3e-3 * turn * np.sin(turn * time_s))
        )

    def command(self, force_N: Floats, torque_Nm: Floats) -> None:
        """Take the force to play."""
        self.last_N = force_N.copy()


# %%
# A predictor observes every tick, and returns the force some ticks later. This predictor continues
# the force along its last slope.


class Slope:
    """Predictor that continues the force along its slope over the last ticks."""

    def __init__(self) -> None:
        self.force_N = np.zeros(3)
        self.slope_N = np.zeros(3)
        self.age = 0

    def observe(self, position_m: Floats, velocity_m_s: Floats, force_N: Floats | None) -> None:
        """Observe a tick. If the tissue model is slow, only some ticks have a force."""
        self.age += 1  # ticks since the last force
        if force_N is not None:
            # mean over about 5 ticks, so that single encoder steps have little effect
            fade = 0.8**self.age
            slope_N = (force_N - self.force_N) / self.age
            self.slope_N = fade * self.slope_N + (1.0 - fade) * slope_N
            self.force_N = force_N
            self.age = 0

    def predict(self, ticks: float) -> Floats:
        """Return the predicted force a number of ticks later [N]."""
        return self.force_N + (self.age + ticks) * self.slope_N


# %%
# The stability of the loop is checked. Then the loop runs for one second in three versions: without
# latency, with latency, and with latency and the predictor.

block = tissue.Organ.block(
    (40.0, 40.0, 20.0), modulus_kPa=20.0, poisson_ratio=0.45, edge_mm=3.0, order=1
)
numbers = tissue.DeviceParameters(mass_kg=0.05, damping_N_s_m=0.5, force_limit_N=4.0)


def played(delay_ms: int, predictor: Slope | None) -> Floats:
    """Return the force at the device for one second [N], shape (1000,)."""
    loop = tissue.Loop(
        block,
        # small compared with the block of 40 mm; the ball starts 2 mm above the block
        tissue.ball(diameter_mm=12.0),
        device=Shaker(),
        limits=numbers,
        start_mm=(0.0, 0.0, 2.0),
        # 61 % below the critical stiffness at 4 ms of latency
        stiffness_N_m=300.0,
        delay_ms=delay_ms,
        predictor=predictor,
    )
    # with latency, the stability check is the same with and without the predictor
    if predictor is not None or not delay_ms:
        print(loop.notes["coupling"])
    return loop.run(1.0).trace["device_force_z_N"]


prompt = played(0, None)
late = played(LATENCY_MS, None)
predicted = played(LATENCY_MS, Slope())
errors = [
    float(np.linalg.norm(force - prompt) / np.linalg.norm(prompt)) for force in (late, predicted)
]
print(
    f"error with {LATENCY_MS} ms of latency: {errors[0]:.1%} of the force; with the predictor: "
    f"{errors[1]:.1%}"
)
assert abs(errors[0] - 0.042) < 0.004 and abs(errors[1] - 0.015) < 0.004

# %%
# Plot the force of one press: without latency, with latency, and with latency and the predictor.

figure, axes = plt.subplots(figsize=(8.0, 4.2), layout="constrained")
time_ms = np.arange(len(prompt))
for force, look, label in (
    (prompt, {"color": "0.15", "linewidth": 2.4}, "no latency"),
    (late, {"color": "#D55E00", "linestyle": "--"}, f"{LATENCY_MS} ms latency"),
    (predicted, {"color": "#0072B2"}, "4 ms latency, with the predictor"),
):
    axes.plot(time_ms, force, label=label, **look)
axes.set(xlabel="time / ms", ylabel="force at the device / N", xlim=(50, 450))
axes.set_title("Ball that a moving device presses into a soft block")
axes.grid(alpha=0.3)
axes.legend()
figure.savefig(FIGURES / "16_force.png", dpi=150)
