"""E13: the printed smoothness index falls with smoothness and grows with the tick; spectral arc length does neither."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, error_of, log_slope, refused, shown, sweep
from tissue.evaluation.statistics.metrics import acceleration_change_m_s2, spectral_arc_length

__all__ = ["PAGE"]

LENGTH_MM, DURATION_S, TREMOR_HZ, TICK_S = 100.0, 1.0, 8.0, 1e-3


def speed_mm_s(tremor: float, tick_s: float) -> Array:
    """Speed of a minimum-jerk reach with a tremor of so much of its peak speed, from rest to rest [mm/s]."""
    share = np.arange(0.0, 1.0 + 0.5 * tick_s / DURATION_S, tick_s / DURATION_S)
    bell = 30.0 * share**2 * (1.0 - share) ** 2 * LENGTH_MM / DURATION_S
    return np.asarray(bell * (1.0 + tremor * np.sin(2.0 * np.pi * TREMOR_HZ * DURATION_S * share)))


def measured(tremor: float, tick_s: float) -> dict[str, float]:
    """Both metrics of a reach."""
    speed = speed_mm_s(tremor, tick_s)
    return {
        "printed_m_s2": acceleration_change_m_s2(speed, tick_s=tick_s),
        "arc_length": spectral_arc_length(speed, tick_s=tick_s),
    }


def measure(quick: bool) -> Data:
    """Both metrics over the tremor, and over the tick of a smooth reach."""
    tremors = np.array([0.0, 0.2, 0.6]) if quick else np.linspace(0.0, 0.9, 10)
    ticks = np.array([5e-4, 4e-3]) if quick else np.array([2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3, 8e-3])
    # The acceleration of the reach swings from 0 to its peak, to minus it and back: 4 times 10/sqrt(3) L / D^2.
    swing = 40.0 / np.sqrt(3.0) * 1e-3 * LENGTH_MM / DURATION_S**2
    return {
        "tremor": sweep("tremor_share", tremors, lambda tremor: measured(tremor, TICK_S)),
        "tick": sweep("tick_s", ticks, lambda tick: measured(0.0, tick)) | {"theory_m_s2": swing * ticks / DURATION_S},
    }


def judge(data: Data) -> Verdict:
    """How either changes with the tremor, and what the tick does to it."""
    tremor, tick = data["tremor"], data["tick"]
    # A tremor below a twentieth of the spectrum's peak counts as noise and leaves the arc length as it is.
    steps = np.diff(tremor["arc_length"])
    slope, off = log_slope(tick["tick_s"], tick["printed_m_s2"]), error_of(tick["printed_m_s2"], tick["theory_m_s2"])
    drift = float(np.ptp(tick["arc_length"]) / np.abs(tick["arc_length"]).mean())
    return Verdict(
        bool((np.diff(tremor["printed_m_s2"]) > 0.0).all()) and abs(slope - 1.0) < 0.05 and off < 0.02,
        bool((steps < 1e-3).all() and steps.sum() < -0.3) and drift < 0.02,
        f"The printed formula rises from {tremor['printed_m_s2'][0]:.3f} to {tremor['printed_m_s2'][-1]:.3f} m/s² with "
        f"the tremor, so higher is rougher, against its table; and it grows as the tick to the power {slope:.2f} (jerk "
        f"times tick, to {100 * off:.1f} %). The spectral arc length falls from {tremor['arc_length'][0]:.2f} to "
        f"{tremor['arc_length'][-1]:.2f} and moves by {100 * drift:.1f} % with the tick.",
    )


def ask() -> list[Answer]:
    """Signals that are no movement."""
    still = np.zeros(100)
    same = spectral_arc_length(3.0 * speed_mm_s(0.2, TICK_S), tick_s=TICK_S)
    return [
        refused("the arc length of no movement", lambda: spectral_arc_length(still, tick_s=TICK_S)),
        refused("the formula on two ticks", lambda: acceleration_change_m_s2(np.zeros(2), tick_s=TICK_S)),
        refused("a velocity that is not a number", lambda: acceleration_change_m_s2(np.full(9, np.nan), tick_s=TICK_S)),
        shown("the arc length of the same reach, three times as large",
              abs(same - spectral_arc_length(speed_mm_s(0.2, TICK_S), tick_s=TICK_S)) < 1e-9, f"the same, {same:.3f}"),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Both metrics over tremor and tick."""
    left, right = chart.subplots(1, 2)
    tremor, tick, arc = data["tremor"], data["tick"], "spectral arc length (right)"
    for axes, across, table in ((left, tremor["tremor_share"], tremor), (right, 1e3 * tick["tick_s"], tick)):
        other = axes.twinx()
        other.plot(across, table["arc_length"], "o", color=BLUE)
        other.set_ylim(-6.0, 0.0)
    other.set_ylabel("spectral arc length (0: smoothest)", color=BLUE)
    hidden = ((arc, np.nan, "o", BLUE),)
    panel(left, tremor["tremor_share"], "tremor of 8 Hz / peak speed", "mean change of acceleration / (m/s²)",
          [("printed formula (left)", tremor["printed_m_s2"], "s", RED), *hidden],
          log="", legend="lower right")  # fmt: skip
    panel(right, 1e3 * tick["tick_s"], "tick / ms", "", [
        ("theory: mean jerk × tick", tick["theory_m_s2"], "-", GREY),
        ("printed formula (left)", tick["printed_m_s2"], "s", RED),
        *hidden,
    ], log="", legend="lower right")  # fmt: skip


PAGE = Page(
    "smoothness",
    "E13 · Is a higher smoothness index smoother?",
    "A published index is mean |Δa|, while its table reads as if higher were better. Where do the formula and the "
    "spectral arc length go as a reach trembles more, and as it is sampled at other ticks?",
    "Statement E13; minimum-jerk reach of 100 mm in 1 s; SPARC of Balasubramanian et al. (2015)",
    measure,
    judge,
    ask,
    draw,
)
