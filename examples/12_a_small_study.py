"""A small study: does predicting the force hide the latency of a contact with a wall?

Expected: over two trials of each group the force that is played lies 5 % off the prompt one without prediction.
Prediction by a Koopman operator leaves less than 0.85 of that error and takes more than two of six milliseconds off
the lag. A trial that is run alone gives the same numbers to the last bit. People are simulated.
Run: python examples/12_a_small_study.py
"""

import tempfile
from pathlib import Path

from tissue.evaluation.study.plan import Plan, TrialKey
from tissue.evaluation.study.runner import run_study
from tissue.evaluation.study.trial import run_trial

PLAN = Plan(trials=2, tasks=("T2",), methods=("penalty", "koopman"), sensitivity=False)


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        table = run_study(PLAN, Path(folder) / "study", workers=2).table("T2")
    means = {
        method: {metric: table.where(method=method).values(metric).mean() for metric in ("force_error", "latency_ms")}
        for method in PLAN.methods
    }
    for method, figures in means.items():
        print(f"{method}: force error {100 * figures['force_error']:.1f} %, {figures['latency_ms']:.1f} ms late")
    plain, predicted = means["penalty"], means["koopman"]
    assert 0.02 < plain["force_error"] < 0.1 and predicted["force_error"] < 0.85 * plain["force_error"]
    assert plain["latency_ms"] - predicted["latency_ms"] > 2.0
    alone = run_trial(PLAN, TrialKey.named("T2-expert-0001")).rows[1]
    inside = table.where(group="expert", method="koopman").values("force_error")[1]
    assert alone["force_error"] == inside
    print(f"trial T2-expert-0001 alone: the same {100 * inside:.3f} %")


if __name__ == "__main__":
    main()
