"""
A small study
=============

This example tests whether predicting the force hides the latency of a contact with a wall.

Expected over two trials of each group:

- Without prediction, the played force is 5 % off the force without latency.
- Prediction by a Koopman operator leaves less than 0.85 of that error, and removes more than two of
  six milliseconds of lag.
- A trial that runs alone gives the same numbers to the last bit.

The people are simulated.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import tissue

FIGURES = Path("figures")
PLAN = tissue.study.Plan(trials=2, tasks=("T2",), methods=("penalty", "koopman"), sensitivity=False)

# %%
# The trials run on two worker processes, which import this script. The code that starts them is
# therefore under the main guard.

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
# Run a single trial by its name, to look at one trial of a study.

if __name__ == "__main__":
    alone = tissue.study.trial(PLAN, "T2-expert-0001").rows[1]
    inside = table.where(group="expert", method="koopman").values("force_error")[1]
    assert alone["force_error"] == inside
    print(f"trial T2-expert-0001 alone: the same {100 * inside:.3f} %")

# %%
# Plot each trial under both methods as a line.

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
