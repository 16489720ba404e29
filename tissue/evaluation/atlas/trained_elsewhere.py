"""An operator that was trained on one wall and is used on another: what it predicts, and what the guard makes of it."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from matplotlib.figure import Figure

from tissue.builders.prediction import predictor
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, error_of, refused, shown, sweep
from tissue.evaluation.atlas.tapping import LIMIT_N, TICK_S, koopman, relative_error, tapped, trained
from tissue.evaluation.training.evaluation import forecast
from tissue.prediction.edmd.predictor_file import read_predictor, write_predictor
from tissue.prediction.guard import Guarded
from tissue.prediction.predictor import Hold, Predictor

__all__ = ["PAGE"]

HOME_N_M, HORIZON_TICKS = 800.0, 5
"""Stiffness of the wall that was learnt from, and ticks ahead."""


def measure(quick: bool) -> Data:
    """Errors of hold, the bare operator and the guarded one over the stiffness of the wall they are used on."""
    operator = trained([tapped(HOME_N_M, seed=seed, seconds=3.0) for seed in (1, 2)])
    stiffnesses = np.array(
        [100.0, 400.0, 800.0, 2400.0] if quick else [100, 150, 200, 300, 400, 600, 800, 1100, 1600, 2400], dtype=float
    )

    def errors(stiffness: float) -> dict[str, float]:
        """Errors on one wall, and how often the guarded operator is trusted."""
        recording = tapped(stiffness, seed=9, seconds=1.2 if quick else 2.0)
        guarded = Guarded(koopman(operator), Hold(), reach_N=LIMIT_N)
        predictors: dict[str, Predictor] = {"hold": Hold(), "bare": koopman(operator), "guarded": guarded}
        found = {}
        for name, each in predictors.items():
            predictions, is_primary = forecast(each, recording, [HORIZON_TICKS])
            found[name] = relative_error(predictions[:, 0], recording.force_N, HORIZON_TICKS)
        return found | {"own_share": is_primary.mean()}

    table = sweep("stiffness_N_m", stiffnesses, errors)
    # The operator moves the force towards that of its own wall; by how much in five ticks is read off the softest.
    share = table["bare"][0] / abs(HOME_N_M / stiffnesses[0] - 1.0)
    return {"wall": table | {"theory": share * np.abs(HOME_N_M / stiffnesses - 1.0)}}


def judge(data: Data) -> Verdict:
    """How wrong the bare operator is away from home, and the guarded one beside what it falls back on."""
    table = data["wall"]
    ratio = table["guarded"] / table["hold"]
    home = int(np.argmin(np.abs(table["stiffness_N_m"] - HOME_N_M)))
    far = np.abs(np.log2(table["stiffness_N_m"] / HOME_N_M)) > 0.9
    worst = float((table["bare"] / table["hold"]).max())
    return Verdict(
        worst > 5.0 and error_of(table["bare"][far], table["theory"][far]) < 0.6,
        bool((ratio < 1.5).all() and ratio[home] < 0.8 and table["own_share"][home] > 0.8),
        f"Five ticks ahead the operator is off by {100 * table['bare'][home]:.1f} % on its own wall, where hold is by "
        f"{100 * table['hold'][home]:.1f} %, and up to {worst:.0f} times as much as hold on others, as |K₀/K − 1| "
        f"predicts. Guarded it predicts itself {100 * table['own_share'][home]:.0f} % of the time at home and "
        f"{100 * table['own_share'][far].max():.0f} % at most on walls twice as stiff or soft (in free air all walls "
        f"are one), and never more than {ratio.max():.2f} times off as hold.",
    )


def ask() -> list[Answer]:
    """Predictor files of other scenes, damaged ones, and the guard's share on another wall."""
    operator = trained([tapped(HOME_N_M, seed=1, seconds=2.0)])
    with TemporaryDirectory() as folder:
        path = write_predictor(Path(folder) / "wall.npz", {"force": operator}, scene="wall", header={})
        other = refused(
            "the Koopman predictor of another scene",
            lambda: predictor("koopman", scene_name="molar", file=str(path), force_limit_N=LIMIT_N, tick_s=TICK_S),
        )
        path.write_bytes(path.read_bytes()[:200])
        files = [other, refused("a file that was cut off", lambda: read_predictor(path))]
    guarded = Guarded(koopman(operator), Hold(), reach_N=LIMIT_N)
    recording = tapped(4.0 * HOME_N_M, seed=9, seconds=1.0)
    forces, is_primary = forecast(guarded, recording, [HORIZON_TICKS])
    steps = np.abs(np.diff(np.linalg.norm(forces[:, 0], axis=1))).max()
    return [
        *(replace(each, result=each.result.replace(f"{folder}/", "")) for each in files),
        shown("a wall four times as stiff", bool(np.isfinite(forces).all()) and float(is_primary[200:].min()) == 0.0,
              f"hands over to hold; no tick changes the force by more than {steps:.2f} N", conduct=Conduct.FALLS_BACK),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Error, and share of own predictions, over the stiffness of the other wall."""
    left, right = chart.subplots(1, 2)
    table, label = data["wall"], "stiffness of the wall it is used on / (N/m)"
    stiffness = table["stiffness_N_m"]
    trusted = stiffness[table["own_share"] > 0.75]
    low, high = 0.8 * trusted.min(initial=HOME_N_M), 1.25 * trusted.max(initial=HOME_N_M)
    conduct = [
        (Conduct.FALLS_BACK, stiffness[0], low),
        (Conduct.HOLDS, low, high),
        (Conduct.FALLS_BACK, high, stiffness[-1]),
    ]
    panel(left, stiffness, label, "force error 5 ms ahead / %", [
        ("theory: ∝ |K₀/K − 1|", np.maximum(100.0 * table["theory"], 0.1), "-", GREY),
        ("operator, not guarded", 100.0 * table["bare"], "s", RED),
        ("hold", 100.0 * table["hold"], "^", ORANGE),
        ("guarded (ours)", 100.0 * table["guarded"], "o", BLUE),
    ], conduct=conduct, ylim=(1.0, 500.0))  # fmt: skip
    right.axvline(HOME_N_M, color=GREY, linestyle=":", label="trained here")
    panel(right, stiffness, label, "share of ticks / %", [
        ("guarded: its own prediction", 100.0 * table["own_share"], "o", BLUE),
    ], log="x", conduct=conduct, ylim=(0.0, 105.0), legend="lower center")  # fmt: skip


PAGE = Page(
    "trained_elsewhere",
    "Operators trained elsewhere",
    "A predictor has learnt a wall of 800 N/m and is used on walls an eighth to three times as stiff. What force does "
    "it predict five milliseconds ahead?",
    "Guard by one-step residual and training range, falls back to hold",
    measure,
    judge,
    ask,
    draw,
)
