"""How far ahead a force can be predicted: every predictor against holding the last force, over the horizon."""

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import GREEN, GREY, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.evaluation.atlas.tapping import LIMIT_N, TICK_S, koopman, relative_error, tapped
from tissue.evaluation.training.train import fit, forecast
from tissue.prediction.baselines import Kalman, Linear
from tissue.prediction.contact import Contact
from tissue.prediction.guard import Guarded
from tissue.prediction.predictor import Hold, Predictor
from tissue.scene.registry import PREDICTORS

__all__ = ["PAGE"]

STIFFNESS_N_M = 800.0
LABELS = {
    "hold": "hold",
    "linear": "straight line",
    "kalman": "Kalman, constant acceleration",
    "koopman": "Koopman, guarded (ours)",
}
LEADS_MS = 10.0
"""Horizon up to which the loop predicts: its delay and filter are some milliseconds."""


def predictors() -> dict[str, Predictor]:
    """All of them, the lifted one trained on three other recordings of the same wall."""
    trained = fit("wall", [tapped(STIFFNESS_N_M, seed=seed, seconds=3.0) for seed in (1, 2, 3)])
    return {
        "hold": Hold(),
        "linear": Linear(),
        "kalman": Kalman(),
        "koopman": Guarded(koopman(trained), Hold(), reach_N=LIMIT_N),
    }


def measure(quick: bool) -> Data:
    """Relative errors over the horizon on a recording that nothing has learnt from."""
    horizons = [1, 4, 8, 64] if quick else [1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64]
    recording = tapped(STIFFNESS_N_M, seed=9, seconds=1.5 if quick else 4.0)
    force = recording.force_N
    data = {"ahead_ms": 1e3 * TICK_S * np.array(horizons, dtype=float)}
    for name, each in predictors().items():
        forces, _ = forecast(each, recording, horizons)
        data[name] = np.array([relative_error(forces[:, row], force, horizon) for row, horizon in enumerate(horizons)])
    # For a short time a held force is off by the rate of the force times that time.
    rate = (force[104:] - force[100:-4]) / 4.0  # over 4 ms: over one, encoder steps are most of it
    data["theory_hold"] = np.array(horizons) * np.linalg.norm(rate) / np.linalg.norm(force[100:])
    return {"horizon": data}


def judge(data: Data) -> Verdict:
    """Where each predictor stops to be better than hold, and whether ours is worse anywhere.

    It is of no use where it is off by a quarter of the force, at 64 ms 0.34, on the quick page's shorter run by 0.29.
    """
    table = data["horizon"]
    horizon, hold = table["ahead_ms"], table["hold"]
    worse = {name: horizon[table[name] > hold] for name in ("linear", "kalman", "koopman")}
    ends = {name: f"beyond {those.min():.0f} ms" if len(those) else "nowhere" for name, those in worse.items()}
    within = horizon <= LEADS_MS
    gain = float((table["koopman"] / hold)[within].max())
    best = float(np.min([table[name] / hold for name in ("linear", "kalman")], axis=0)[within].max())
    at = int(np.argmin(np.abs(horizon - 8.0)))
    return Verdict(
        bool(table["kalman"][-1] > 2.0 * hold[-1] and (table["koopman"][-1] > 0.25)),
        gain < 1.0 and bool((table["koopman"] < 1.1 * hold).all()),
        f"At {horizon[at]:.0f} ms hold is off by {100 * hold[at]:.1f} % of the force, the straight line by "
        f"{100 * table['linear'][at]:.1f} %, the Kalman filter by {100 * table['kalman'][at]:.1f} % and the Koopman "
        f"predictor by {100 * table['koopman'][at]:.1f} %. Worse than hold: the line {ends['linear']}, the filter "
        f"{ends['kalman']}, Koopman {ends['koopman']}. At {horizon[-1]:.0f} ms none is of use: ours is off by "
        f"{100 * table['koopman'][-1]:.0f} %. Up to {LEADS_MS:g} ms ours keeps below {gain:.2f} of hold, the simpler "
        f"ones below {best:.2f}.",
    )


def ask() -> list[Answer]:
    """Samples that are not finite, a pause, and predictors that cannot be."""
    guarded = predictors()["koopman"]
    assert isinstance(guarded, Guarded)
    recording = tapped(STIFFNESS_N_M, seed=9, seconds=2.0)
    position, force = recording.position_m, recording.force_N
    deep = int(np.argmax(np.linalg.norm(force, axis=1)))
    for tick in range(deep):
        guarded.meet(Contact.of_row(recording.contact[tick]))
        guarded.observe(position[tick], np.zeros(3), force[tick])
    before = guarded.is_primary
    guarded.observe(np.full(3, np.nan), np.zeros(3), force[deep])
    kept, size = guarded.predict(5), float(np.linalg.norm(force[deep]))
    left = float(np.linalg.norm(kept))
    for tick in range(deep + 1, deep + 16):
        guarded.observe(position[min(tick, len(force) - 1)], np.zeros(3), np.full(3, np.nan))
    return [
        refused("a straight line through no time", lambda: Linear(0)),
        refused("a Kalman filter without noise", lambda: Kalman(0.0)),
        shown("5 ms ahead after a sample that is not a number", before and bool(abs(left - size) < 0.2 * size),
              f"counts as none: {left:.3f} N where the force is {size:.3f} N"),
        shown("5 ms ahead after 15 of them", bool(np.isfinite(guarded.predict(5)).all()),
              f"the last force is held: {np.linalg.norm(guarded.predict(5)):.3f} N", conduct=Conduct.FALLS_BACK),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Error over the horizon."""
    table = data["horizon"]
    panel(chart.subplots(), table["ahead_ms"], "horizon / ms", "force error / %", [
        *((label, 100.0 * table[name], PREDICTORS[name].marker, PREDICTORS[name].colour)
          for name, label in LABELS.items()),
        ("theory of hold: rate × horizon", 100.0 * table["theory_hold"], "-", GREY),
        ("as far off as no force at all", 100.0, ":", GREEN),
    ], conduct=[(Conduct.HOLDS, table["ahead_ms"][0], LEADS_MS)], ylim=(0.5, 400.0), legend="upper left")  # fmt: skip


PAGE = Page(
    "horizon",
    "Prediction horizon: how far ahead can a force be predicted?",
    "A novice taps a wall of 800 N/m. How far off are forces that are predicted 1 to 64 ms ahead, and from where on is "
    "holding the last one better?",
    "Trained on three recordings, tested on a fourth; device of six degrees of freedom",
    measure,
    judge,
    ask,
    draw,
)
