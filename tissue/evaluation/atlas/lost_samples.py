"""Dropped, late and repeated samples: without a guard a stale force stays, with it the force
fades and returns.
"""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.hands import FAULT_S, TICK_S, pressed
from tissue.evaluation.atlas.page import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    Answer,
    Conduct,
    Data,
    Page,
    Table,
    Verdict,
    panel,
    refused,
    shown,
)
from tissue.haptics.device.recorded import Fault, FaultKind
from tissue.haptics.device.sample_guard import GuardLimits

__all__ = ["PAGE"]

STYLES: dict[FaultKind, tuple[str, str]] = {
    "dropped": ("o", BLUE),
    "late": ("s", ORANGE),
    "duplicated": ("^", GREEN),
}
LIMITS = GuardLimits()
AFTER_S = 0.08


def shares(kind: FaultKind, gap_s: float, *, guarded: bool) -> tuple[float, float, float]:
    """Measure the force relative to that before the gap: in its last tick, largest after it, and
    largest step in it.
    """
    fault = Fault(kind, FAULT_S, FAULT_S + gap_s)
    run, _ = pressed([fault], seconds=FAULT_S + gap_s + AFTER_S, guarded=guarded)
    size = np.linalg.norm(run.force_N, axis=1)
    first = round(FAULT_S / TICK_S)
    last = round((FAULT_S + gap_s) / TICK_S) - 1
    step = np.abs(np.diff(size[first - 1 : last + 1])).max()
    at_end, after, largest_step = (
        np.array([size[last], size[last + 1 :].max(), step]) / size[first - 1]
    ).tolist()
    return at_end, after, largest_step


def over_gap(kind: FaultKind, gaps: Array) -> Table:
    """Sweep the length of the gap, with the guard and without it."""
    guarded = np.array([shares(kind, gap, guarded=True) for gap in gaps.tolist()])
    bare = np.array([shares(kind, gap, guarded=False) for gap in gaps.tolist()])
    # A repeated sample is accepted until it is too old, a late one is too old at once. Then each
    # tick takes 1/20.
    young_s = 2.0 * TICK_S if kind == "duplicated" else 0.0
    return {
        "gap_s": gaps,
        "guarded_at_end": guarded[:, 0],
        "guarded_after": guarded[:, 1],
        "guarded_step": guarded[:, 2],
        "bare_at_end": bare[:, 0],
        "bare_step": bare[:, 2],
        "theory_at_end": np.clip(1.0 - (gaps - young_s) / LIMITS.fade_s, 0.0, 1.0),
    }


def measure(quick: bool) -> Data:
    """Sweep the length of the gap for every kind of fault."""
    gaps = 1e-3 * np.array([5, 30] if quick else [1, 2, 5, 8, 12, 16, 20, 30, 60])
    return {kind: over_gap(kind, gaps) for kind in STYLES}


def judge(data: Data) -> Verdict:
    """Compare stale or stepping forces without the guard with the fading force with it."""
    off = max(float(np.abs(t["guarded_at_end"] - t["theory_at_end"]).max()) for t in data.values())
    gone = max(float(t["guarded_at_end"][t["gap_s"] > 0.025].max()) for t in data.values())
    back = min(float(t["guarded_after"].min()) for t in data.values())
    step = max(float(t["guarded_step"].max()) for t in data.values())
    stale = float(data["duplicated"]["bare_at_end"].min())
    jump = float(data["dropped"]["bare_step"].max())
    return Verdict(
        stale > 0.5 and jump > 0.9,
        gone < 1e-9 and back > 0.5 and step < 0.1 and off < 0.1,
        f"Without a guard repeated samples keep at least {100 * stale:.0f} % of the force as "
        "long as they last, and "
        f"dropped samples step it by {100 * jump:.0f} % in a tick. With the guard the force "
        "decreases in 20 ms to "
        f"{gone:.0e}, by at most {100 * step:.0f} % a tick, as the line predicts to "
        f"{100 * off:.0f} %. It is back "
        "80 ms after the fault.",
    )


def ask() -> list[Answer]:
    """Read the report of the guard for every kind of fault."""
    answers = []
    for kind in STYLES:
        run, guard = pressed(
            [Fault(kind, FAULT_S, FAULT_S + 0.04)], seconds=FAULT_S + 0.1, guarded=True
        )
        events = (
            [event for time_s, event in guard.events if time_s > 0.1] if guard is not None else []
        )
        right = (
            len(events) >= 2
            and events[-1] == "samples are good again"
            and bool(np.isfinite(run.force_N).all())
        )
        answers.append(
            shown(f"40 ms of {kind} samples", right, "; ".join(events), conduct=Conduct.FALLS_BACK)
        )
    return [*answers, refused("a guard that never fades", lambda: GuardLimits(fade_s=0.0))]


def draw(data: Data, chart: Figure) -> None:
    """Draw the force at the end of the gap, with and without the guard."""
    left, right = chart.subplots(1, 2, sharey=True)
    gap = 1e3 * data["late"]["gap_s"]
    longest = gap.max()
    label = "length of the gap / ms"
    fine = np.linspace(0.0, 1e-3 * longest, 200)
    left.plot(
        1e3 * fine,
        np.clip(1.0 - fine / LIMITS.fade_s, 0.0, 1.0),
        color=GREY,
        label="theory: zero in 20 ms",
    )
    guarded = [(kind, data[kind]["guarded_at_end"], *style) for kind, style in STYLES.items()]
    bare = [(kind, data[kind]["bare_at_end"], *style) for kind, style in STYLES.items()]
    right.text(
        0.5 * longest, 0.5, "a repeated or late sample\nkeeps its force", color=RED, ha="center"
    )
    panel(
        left,
        gap,
        (label, "force at its end / force before"),
        guarded,
        conduct=[(Conduct.FALLS_BACK, 0.0, longest)],
        log="",
        xlim=(0.0, longest),
        ylim=(-0.05, 1.25),
        title="with the sample guard (engine)",
    )
    panel(
        right,
        gap,
        (label, ""),
        [*bare, ("_", 0.0, ":", GREY)],
        conduct=(),
        log="",
        xlim=(0.0, longest),
        title="every sample accepted",
        legend="center left",
    )


PAGE = Page(
    "lost_samples",
    "Dropped, late and repeated samples",
    "A hand presses a device onto a wall. Its samples are lost, come 5 ms late, or are "
    "repeated. Which force does the "
    "hand feel during the fault?",
    "Sample guard: samples older than 2.5 ms are missing, a missing one takes 1/20 of the "
    "force; Omni, wall of 1.5 "
    "kN/m",
    measure,
    judge,
    ask,
    draw,
)
