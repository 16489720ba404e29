"""Atlas pages on force prediction: horizon, and walls of untrained stiffness."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.page import (
    ENGINE,
    FAILING,
    GREEN,
    GREY,
    ORANGE,
    THEORY,
    Conduct,
    Data,
    Page,
    Verdict,
    error_of,
    panel,
    sweep,
)
from tissue.evaluation.recorded_runs import Recording
from tissue.evaluation.training import fit, forecast
from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters, waypoints
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import press_wall
from tissue.models.tissue_model import TICK_S
from tissue.prediction.delays import DelayPath
from tissue.prediction.guard import Guarded
from tissue.prediction.koopman import Koopman
from tissue.prediction.predictor import Contact, Hold, Kalman, Linear, Predictor
from tissue.prediction.trained import Trained
from tissue.scene.registry import PREDICTORS

SIX_DOF = device_parameters("six-dof")
HOME_N_M = 800.0
"""Stiffness of the wall in the training runs [N/m]."""
TURN = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [-2.0, -1.0, 2.0]]) / 3.0
"""Rotation matrix from the frame of the wall to the world frame.

The wall is oblique, so that all three components of position and force vary.
"""
AHEAD = np.array([1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64])
LABELS = {
    "hold": "zero-order hold",
    "linear": "straight line",
    "kalman": "Kalman, constant acceleration",
    "koopman": "Koopman, guarded (engine)",
}
LEADS_MS = 10.0
"""Largest horizon [ms] at which the haptic loop needs a predicted force.

Delay and filter of the haptic loop together take several milliseconds.
"""
HORIZON_TICKS = 5
"""Prediction horizon [ticks] at which two linear operators are compared: half of `LEADS_MS`."""
LAGS = 6
"""Number of past ticks whose positions the regression uses, in addition to the present tick."""


def tapped(stiffness_N_m: float, *, seed: int, seconds: float) -> Recording:
    """Record positions, velocities and forces of a device while a simulated novice taps a wall."""
    rng = np.random.default_rng(seed)
    # a tap every 0.7 s, 2 to 8 mm deep, with a drift of 2 mm along the wall at two frequencies, so
    # that no tap repeats another. The path lasts 2 s longer than the run
    times = np.arange(0.0, seconds + 2.0, 0.35)
    depths = np.where(np.arange(len(times)) % 2, -rng.uniform(2e-3, 8e-3, len(times)), 4e-3)
    points = np.column_stack([2e-3 * np.sin(times), 2e-3 * np.cos(1.3 * times), depths])
    hand = Hand(hand_parameters("novice"), waypoints(times, points), rng=rng)
    # at the first waypoint, 4 mm above the wall
    simulated = SimulatedDevice(SIX_DOF, hand, position_m=(0.0, 0.0, 4e-3))
    wall = renderer("penalty", SIX_DOF.loop(stiffness_N_m))
    run = press_wall(simulated, wall, duration_s=seconds)
    position = run.position_m @ TURN.T
    force = run.force_N @ TURN.T
    seen = [
        Contact(stiffness_N_m, p + f / stiffness_N_m, f)
        for p, f in zip(position, force, strict=True)
    ]
    velocity = np.gradient(position, TICK_S, axis=0)
    return Recording(position, velocity, force, seen, "novice", seed)


def recordings() -> list[Recording]:
    """Record three training runs in which a novice taps a wall of stiffness `HOME_N_M`."""
    # other seeds than the recordings of the tests, whose seed is 9
    return [tapped(HOME_N_M, seed=seed, seconds=3.0) for seed in (1, 2, 3)]


def guarded(trained: Trained) -> Guarded:
    """Return the trained Koopman predictor with a guard that can fall back to zero-order hold."""
    koopman = Koopman(DelayPath(trained.operator))
    return Guarded(koopman, Hold(), reach_N=SIX_DOF.force_limit_N)


def relative_error(predictions: Array, force: Array, horizon: int) -> float:
    """Return the norm of the prediction error divided by the norm of the force, limited to 1e6.

    `predictions` and `force` have shape (n, 3). The prediction in row i is for the force in row i +
    `horizon`. Predictions of the first 100 ticks are ignored.
    """
    # in the first 0.1 s the operator's delays of up to 80 ticks fill up
    later = force[100 + horizon :]
    predicted = predictions[100 : len(predictions) - horizon]
    error = np.linalg.norm(predicted - later) / np.linalg.norm(later)
    # a force that diverges must not hide the other curves of a chart
    return min(float(np.nan_to_num(error, nan=1e6, posinf=1e6)), 1e6)


class Horizon(Page):
    """Error of every force predictor against the prediction horizon."""

    name = "horizon"
    title = "Prediction horizon: how far ahead can a force be predicted?"
    question = (
        "A novice taps a wall of 800 N/m. How large is the error of forces predicted 1 to 64 ms "
        "ahead, and from which horizon on is zero-order hold better?"
    )
    source = "Trained on three recordings, tested on a fourth; device with six degrees of freedom"

    def measure(self) -> Data:
        """Vary the horizon on a recording that was not used for training."""
        # none of the seeds of `recordings`
        recording = tapped(HOME_N_M, seed=9, seconds=4.0)
        force = recording.force_N
        table = {"ahead_ms": 1e3 * TICK_S * AHEAD}
        predictors: dict[str, Predictor] = {
            "hold": Hold(),
            "linear": Linear(),
            "kalman": Kalman(),
            "koopman": guarded(fit("wall", recordings())),
        }
        for name, each in predictors.items():
            forces, _ = forecast(each, recording, AHEAD.tolist())
            table[name] = np.array(
                [relative_error(forces[:, row], force, steps) for row, steps in enumerate(AHEAD)]
            )
        # For short horizons the error of a held force is the rate of the force times the horizon.
        # The rate is taken over 4 ms: over 1 ms it is mostly encoder steps.
        rate = (force[104:] - force[100:-4]) / 4.0
        table["theory_hold"] = AHEAD * np.linalg.norm(rate) / np.linalg.norm(force[100:])
        return {"horizon": table}

    def judge(self, data: Data) -> Verdict:
        """Find the horizon at which each predictor becomes worse than zero-order hold.

        The page also checks that the Koopman predictor is useless at the longest horizon: its
        relative error exceeds 0.25. For the longest horizon, 64 ms, the measured error is 0.38.
        """
        table = data["horizon"]
        horizon = table["ahead_ms"]
        hold = table["hold"]
        ends = {}
        for name in ("linear", "kalman", "koopman"):
            worse = horizon[table[name] > hold]
            ends[name] = f"beyond {worse.min():.0f} ms" if len(worse) else "nowhere"
        within = horizon <= LEADS_MS
        gain = (table["koopman"] / hold)[within].max()
        at = {name: 100.0 * table[name][horizon == 8.0][0] for name in LABELS}
        return Verdict(
            # measured at 64 ms: error of the filter 1.8 and of the hold 0.45 times the force; up to
            # 10 ms, the error of the Koopman predictor is at most 0.82 times that of the hold
            table["kalman"][-1] > 2.0 * hold[-1] and (table["koopman"][-1] > 0.25),
            gain < 1.0 and (table["koopman"] < 1.1 * hold).all(),
            f"At 8 ms the error is {at['hold']:.1f} % of the force by zero-order hold, "
            f"{at['linear']:.1f} % by the straight line, {at['kalman']:.1f} % by the Kalman filter "
            f"and {at['koopman']:.1f} % by the Koopman predictor. Worse than hold: the line "
            f"{ends['linear']}, the filter {ends['kalman']}, Koopman {ends['koopman']}. At "
            f"{horizon[-1]:.0f} ms no predictor is useful: the Koopman error is "
            f"{100 * table['koopman'][-1]:.0f} %. Up to {LEADS_MS:g} ms it is below {gain:.2f} of "
            "hold.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the error of each predictor against the horizon."""
        table = data["horizon"]
        horizon_ms = table["ahead_ms"]
        curves = [
            (label, 100.0 * table[name], (PREDICTORS[name].marker, PREDICTORS[name].colour))
            for name, label in LABELS.items()
        ]
        panel(
            chart.subplots(),
            horizon_ms,
            ("horizon / ms", "force error / %"),
            [
                *curves,
                ("theory of hold: rate × horizon", 100.0 * table["theory_hold"], THEORY),
                ("error of no force at all", 100.0, (":", GREEN)),
            ],
            conduct=[(Conduct.HOLDS, horizon_ms[0], LEADS_MS)],
            # from the error at 1 ms to above that of the diverging filter
            ylim=(0.5, 400.0),
            legend="upper left",
        )


def bound_force_N(learnt: list[Recording], recording: Recording) -> Array:
    """Predict the forces [N] in a recording, shape (n, 3), by a regression on positions.

    The regression is fitted to the recordings in `learnt`. The regressors are the positions and
    penetration depths of the present tick and of the `LAGS` ticks before it. The predicted force is
    zero in the first `LAGS` ticks.
    """

    def regressors(run: Recording) -> Array:
        """Return positions and penetration depths at all delays, and a column of ones."""
        overlap = np.maximum(0.0, -run.position_m @ TURN[:, 2:])
        states = np.hstack((run.position_m, overlap))
        count = len(states) - LAGS
        delayed = [states[LAGS - lag : LAGS - lag + count] for lag in range(LAGS + 1)]
        return np.column_stack((*delayed, np.ones(count)))

    rows = np.concatenate([regressors(each)[:-HORIZON_TICKS] for each in learnt])
    targets = np.concatenate([each.force_N[LAGS + HORIZON_TICKS :] for each in learnt])
    weights, *_ = np.linalg.lstsq(rows, targets)
    force = np.zeros_like(recording.force_N)
    force[LAGS:] = regressors(recording) @ weights
    return force


class TrainedElsewhere(Page):
    """Errors of two linear predictors that are trained on one wall and used on other walls.

    The first predictor is a regression on positions. The second is the simulation's own predictor;
    it uses displacements of the device and of the coupling spring.
    """

    name = "trained_elsewhere"
    title = "Operators trained elsewhere"
    question = (
        "A predictor is trained on a wall of 800 N/m and used on walls an eighth to three times as "
        "stiff. Which error does its force have five milliseconds ahead?"
    )
    source = (
        "Displacements over the coupling's stiffness; guard by training range and recent errors, "
        "falls back to hold"
    )

    def measure(self) -> Data:
        """Vary the stiffness of the wall on which both predictors are used."""
        learnt = recordings()
        trained = fit("wall", learnt)
        # an eighth to three times the stiffness of the training runs
        stiffnesses = np.array([100, 150, 200, 300, 400, 600, 800, 1100, 1600, 2400], dtype=float)

        def errors(stiffness: float) -> dict[str, float]:
            """Measure the errors on one wall, and how often the guarded operator is trusted."""
            # none of the seeds of `recordings`
            recording = tapped(stiffness, seed=9, seconds=2.0)
            force = recording.force_N
            predictors: dict[str, Predictor] = {"hold": Hold(), "guarded": guarded(trained)}
            found = {"bare": relative_error(bound_force_N(learnt, recording), force, HORIZON_TICKS)}
            for name, each in predictors.items():
                predictions, is_primary = forecast(each, recording, [HORIZON_TICKS])
                found[name] = relative_error(predictions[:, 0], force, HORIZON_TICKS)
            return found | {"own_share": is_primary.mean()}

        table = sweep("stiffness_N_m", stiffnesses, errors)
        # The operator moves the force towards the force of the wall of its training. The softest
        # wall gives the share for five ticks.
        share = table["bare"][0] / abs(HOME_N_M / stiffnesses[0] - 1.0)
        return {"wall": table | {"theory": share * np.abs(HOME_N_M / stiffnesses - 1.0)}}

    def judge(self, data: Data) -> Verdict:
        """Compare the errors of both predictors with the error of zero-order hold."""
        table = data["wall"]
        ratio = table["guarded"] / table["hold"]
        home = int(np.argmin(np.abs(table["stiffness_N_m"] - HOME_N_M)))
        # about a factor of two from the wall of the training, where the error caused by the other
        # wall exceeds the operator's own error
        far = np.abs(np.log2(table["stiffness_N_m"] / HOME_N_M)) > 0.9
        worst = (table["bare"] / table["hold"]).max()
        return Verdict(
            # measured: worst 176; bare within 1 % of theory; ratio 0.31 to 0.81, on the own wall
            # 0.43; trusted in 90 % of the ticks. The bounds leave space for operators that are
            # trained anew
            worst > 5.0 and error_of(table["bare"][far], table["theory"][far]) < 0.6,
            (ratio < 1.0).all() and ratio[home] < 0.8 and (table["own_share"] > 0.8).all(),
            "Five ticks ahead the error of a regression on positions is "
            f"{100 * table['bare'][home]:.1f} % on its own wall, where zero-order hold has "
            f"{100 * table['hold'][home]:.1f} %. On other walls it is up to {worst:.0f} times that "
            "of hold, as |K₀/K − 1| predicts. The operator on displacements and stretches of the "
            f"coupling is trusted in at least {100 * table['own_share'].min():.0f} % of the ticks, "
            f"and its error is {ratio.min():.2f} to {ratio.max():.2f} times that of hold on all "
            "walls.",
        )

    def draw(self, data: Data, chart: Figure) -> None:
        """Draw the error of each predictor against the stiffness of the wall."""
        table = data["wall"]
        axes = chart.subplots()
        axes.axvline(HOME_N_M, color=GREY, linestyle=":", label="trained here")
        panel(
            axes,
            table["stiffness_N_m"],
            ("stiffness of the wall / (N/m)", "force error 5 ms ahead / %"),
            [
                # zero at the own wall, which a logarithmic axis cannot show
                ("theory: ∝ |K₀/K − 1|", np.maximum(100.0 * table["theory"], 0.1), THEORY),
                ("regression on positions", 100.0 * table["bare"], FAILING),
                ("zero-order hold", 100.0 * table["hold"], ("^", ORANGE)),
                ("on displacements and stretches (engine)", 100.0 * table["guarded"], ENGINE),
            ],
            ylim=(1.0, 500.0),
        )
