"""pykoop: force 10 ms ahead from ten delays, synthetic contact."""

import numpy as np
import pykoop
from works import DELAYS, HORIZON, contacts, print_result, timed


def main() -> None:
    training = np.vstack(
        [np.column_stack([np.full(2000, seed), contacts(seed)]) for seed in range(10)]
    )
    unseen = contacts(100)
    pipeline = pykoop.KoopmanPipeline(
        lifting_functions=[
            ("delays", pykoop.DelayLiftingFn(n_delays_state=DELAYS, n_delays_input=0))
        ],
        regressor=pykoop.Edmd(alpha=1e-8),
    )
    observables, packages = f"{6 * (DELAYS + 1)} observables", "pykoop numpy scipy scikit-learn"
    times = timed(lambda _: pipeline.fit(training, n_inputs=0, episode_feature=True), count=3)
    far, ticks = [], range(DELAYS + 1, len(unseen) - HORIZON, 7)

    def predict(index: int) -> None:
        tick = ticks[index]
        lifted = pipeline.lift(
            np.column_stack([np.zeros(DELAYS + 1), unseen[tick - DELAYS : tick + 1]]),
            episode_feature=True,
        )[-1, 1:]
        # in the lifted space, which costs less than its own predict_trajectory
        for _ in range(HORIZON):
            lifted = lifted @ pipeline.regressor_.coef_
        far.append(lifted[5] - unseen[tick + HORIZON, 5])

    each = timed(predict, count=250)
    error = float(np.sqrt(np.mean(np.square(far))))
    print_result(
        "pykoop",
        "fit a predictor",
        f"{len(training)} samples, {observables}",
        times,
        packages,
        value=error,
        unit="N, RMS error 10 ms ahead",
    )
    print_result(
        "pykoop",
        "predict 10 ms ahead",
        observables,
        each,
        packages,
        value=error,
        unit="N, RMS error 10 ms ahead",
    )


if __name__ == "__main__":
    main()
