"""Operators that were trained on one wall and are used on another: one bound to its newtons, and one that is not."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.builders.prediction import maker_of
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, error_of, refused, shown, sweep
from tissue.evaluation.atlas.tapping import LIMIT_N, TICK_S, TURN, koopman, relative_error, tapped
from tissue.evaluation.training.evaluation import forecast
from tissue.evaluation.training.fitting import fit
from tissue.evaluation.training.recording import Recording
from tissue.prediction.edmd.dictionary import Delays
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode, window
from tissue.prediction.edmd.gap_products import GapProducts
from tissue.prediction.edmd.predictor_file import read_predictor
from tissue.prediction.guard import Guarded
from tissue.prediction.predictor import Hold, Predictor

__all__ = ["PAGE"]

HOME_N_M, HORIZON_TICKS = 800.0, 5
"""Stiffness of the wall that was learnt from, and ticks ahead."""
LAGS = 6
"""Delays of the operator that is bound to its wall."""


def bound_force_N(learnt: list[Recording], recording: Recording) -> Array:
    """Force `HORIZON_TICKS` ahead by an operator on places and newtons, the wall's overlap among its observables.

    Shape (n, 3); zero until its delays are full.
    """
    states = [np.hstack((each.position_m, each.force_N)) for each in (*learnt, recording)]
    nx, ny, nz = TURN[:, 2].tolist()
    operator = Edmd(Delays(LAGS, GapProducts((nx, ny, nz))), ridge=1e-9).fit(
        [Episode(s, None, TICK_S) for s in states[:-1]]
    )
    matrix, offset = operator.predicted_states(HORIZON_TICKS)[-1]
    force = np.zeros_like(recording.force_N)
    force[LAGS:] = operator.dictionary.lift(window(states[-1], LAGS)) @ matrix[3:].T + offset[3:]
    return force


def measure(quick: bool) -> Data:
    """Errors of hold and both operators over the stiffness of the wall they are used on."""
    learnt = [tapped(HOME_N_M, seed=seed, seconds=3.0) for seed in (1, 2, 3)]
    trained = fit("wall", learnt)
    stiffnesses = np.array(
        [100.0, 400.0, 800.0, 2400.0] if quick else [100, 150, 200, 300, 400, 600, 800, 1100, 1600, 2400], dtype=float
    )

    def errors(stiffness: float) -> dict[str, float]:
        """Errors on one wall, and how often the guarded operator is trusted."""
        recording = tapped(stiffness, seed=9, seconds=1.2 if quick else 2.0)
        guarded = Guarded(koopman(trained), Hold(), reach_N=LIMIT_N)
        predictors: dict[str, Predictor] = {"hold": Hold(), "guarded": guarded}
        found = {"bare": relative_error(bound_force_N(learnt, recording), recording.force_N, HORIZON_TICKS)}
        for name, each in predictors.items():
            predictions, is_primary = forecast(each, recording, [HORIZON_TICKS])
            found[name] = relative_error(predictions[:, 0], recording.force_N, HORIZON_TICKS)
        return found | {"own_share": is_primary.mean()}

    table = sweep("stiffness_N_m", stiffnesses, errors)
    # The operator moves the force towards that of its own wall; by how much in five ticks is read off the softest.
    share = table["bare"][0] / abs(HOME_N_M / stiffnesses[0] - 1.0)
    return {"wall": table | {"theory": share * np.abs(HOME_N_M / stiffnesses - 1.0)}}


def judge(data: Data) -> Verdict:
    """How wrong the bound operator is away from home, and ours beside holding the last force."""
    table = data["wall"]
    ratio = table["guarded"] / table["hold"]
    home = int(np.argmin(np.abs(table["stiffness_N_m"] - HOME_N_M)))
    far = np.abs(np.log2(table["stiffness_N_m"] / HOME_N_M)) > 0.9
    worst = float((table["bare"] / table["hold"]).max())
    return Verdict(
        worst > 5.0 and error_of(table["bare"][far], table["theory"][far]) < 0.6,
        bool((ratio < 1.0).all() and ratio[home] < 0.8 and (table["own_share"] > 0.8).all()),
        f"Five ticks ahead an operator on places and newtons is off by {100 * table['bare'][home]:.1f} % on its own "
        f"wall, where hold is by {100 * table['hold'][home]:.1f} %, and up to {worst:.0f} times as much as hold on "
        f"others, as |K₀/K − 1| predicts. The one on displacements and stretches of the coupling is trusted "
        f"{100 * table['own_share'].min():.0f} % of the time or more and off by {ratio.min():.2f} to "
        f"{ratio.max():.2f} times as much as hold on all of them.",
    )


def ask() -> list[Answer]:
    """Predictor files of other scenes, damaged ones, and a motion that was never learnt."""
    trained = fit("wall", [tapped(HOME_N_M, seed=seed, seconds=2.0) for seed in (1, 2, 3)])
    with TemporaryDirectory() as folder:
        path = trained.write(Path(folder) / "wall.npz")
        other = refused(
            "the Koopman predictor of another scene",
            lambda: maker_of("koopman", scene_name="molar", file=str(path), force_limit_N=LIMIT_N)(),
        )
        path.write_bytes(path.read_bytes()[:200])
        files = [other, refused("a file that was cut off", lambda: read_predictor(path))]
    guarded = Guarded(koopman(trained), Hold(), reach_N=LIMIT_N)
    recording = tapped(HOME_N_M, seed=9, seconds=1.0)
    wild = replace(recording, position_m=recording.position_m + np.cumsum(np.full((1000, 3), 1e-2), axis=0))
    forces, is_primary = forecast(guarded, wild, [HORIZON_TICKS])
    steps = np.abs(np.diff(np.linalg.norm(forces[:, 0], axis=1))).max()
    return [
        *(replace(each, result=each.result.replace(f"{folder}/", "")) for each in files),
        shown("a device that moves at 17 m/s", bool(np.isfinite(forces).all()) and float(is_primary[200:].min()) == 0.0,
              f"hands over to hold; no tick changes the force by more than {steps:.2f} N", conduct=Conduct.FALLS_BACK),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Error, and share of own predictions, over the stiffness of the other wall."""
    left, right = chart.subplots(1, 2)
    table, label = data["wall"], "stiffness of the wall it is used on / (N/m)"
    stiffness = table["stiffness_N_m"]
    conduct = [(Conduct.HOLDS, stiffness[0], stiffness[-1])]
    panel(left, stiffness, label, "force error 5 ms ahead / %", [
        ("theory: ∝ |K₀/K − 1|", np.maximum(100.0 * table["theory"], 0.1), "-", GREY),
        ("operator on places and newtons", 100.0 * table["bare"], "s", RED),
        ("hold", 100.0 * table["hold"], "^", ORANGE),
        ("on displacements and stretches (ours)", 100.0 * table["guarded"], "o", BLUE),
    ], conduct=conduct, ylim=(1.0, 500.0))  # fmt: skip
    right.axvline(HOME_N_M, color=GREY, linestyle=":", label="trained here")
    panel(right, stiffness, label, "share of ticks / %", [
        ("ours: its own prediction", 100.0 * table["own_share"], "o", BLUE),
    ], log="x", conduct=conduct, ylim=(0.0, 105.0), legend="lower center")  # fmt: skip


PAGE = Page(
    "trained_elsewhere",
    "Operators trained elsewhere",
    "A predictor has learnt a wall of 800 N/m and is used on walls an eighth to three times as stiff. What force does "
    "it predict five milliseconds ahead?",
    "Displacements over the coupling's stiffness; guard by training range and lately missed force, falls back to hold",
    measure,
    judge,
    ask,
    draw,
)
