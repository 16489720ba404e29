"""Prediction horizon: error of every predictor against zero-order hold."""

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.hands import SIX_DOF, TICK_S, koopman, relative_error, tapped
from tissue.evaluation.atlas.page import (
    GREEN,
    GREY,
    Answer,
    Conduct,
    Data,
    Page,
    Verdict,
    panel,
    refused,
    shown,
)
from tissue.evaluation.training.train import fit, forecast
from tissue.prediction.guard import Guarded
from tissue.prediction.predictor import Contact, Hold, Kalman, Linear, Predictor
from tissue.scene.registry import PREDICTORS

__all__ = ["PAGE"]

STIFFNESS_N_M = 800.0
LABELS = {
    "hold": "zero-order hold",
    "linear": "straight line",
    "kalman": "Kalman, constant acceleration",
    "koopman": "Koopman, guarded (engine)",
}
LEADS_MS = 10.0
"""Horizon up to which the loop predicts [ms]. Its delay and filter take some milliseconds."""


def predictors() -> dict[str, Predictor]:
    """Return all predictors, the Koopman one trained on three other recordings of the same wall."""
    trained = fit("wall", [tapped(STIFFNESS_N_M, seed=seed, seconds=3.0) for seed in (1, 2, 3)])
    guarded = Guarded(koopman(trained), Hold(), reach_N=SIX_DOF.force_limit_N)
    return {"hold": Hold(), "linear": Linear(), "kalman": Kalman(), "koopman": guarded}


def measure(quick: bool) -> Data:
    """Sweep the horizon on a recording that no predictor was trained on."""
    horizons = [1, 4, 8, 64] if quick else [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64]
    recording = tapped(STIFFNESS_N_M, seed=9, seconds=1.5 if quick else 4.0)
    force = recording.force_N
    table = {"ahead_ms": 1e3 * TICK_S * np.array(horizons, dtype=float)}
    for name, each in predictors().items():
        forces, _ = forecast(each, recording, horizons)
        table[name] = np.array(
            [relative_error(forces[:, row], force, steps) for row, steps in enumerate(horizons)]
        )
    # For short horizons the error of a held force is the rate of the force times the horizon. The
    # rate is taken over 4 ms: over 1 ms it is mostly encoder steps.
    rate = (force[104:] - force[100:-4]) / 4.0
    table["theory_hold"] = np.array(horizons) * np.linalg.norm(rate) / np.linalg.norm(force[100:])
    return {"horizon": table}


def judge(data: Data) -> Verdict:
    """Find the horizon at which each predictor becomes worse than zero-order hold.

    A predictor is useless where its error is a quarter of the force. At 64 ms the Koopman error is
    0.34, and 0.29 in the shorter run of the quick page.
    """
    table = data["horizon"]
    horizon = table["ahead_ms"]
    hold = table["hold"]
    worse = {name: horizon[table[name] > hold] for name in ("linear", "kalman", "koopman")}
    ends = {
        name: f"beyond {those.min():.0f} ms" if len(those) else "nowhere"
        for name, those in worse.items()
    }
    within = horizon <= LEADS_MS
    gain = float((table["koopman"] / hold)[within].max())
    best = float(
        np.min([table[name] / hold for name in ("linear", "kalman")], axis=0)[within].max()
    )
    at = int(np.argmin(np.abs(horizon - 8.0)))
    return Verdict(
        bool(table["kalman"][-1] > 2.0 * hold[-1] and (table["koopman"][-1] > 0.25)),
        gain < 1.0 and bool((table["koopman"] < 1.1 * hold).all()),
        f"At {horizon[at]:.0f} ms the error is {100 * hold[at]:.1f} % of the force by "
        "zero-order hold, "
        f"{100 * table['linear'][at]:.1f} % by the straight line, "
        f"{100 * table['kalman'][at]:.1f} % by the Kalman "
        f"filter and {100 * table['koopman'][at]:.1f} % by the Koopman predictor. Worse than "
        "hold: the line "
        f"{ends['linear']}, the filter {ends['kalman']}, Koopman {ends['koopman']}. At "
        f"{horizon[-1]:.0f} ms no "
        f"predictor is useful: the Koopman error is {100 * table['koopman'][-1]:.0f} %. Up "
        f"to {LEADS_MS:g} ms it is "
        f"below {gain:.2f} of hold, that of the simpler predictors below {best:.2f}.",
    )


def ask() -> list[Answer]:
    """Give the engine samples that are not finite, a pause, and invalid predictors."""
    guarded = predictors()["koopman"]
    assert isinstance(guarded, Guarded)
    recording = tapped(STIFFNESS_N_M, seed=9, seconds=2.0)
    position = recording.position_m
    force = recording.force_N
    deep = int(np.argmax(np.linalg.norm(force, axis=1)))
    for tick in range(deep):
        guarded.meet(Contact.of_row(recording.contact[tick]))
        guarded.observe(position[tick], np.zeros(3), force[tick])
    before = guarded.is_primary
    guarded.observe(np.full(3, np.nan), np.zeros(3), force[deep])
    kept = float(np.linalg.norm(guarded.predict(5)))
    size = float(np.linalg.norm(force[deep]))
    for tick in range(deep + 1, deep + 16):
        guarded.observe(position[min(tick, len(force) - 1)], np.zeros(3), np.full(3, np.nan))
    return [
        refused("a straight line through no time", lambda: Linear(0)),
        refused("a Kalman filter without noise", lambda: Kalman(0.0)),
        shown(
            "5 ms ahead after a sample that is NaN",
            before and bool(abs(kept - size) < 0.2 * size),
            f"the sample is ignored: {kept:.3f} N where the force is {size:.3f} N",
        ),
        shown(
            "5 ms ahead after 15 samples that are NaN",
            bool(np.isfinite(guarded.predict(5)).all()),
            f"the last force is held: {np.linalg.norm(guarded.predict(5)):.3f} N",
            conduct=Conduct.FALLS_BACK,
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Draw the error over the horizon."""
    table = data["horizon"]
    horizon_ms = table["ahead_ms"]
    curves = [
        (label, 100.0 * table[name], PREDICTORS[name].marker, PREDICTORS[name].colour)
        for name, label in LABELS.items()
    ]
    panel(
        chart.subplots(),
        horizon_ms,
        ("horizon / ms", "force error / %"),
        [
            *curves,
            ("theory of hold: rate × horizon", 100.0 * table["theory_hold"], "-", GREY),
            ("error of no force at all", 100.0, ":", GREEN),
        ],
        conduct=[(Conduct.HOLDS, horizon_ms[0], LEADS_MS)],
        ylim=(0.5, 400.0),
        legend="upper left",
    )


PAGE = Page(
    "horizon",
    "Prediction horizon: how far ahead can a force be predicted?",
    "A novice taps a wall of 800 N/m. How large is the error of forces predicted 1 to 64 ms "
    "ahead, and from which "
    "horizon on is zero-order hold better?",
    "Trained on three recordings, tested on a fourth; device with six degrees of freedom",
    measure,
    judge,
    ask,
    draw,
)
