"""
Try a protocol without people
=============================

Before you invite people to a study, try its files and its analysis with simulated people. The
question of this study is: do people press a wall harder if the device plays a quarter of the force?

Twelve simulated people press the wall under two conditions: the full force and the weak force. Half
of the people begin with the weak force. The folders have the same layout as in a study with a real
device (see the guide, "Run a study with participants"). The analysis reads only these folders.

Expected:

- With the weak force, the peak force at the tool is larger for each of the twelve people. The mean
  difference is 19 N (95 % interval 16 to 21 N).
- Sign flips of the twelve differences give p = 0.0005, the smallest value that twelve differences
  can have.
- The order of the conditions has no effect, because a simulated person does not learn.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy import stats

import tissue

FIGURES = Path("figures")
FIGURES.mkdir(exist_ok=True)
PEOPLE = 12
GROUPS = ("novice", "intermediate", "expert")
FORCE_SCALES = {"full": 0.02, "weak": 0.005}

# %%
# Each person has a folder, which holds the log of the calibration and a folder for each attempt.
# The name of the folder of an attempt is the condition and the number of the attempt.


def session(folder: Path, number: int) -> None:
    """Simulate the session of one person: the calibration and then the two conditions."""
    folder.mkdir()
    group = GROUPS[number % 3]
    answers = tissue.calibration.simulated_answers(
        tissue.calibration.people(group, 1, seed=number), seed=number
    )
    tissue.calibration.run(answers, folder / "observer.trials.jsonl", name=folder.name, trials=60)
    order = list(FORCE_SCALES) if number % 2 == 0 else list(FORCE_SCALES)[::-1]
    for condition in order:
        scene = tissue.load_scene(
            "wall",
            {
                "device": "touch",
                "hand": group,
                "seed": 100 + number,
                "coupling.force_scale": FORCE_SCALES[condition],
            },
        )
        tissue.simulate(scene).save(folder / f"{condition}-1", pictures=False)


with tempfile.TemporaryDirectory() as folder:
    people = Path(folder) / "people"
    people.mkdir()
    for number in range(PEOPLE):
        session(people / f"p{number + 1:02d}", number)
    reference = tissue.simulate(tissue.load_scene("wall", {"device": "touch", "seed": 1}))
    found = tissue.rank(people, reference)

# %%
# The measure, chosen before the study, is the peak force at the tool. For each person and
# condition, take the mean over the attempts. The two means give one difference for each person. The
# test flips the signs of these differences.

measured = {
    person.name: {
        attempt.name.rsplit("-", 1)[0]: attempt.found.figures["peak_force_N"]["trainee"]
        for attempt in person.attempts
    }
    for person in found.people
}
full, weak = (np.array([each[name] for each in measured.values()]) for name in FORCE_SCALES)
differences = weak - full
tested = stats.permutation_test((differences,), np.mean, permutation_type="samples")
low, high = stats.t.interval(0.95, PEOPLE - 1, loc=differences.mean(), scale=stats.sem(differences))
print(
    f"peak force: {differences.mean():+.1f} N with the weak force (95 %: {low:.1f} to {high:.1f}), "
    f"p = {tested.pvalue:.4f}, {np.sum(differences > 0)} of {PEOPLE} people press harder"
)

assert abs(differences.mean() - 18.7) < 1.5 and (differences > 0.0).all()
assert abs(tested.pvalue - 2.0 / 2**PEOPLE) < 1e-9

# %%
# Plot one line for each person.

figure, axes = plt.subplots(figsize=(5.0, 4.0), layout="constrained")
for each in measured.values():
    axes.plot([0, 1], [each["full"], each["weak"]], "o-", color="#0072B2", alpha=0.7)
axes.set_xticks([0, 1], ["full force", "a quarter of the force"])
axes.set(xlim=(-0.3, 1.3), ylabel="peak force at the tool / N")
axes.grid(axis="y", alpha=0.3)
figure.savefig(FIGURES / "20_people.png", dpi=150)
