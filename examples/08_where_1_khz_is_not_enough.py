"""
Limits of a 1 kHz haptic loop
=============================

A virtual wall that feels hard needs a stiffness of about 1 kN/m. This example computes the loop
rate that a device needs to play this stiffness while nobody holds the device.

Expected for the six-degree-of-freedom device (75 g, 0.4 N s/m):

- Without delay and amplifier lag, the device is stable up to 801 N/m at 1 kHz and 1601 N/m at
  2 kHz. A rate of 1 kHz is not enough, but 2 kHz is enough.
- With half a millisecond of delay and an amplifier of 300 Hz, the device is stable up to 262 N/m at
  1 kHz and 371 N/m at 10 kHz. No rate is enough.
- In a hand, the device is stable up to 2906 N/m at 1 kHz, because of the damping of the hand.
- If a tissue model responds at 100 Hz, its force is held between two responses. The device in the
  hand is then stable up to 770 N/m only, at any rate of the loop.

Each of these stiffnesses is a critical stiffness, computed from eigenvalues. In a simulation,
oscillations grow at a stiffness 5 % above the critical stiffness, and decay at 5 % below it. A wall
feels hard from 0.8 to 1 kN/m (Choi and Tan 2004). The damping of the device is a prior.
"""

from collections.abc import Iterable
from dataclasses import replace
from math import inf
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
HARD_N_M = 1000.0
RATES_HZ = (250.0, 500.0, 1000.0, 2000.0, 5000.0, 10000.0)

# %%
# Compute the critical stiffness of three loops at each rate: the device without lag, the device
# with lag, and the device held by an expert. A loop is a dataclass of plain numbers.

real = [
    replace(tissue.stability.wall_loop("six-dof", HARD_N_M), tick_s=1.0 / rate) for rate in RATES_HZ
]
in_a_hand = tissue.stability.wall_loop("six-dof", HARD_N_M, hand="expert")
loops = {
    "not held, no lag": [replace(each, delay_s=0.0, amplifier_Hz=inf) for each in real],
    "not held": real,
    "held by an expert": [replace(in_a_hand, tick_s=1.0 / rate) for rate in RATES_HZ],
}
critical = {
    name: np.array([tissue.stability.critical_stiffness_N_m(each) for each in row])
    for name, row in loops.items()
}


def listed(numbers: Iterable[float]) -> str:
    """Format numbers in one line."""
    return ", ".join(f"{number:.0f}" for number in numbers)


for name, row in critical.items():
    enough = [f"{rate:g}" for rate, value in zip(RATES_HZ, row, strict=True) if value > HARD_N_M]
    print(
        f"{name}: {listed(row)} N/m at {listed(RATES_HZ)} Hz; hard enough at "
        f"{', '.join(enough) or 'none'}"
    )
at_1_khz = RATES_HZ.index(1000.0)
slow = replace(loops["held by an expert"][at_1_khz], model_ticks=10)
slow_critical = tissue.stability.critical_stiffness_N_m(slow)
print(f"held, 1 kHz, model at 100 Hz: {slow_critical:.0f} N/m")

free, lagging, held = critical.values()
assert abs(free[at_1_khz] - 801.0) < 1.0 and abs(free[at_1_khz + 1] - 1601.0) < 1.0
assert free[at_1_khz] < HARD_N_M < free[at_1_khz + 1]
assert (
    abs(lagging[at_1_khz] - 262.0) < 1.0
    and abs(lagging[-1] - 371.0) < 1.0
    and lagging.max() < HARD_N_M
)
assert abs(held[at_1_khz] - 2906.0) < 2.0
assert abs(slow_critical - 770.0) < 2.0

# %%
# A simulation of the loop over four seconds confirms the eigenvalues. The oscillation grows at 5 %
# above the critical stiffness, and decays at 5 % below the critical stiffness.

for loop in (*(row[at_1_khz] for row in loops.values()), slow):
    limit = tissue.stability.critical_stiffness_N_m(loop)
    above, below = (
        tissue.stability.growth(loop.with_stiffness(share * limit), seconds=4.0)
        for share in (1.05, 0.95)
    )
    print(
        f"{limit:4.0f} N/m: a push grows {above:.3g} times 5 % above, {below:.3g} times 5 % below"
    )
    assert above > 1.0 > below

# %%
# Plot the critical stiffness as a function of the rate. Walls above the shaded range feel hard.

figure, axes = plt.subplots(figsize=(7.5, 4.6), layout="constrained")
for (name, row), colour, marker in zip(
    critical.items(), ("#0072B2", "#E69F00", "#009E73"), "os^", strict=True
):
    axes.loglog(RATES_HZ, row, color=colour, marker=marker, label=name)
axes.axhspan(800.0, 1000.0, color="0.85", zorder=0)
axes.text(RATES_HZ[0], 890.0, "feels hard", color="0.3", va="center")
axes.set(
    xlabel="loop rate / Hz",
    ylabel="critical stiffness / (N/m)",
    title="Largest stable stiffness of a wall",
)
axes.grid(alpha=0.3, which="both")
axes.legend()
figure.savefig(FIGURES / "08_rates.png", dpi=150)
