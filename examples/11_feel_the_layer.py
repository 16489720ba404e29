"""
Feel the layer of a liver
=========================

This example tests whether simulated people can discriminate the capsule of a liver from the
parenchyma below the capsule. The example also tests whether scaling the force to the perception of
each person improves discrimination.

Expected:

- The mean force on the needle is 2.1 N in the tenth of a second before the puncture, and 1.6 N in
  the tenth of a second after the puncture. 100 simulated people of each group discriminate the two
  forces with an error rate below 10 %.
- To scale the force for a person, the person first rates 24 forces with a number. Scaling changes
  the share of correct answers by less than 3 %.

A mapping that increases with the force and keeps two end points also keeps the number of just
noticeable differences between these end points. If the mapping improves discrimination in one range
of forces, it reduces discrimination in another range. Scaling increases the force difference for
people whose Stevens exponent is below the reference exponent, and decreases it for other people.
For a person with the reference exponent, scaling has no effect.

The scatter of the tissue is larger than any of these effects: a capsule breaks at a force between
1.7 and 2.9 N. Exponents and thresholds of people are priors.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
PEOPLE = 100
GROUPS = ("novice", "intermediate", "expert")
WINDOW_S = 0.1  # time over which a person averages a force

# %%
# Run the scene `needle`, and compute the mean force in a time window before the puncture and in one
# after the puncture.

run = tissue.simulate(tissue.load_scene("needle", {"duration_s": 1.5}))
time_s = run.trace["time_s"]
force_N = np.linalg.norm(run.trace.vectors("model_force", "N"), axis=1)
puncture_s = next(time for time, what in run.events if "capsule" in what)
starts = {"capsule": puncture_s - WINDOW_S - 1e-3, "parenchyma": puncture_s + 1e-3}
levels = {
    name: float(force_N[(time_s >= start) & (time_s < start + WINDOW_S)].mean())
    for name, start in starts.items()
}
capsule, parenchyma = levels.values()
print(f"capsule {capsule:.2f} N, parenchyma {parenchyma:.2f} N")
assert 1.9 < capsule < 2.3 and 1.5 < parenchyma < 1.8

# %%
# Simulated people of each group compare the two forces, first unscaled and then scaled for each
# person.

errors = {}
for group in GROUPS:
    crowd = tissue.calibration.people(group, PEOPLE)
    plain = tissue.calibration.share_right(crowd, capsule, parenchyma, seed=1)
    scaled = tissue.calibration.share_right(crowd, capsule, parenchyma, seed=1, calibrated_by=24)
    gain = tissue.calibration.change_percent(plain, scaled)
    errors[group] = 100 * (1 - plain.mean()), 100 * (1 - scaled.mean())
    print(
        f"{group}: error {errors[group][0]:.1f} %, with calibration {errors[group][1]:.1f} %; "
        f"right answers change by {gain.value:+.1f} % ({gain.low:+.1f} to {gain.high:+.1f})"
    )
    assert plain.mean() > 0.9 and scaled.mean() > 0.9 and abs(gain.value) < 3.0

same = tissue.calibration.alike(PEOPLE)
plain, scaled = (
    tissue.calibration.share_right(same, capsule, parenchyma, seed=1, calibrated_by=numbers)
    for numbers in (None, 0)
)
print(f"reference: right answers change by {100 * abs(scaled - plain).max():.1f} %")
assert (plain == scaled).all()

# %%
# Plot the two time windows in the run, and the share of wrong answers.

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.0), layout="constrained")
left.plot(time_s, force_N, color="0.15", linewidth=1.6)
for (name, start), colour in zip(starts.items(), ("#E69F00", "#56B4E9"), strict=True):
    left.axvspan(
        start,
        start + WINDOW_S,
        color=colour,
        alpha=0.4,
        linewidth=0,
        label=f"{name}, {levels[name]:.2f} N",
    )
left.set(xlabel="time / s", ylabel="force on the needle / N", title="before and after the puncture")
left.legend(loc="upper left")
left.grid(alpha=0.3)
places = np.arange(len(GROUPS))
right.bar(
    places - 0.2,
    [errors[group][0] for group in GROUPS],
    0.38,
    color="#0072B2",
    label="unscaled force",
)
right.bar(
    places + 0.2,
    [errors[group][1] for group in GROUPS],
    0.38,
    color="#009E73",
    label="force scaled for each person",
)
right.set_xticks(places, GROUPS)
right.set(ylabel="wrong answers / %", title=f"{PEOPLE} simulated people of each group")
right.legend()
right.grid(axis="y", alpha=0.3)
figure.savefig(FIGURES / "11_layer.png", dpi=150)
