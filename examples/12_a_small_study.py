"""
A small study
=============

This example tests whether a prediction of the force hides the latency during contact with a wall.

Expected from two trials of each group:

- Without prediction, the error of the played force is 5 %, relative to the force without latency.
- Prediction by a Koopman operator reduces this error to less than 85 % of its value, and the lag of
  6 ms by more than 2 ms.
- A trial that runs alone gives bitwise equal results.

All people in this study are simulated.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
PLAN = tissue.study.Plan(trials=2, tasks=("T2",), methods=("penalty", "koopman"))

# %%
# The trials run in two worker processes, which import this script. The code that starts these
# processes is therefore under the main guard.

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        table = tissue.study.run(PLAN, Path(folder) / "study", workers=2).table("T2")
    means = {
        method: {
            metric: table.where(method=method).values(metric).mean()
            for metric in ("force_error", "latency_ms")
        }
        for method in PLAN.methods
    }
    for method, figures in means.items():
        print(
            f"{method}: force error {100 * figures['force_error']:.1f} %, "
            f"{figures['latency_ms']:.1f} ms late"
        )
    plain = means["penalty"]
    predicted = means["koopman"]
    assert (
        0.02 < plain["force_error"] < 0.1 and predicted["force_error"] < 0.85 * plain["force_error"]
    )
    assert plain["latency_ms"] - predicted["latency_ms"] > 2.0

# %%
# Run a single trial of the study by its name, to inspect this trial.

if __name__ == "__main__":
    alone = tissue.study.trial(PLAN, "T2-expert-0001").rows[1]
    inside = table.where(group="expert", method="koopman").values("force_error")[1]
    assert alone["force_error"] == inside
    print(f"trial T2-expert-0001 alone: the same {100 * inside:.3f} %")

# %%
# Plot a line for each trial. The line connects the errors of the two methods.

if __name__ == "__main__":
    figure, panels = plt.subplots(1, 2, figsize=(8.0, 4.0), layout="constrained")
    labels = {
        "force_error": ("force error / %", 100.0),
        "latency_ms": ("latency of the force / ms", 1.0),
    }
    for panel, (metric, (label, scale)) in zip(panels, labels.items(), strict=True):
        for group, colour in zip(PLAN.groups, ("#E69F00", "#56B4E9", "#009E73"), strict=True):
            pairs = [
                table.where(group=group, method=method).values(metric) for method in PLAN.methods
            ]
            lines = panel.plot(PLAN.methods, scale * np.array(pairs), "o-", color=colour)
            lines[0].set_label(group)
        panel.set(ylabel=label, ylim=(0.0, None), xlim=(-0.3, 1.3))
        panel.grid(axis="y", alpha=0.3)
    panels[1].legend()
    FIGURES.mkdir(exist_ok=True)
    figure.savefig(FIGURES / "12_study.png", dpi=150)
