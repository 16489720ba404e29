"""Operators trained on one wall and used on another: on positions and forces, and on
displacements and stretches.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.hands import SIX_DOF, TICK_S, TURN, koopman, relative_error, tapped
from tissue.evaluation.atlas.page import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    error_of,
    panel,
    refused,
    shown,
    sweep,
)
from tissue.evaluation.training.recording import Recording
from tissue.evaluation.training.train import fit, forecast
from tissue.prediction.edmd import Edmd, Episode, window
from tissue.prediction.guard import Guarded
from tissue.prediction.operator import Delays, GapProducts
from tissue.prediction.predictor import Hold, Predictor
from tissue.prediction.trained import Trained
from tissue.simulation.builders.prediction import maker_of

__all__ = ["PAGE"]

HOME_N_M = 800.0
"""Stiffness of the wall of the training runs."""
HORIZON_TICKS = 5
LAGS = 6
"""Delays of the operator on positions and forces."""


def recordings(seconds: float) -> list[Recording]:
    """Record three training runs."""
    return [tapped(HOME_N_M, seed=seed, seconds=seconds) for seed in (1, 2, 3)]


def guarded(trained: Trained) -> Guarded:
    """Return the predictor of the engine."""
    return Guarded(koopman(trained), Hold(), reach_N=SIX_DOF.force_limit_N)


def bound_force_N(learnt: list[Recording], recording: Recording) -> Array:
    """Predict forces by an operator on positions and forces, shape (n, 3).

    The overlap of the wall is among the observables of the operator. The result is zero until the
    delays are full.
    """
    states = [np.hstack((each.position_m, each.force_N)) for each in (*learnt, recording)]
    nx, ny, nz = TURN[:, 2].tolist()
    episodes = [Episode(each, None, TICK_S) for each in states[:-1]]
    operator = Edmd(Delays(LAGS, GapProducts((nx, ny, nz))), ridge=1e-9).fit(episodes)
    matrix, offset = operator.predicted_states(HORIZON_TICKS)[-1]
    force = np.zeros_like(recording.force_N)
    force[LAGS:] = operator.dictionary.lift(window(states[-1], LAGS)) @ matrix[3:].T + offset[3:]
    return force


def measure(quick: bool) -> Data:
    """Sweep the stiffness of the wall that the operators are used on."""
    learnt = recordings(3.0)
    trained = fit("wall", learnt)
    stiffnesses = np.array(
        [100.0, 150.0, 200.0, 300.0, 400.0, 600.0, 800.0, 1100.0, 1600.0, 2400.0]
    )
    if quick:
        stiffnesses = np.array([100.0, 400.0, 800.0, 2400.0])

    def errors(stiffness: float) -> dict[str, float]:
        """Measure the errors on one wall, and how often the guarded operator is trusted."""
        recording = tapped(stiffness, seed=9, seconds=1.2 if quick else 2.0)
        force = recording.force_N
        predictors: dict[str, Predictor] = {"hold": Hold(), "guarded": guarded(trained)}
        found = {"bare": relative_error(bound_force_N(learnt, recording), force, HORIZON_TICKS)}
        for name, each in predictors.items():
            predictions, is_primary = forecast(each, recording, [HORIZON_TICKS])
            found[name] = relative_error(predictions[:, 0], force, HORIZON_TICKS)
        return found | {"own_share": is_primary.mean()}

    table = sweep("stiffness_N_m", stiffnesses, errors)
    # The operator moves the force towards that of its own wall. The softest wall gives the share of
    # five ticks.
    share = table["bare"][0] / abs(HOME_N_M / stiffnesses[0] - 1.0)
    return {"wall": table | {"theory": share * np.abs(HOME_N_M / stiffnesses - 1.0)}}


def judge(data: Data) -> Verdict:
    """Compare both operators with zero-order hold."""
    table = data["wall"]
    ratio = table["guarded"] / table["hold"]
    home = int(np.argmin(np.abs(table["stiffness_N_m"] - HOME_N_M)))
    far = np.abs(np.log2(table["stiffness_N_m"] / HOME_N_M)) > 0.9
    worst = float((table["bare"] / table["hold"]).max())
    return Verdict(
        worst > 5.0 and error_of(table["bare"][far], table["theory"][far]) < 0.6,
        bool((ratio < 1.0).all() and ratio[home] < 0.8 and (table["own_share"] > 0.8).all()),
        "Five ticks ahead the error of an operator on positions and forces is "
        f"{100 * table['bare'][home]:.1f} % on "
        f"its own wall, where zero-order hold has {100 * table['hold'][home]:.1f} %. On "
        "other walls it is up to "
        f"{worst:.0f} times that of hold, as |K₀/K − 1| predicts. The operator on "
        "displacements and stretches of the "
        f"coupling is trusted in at least {100 * table['own_share'].min():.0f} % of the "
        "ticks, and its error is "
        f"{ratio.min():.2f} to {ratio.max():.2f} times that of hold on all walls.",
    )


def ask() -> list[Answer]:
    """Give the engine foreign and damaged predictor files, and a motion outside the training range.

    A foreign file was trained on another scene.
    """
    trained = fit("wall", recordings(2.0))
    with TemporaryDirectory() as folder:
        path = trained.write(Path(folder) / "wall.npz")
        other = refused(
            "the Koopman predictor of another scene",
            lambda: maker_of(
                "koopman", scene_name="molar", file=str(path), force_limit_N=SIX_DOF.force_limit_N
            )(),
        )
        path.write_bytes(path.read_bytes()[:200])
        files = [other, refused("a truncated file", lambda: Trained.read(path))]
    recording = tapped(HOME_N_M, seed=9, seconds=1.0)
    wild = replace(
        recording, position_m=recording.position_m + np.cumsum(np.full((1000, 3), 1e-2), axis=0)
    )
    forces, is_primary = forecast(guarded(trained), wild, [HORIZON_TICKS])
    steps = np.abs(np.diff(np.linalg.norm(forces[:, 0], axis=1))).max()
    falls_back = bool(np.isfinite(forces).all()) and float(is_primary[200:].min()) == 0.0
    return [
        *(replace(each, result=each.result.replace(f"{folder}/", "")) for each in files),
        shown(
            "a device that moves at 17 m/s",
            falls_back,
            f"falls back to zero-order hold; no tick changes the force by more than {steps:.2f} N",
            conduct=Conduct.FALLS_BACK,
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw the error, and the share of trusted predictions, over the stiffness of the wall."""
    left, right = chart.subplots(1, 2)
    table = data["wall"]
    label = "stiffness of the wall / (N/m)"
    stiffness = table["stiffness_N_m"]
    panel(
        left,
        stiffness,
        (label, "force error 5 ms ahead / %"),
        [
            ("theory: ∝ |K₀/K − 1|", np.maximum(100.0 * table["theory"], 0.1), "-", GREY),
            ("operator on positions and forces", 100.0 * table["bare"], "s", RED),
            ("zero-order hold", 100.0 * table["hold"], "^", ORANGE),
            ("on displacements and stretches (engine)", 100.0 * table["guarded"], "o", BLUE),
        ],
        ylim=(1.0, 500.0),
    )
    right.axvline(HOME_N_M, color=GREY, linestyle=":", label="trained here")
    panel(
        right,
        stiffness,
        (label, "share of ticks / %"),
        [
            ("own prediction trusted (engine)", 100.0 * table["own_share"], "o", BLUE),
        ],
        log="x",
        ylim=(0.0, 105.0),
        legend="lower center",
    )


PAGE = Page(
    "trained_elsewhere",
    "Operators trained elsewhere",
    "A predictor is trained on a wall of 800 N/m and used on walls an eighth to three times "
    "as stiff. Which error does "
    "its force have five milliseconds ahead?",
    (
        "Displacements over the coupling's stiffness; guard by training range and recent errors, "
        "falls back to hold"
    ),
    measure,
    judge,
    ask,
    draw,
)
