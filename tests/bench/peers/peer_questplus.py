"""questplus: a trial on 50 stimuli and 2,400 parameters. It is under the GPL: for comparison
only.
"""

import numpy as np
from questplus import QuestPlus
from works import print_result, right_share, steps_N, timed


def main() -> None:
    rng, steps = np.random.default_rng(0), steps_N()
    asked = QuestPlus(
        stim_domain={"intensity": np.log10(steps)},
        param_domain={
            "threshold": np.log10(1.2 * np.geomspace(0.015, 0.6, 60)),
            "slope": np.linspace(1.0, 5.0, 8),
            "lower_asymptote": np.array([0.5]),
            "lapse_rate": np.linspace(0.0, 0.2, 5),
        },
        outcome_domain={"response": ["Yes", "No"]},
        func="weibull",
        stim_scale="log10",
        stim_selection_method="min_entropy",
        param_estimation_method="mean",
    )

    def trial(_: int) -> None:
        stimulus = asked.next_stim
        right = rng.random() < right_share(10.0 ** stimulus["intensity"])
        asked.update(stim=stimulus, outcome={"response": "Yes" if right else "No"})

    times = timed(trial, count=60, warm_up=10)
    threshold = 10.0 ** asked.param_estimate["threshold"]
    print_result(
        "questplus",
        "trial of a threshold",
        "50 x 2400",
        times,
        "questplus numpy xarray",
        value=float(threshold),
        unit="N, threshold after 70 trials (another slope model)",
    )


if __name__ == "__main__":
    main()
