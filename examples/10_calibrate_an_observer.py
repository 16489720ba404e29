"""
Calibrate an observer
=====================

An observer is a model of a person's force perception. This example shows how well the constants of
an observer can be measured. The person compares two forces 120 times, and rates 24 forces with a
number.

Expected:

- A simulated person with a Weber fraction of 7 % and a Stevens exponent of 1.7 is estimated at
  7.7 % and 1.71. Both true values are in the 95 % intervals.
- A session that is interrupted after 50 trials and continued from its log ends with the same
  observer, bit for bit.
- In simulated sessions with 200 such people, the error of the Weber fraction is about 15 %. This is
  the limit of 120 answers, because the answer to a comparison is one bit.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
WEBER = 0.07
EXPONENT = 1.7
PEOPLE = 200
TRUTH = {
    "alpha": 1.0,
    "beta": EXPONENT,
    "kappa": WEBER,
    "offset_N": 0.2,
    "lapse": 0.02,
    "sigma": 0.2,
}

# %%
# A session chooses the most informative question, and writes every answer to a log before the next
# question. Here a simulated person answers. In a real session, a function plays two forces on a
# device and reads a key.

answer = tissue.calibration.simulated_answers(tissue.calibration.alike(1, **TRUTH), seed=1)
with tempfile.TemporaryDirectory() as folder:
    done = tissue.calibration.run(answer, Path(folder) / "straight.jsonl", name="seven percent")
    tissue.calibration.run(answer, Path(folder) / "cut.jsonl", name="seven percent", trials=50)
    again = tissue.calibration.run(answer, Path(folder) / "cut.jsonl", name="seven percent")
for line in done.lines():
    print(line)
low, high = done.threshold.weber_quantiles(np.array([0.025, 0.975]))[:, 0]
weber = done.threshold.weber()[0][0]
numbers = done.magnitudes()
least, most = numbers.exponent_at([0.025, 0.975])
assert low < WEBER < high and least < EXPONENT < most
assert abs(weber / WEBER - 1.0) < 0.35 and abs(numbers.mean[1] / EXPONENT - 1.0) < 0.1
assert (again.observer("a").mean == done.observer("a").mean).all()

# %%
# One session with each of 200 people shows the scatter of a session. All these people have the same
# true values.

found = tissue.calibration.estimated_webers(tissue.calibration.alike(PEOPLE, **TRUTH))
spread = float(np.log(found / WEBER).std())
print(f"scatter of the Weber fraction over {PEOPLE} people: {100 * spread:.0f} %")
assert 0.12 < spread < 0.19

# %%
# Plot the result of one session, the results of the sessions with 200 people, and the numbers that
# the person gave to forces.

figure, panels = plt.subplots(1, 3, figsize=(12, 4.0), layout="constrained")
edges = 100.0 * done.threshold.prior.weber_edges
panels[0].stairs(done.threshold.weber_masses()[:, 0], edges, color="#0072B2", fill=True, alpha=0.6)
panels[0].set(
    xlim=(2.0, 20.0),
    xlabel="Weber fraction / %",
    ylabel="posterior probability",
    title="posterior after one session",
)
panels[1].hist(100.0 * found, bins=20, color="#56B4E9")
panels[1].set(
    xlabel="estimated Weber fraction / %",
    ylabel="people",
    title=f"one session with each of {PEOPLE} people",
)
for panel in panels[:2]:
    panel.axvline(100.0 * WEBER, color="#D55E00", linestyle="--", label="true value")
panels[0].legend()
forces_N, given = np.array(done.given).T
at = np.geomspace(forces_N.min(), forces_N.max(), 50)
panels[2].loglog(forces_N, given, "o", color="#E69F00", alpha=0.7, label="numbers from the person")
panels[2].loglog(
    at, np.exp(numbers.mean[0]) * at ** numbers.mean[1], color="#0072B2", label="fitted power law"
)
panels[2].set_xticks([0.3, 0.5, 1, 2, 3], ["0.3", "0.5", "1", "2", "3"])
panels[2].set_xticks([], minor=True)
panels[2].set(
    xlabel="force / N",
    ylabel="number",
    title=f"exponent {numbers.mean[1]:.2f}, true value {EXPONENT}",
)
panels[2].legend()
for panel in panels:
    panel.grid(alpha=0.3)
figure.savefig(FIGURES / "10_observer.png", dpi=150)
