"""
Assess a trainee against an expert
==================================

A simulated novice presses a wall. The run is compared with the run of a simulated expert. The two
hands hold the same simulated device (Touch), with the same seed.

The score measures how steady the hand is. It is 0 for the tremor of a novice, and 100 for the
tremor of an expert. The other measures are the distance from the path, the force and the depth. The
two runs are compared at equal positions along the path, so a different pace is not an error.

Expected:

- The novice has a score near 0, and the expert a score near 100.
- The novice deviates by 3.6 mm from the straight path of the expert.
- The novice presses the wall with 35 N, and the expert with 27 N. The device plays a small share of
  these forces.
- The novice exceeds the force limit once, 0.6 s after the start.

The differences between the hands are priors (`tissue/materials`). The example shows the method. It
gives no results about real people.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)

# %%
# Simulate two runs of one scene. `tissue.assess` takes runs, or the folders that `run.save` and
# `tissue run` write.

novice, expert = (
    tissue.simulate(tissue.load_scene("wall", {"device": "touch", "hand": hand, "seed": 3}))
    for hand in ("novice", "expert")
)
found = tissue.assess(novice, expert)
print(found)
figures = found.figures
assert abs(figures["deviation_mm"]["worst"] - 3.56) < 0.1
assert abs(figures["peak_force_N"]["trainee"] - 35.2) < 0.7
assert abs(figures["peak_force_N"]["reference"] - 27.1) < 0.6
forces = [each for each in found.breaches if each.what == "force"]
assert len(forces) == 1 and abs(forces[0].worst_at_s - 0.62) < 0.02
hands = found.steadiness, tissue.assess(expert, novice).steadiness
assert hands[0] is not None and hands[0].score < 40.0
assert hands[1] is not None and hands[1].score > 80.0

# %%
# Plot the measures of the trainee as a function of time, the reference at the same position, and
# the limits. Marks show the times in which a limit was exceeded.

quantities = (found.deviation, found.force, found.depth)
figure, panels = plt.subplots(3, 1, figsize=(8.0, 6.4), sharex=True, layout="constrained")
for panel, each, label in zip(
    panels, quantities, ("distance from\nthe path / mm", "force / N", "depth / mm"), strict=True
):
    panel.plot(found.time_s, each.values, color="#0072B2", label="trainee")
    if each.reference is not None:
        panel.plot(found.time_s, each.reference, color="0.45", label="reference at that place")
    panel.axhline(each.limit, color="#D55E00", linestyle="--", label="limit")
    for breach in each.breaches(found.time_s):
        panel.axvspan(breach.start_s, breach.end_s, color="#E69F00", alpha=0.35, linewidth=0)
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)
panels[1].legend(loc="upper right")
panels[2].set(xlabel="time / s", ylim=(-3.0, None))
panels[0].set_title("Novice against expert on a wall; shaded: above the limit")
figure.savefig(FIGURES / "13_assessment.png", dpi=150)
