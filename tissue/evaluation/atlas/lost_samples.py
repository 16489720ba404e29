"""Dropped, late and repeated samples: without a guard a stale force stays, with it the force fades and comes back."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREEN, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Table, Verdict, refused, shown
from tissue.evaluation.atlas.pressing import FAULT_S, TICK_S, pressed
from tissue.haptics.device.faulty import Fault, FaultKind
from tissue.haptics.device.sample_guard import GuardLimits

__all__ = ["PAGE"]

KINDS: tuple[FaultKind, ...] = ("dropped", "late", "duplicated")
STYLES = {"dropped": ("o", BLUE), "late": ("s", ORANGE), "duplicated": ("^", GREEN)}
LIMITS = GuardLimits()
AFTER_S = 0.08


def shares(kind: FaultKind, gap_s: float, *, guarded: bool) -> tuple[float, float, float]:
    """Force over that before the gap: at its last tick, the largest after it; and the largest step while it lasts."""
    run, _ = pressed([Fault(kind, FAULT_S, FAULT_S + gap_s)], seconds=FAULT_S + gap_s + AFTER_S, guarded=guarded)
    size = np.linalg.norm(run.force_N, axis=1)
    first, last = round(FAULT_S / TICK_S), round((FAULT_S + gap_s) / TICK_S) - 1
    before = float(size[first - 1])
    step = float(np.abs(np.diff(size[first - 1 : last + 1])).max())
    return float(size[last]) / before, float(size[last + 1 :].max()) / before, step / before


def over_gap(kind: FaultKind, gaps: Array) -> Table:
    """Shares of the force over the length of the gap, with the guard and without it."""
    guarded, bare = (np.array([shares(kind, gap, guarded=guard) for gap in gaps.tolist()]) for guard in (True, False))
    # Repeated samples age while they are young enough to be accepted, late ones are old; from then on 1/20 is lost
    # every tick.
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
    """Shares of the force for every kind of fault."""
    gaps = 1e-3 * np.array([5, 30] if quick else [1, 2, 5, 8, 12, 16, 20, 30, 60])
    return {kind: over_gap(kind, gaps) for kind in KINDS}


def judge(data: Data) -> Verdict:
    """Stale or stepping forces without the guard; fading along the line of theory with it."""
    off = max(float(np.abs(t["guarded_at_end"] - t["theory_at_end"]).max()) for t in data.values())
    gone = max(float(t["guarded_at_end"][t["gap_s"] > 0.025].max()) for t in data.values())
    back = min(float(t["guarded_after"].min()) for t in data.values())
    step = max(float(t["guarded_step"].max()) for t in data.values())
    stale, jump = float(data["duplicated"]["bare_at_end"].min()), float(data["dropped"]["bare_step"].max())
    return Verdict(
        stale > 0.5 and jump > 0.9,
        gone < 1e-9 and back > 0.5 and step < 0.1 and off < 0.1,
        f"Without a guard repeated samples keep at least {100 * stale:.0f} % of the force for as long as they last, "
        f"and dropped ones step it by {100 * jump:.0f} % in a tick. With it the force falls in 20 ms to {gone:.0e}, "
        f"{100 * step:.0f} % a tick at most, as the line predicts to {100 * off:.0f} %, and is back 80 ms after its "
        "end.",
    )


def ask() -> list[Answer]:
    """What the guard reports, and what it refuses."""
    answers = []
    for kind in KINDS:
        run, guard = pressed([Fault(kind, FAULT_S, FAULT_S + 0.04)], seconds=FAULT_S + 0.1, guarded=True)
        happened = [what for when, what in guard.events if when > 0.1] if guard is not None else []
        bounded = bool(np.isfinite(run.force_N).all())
        right = len(happened) >= 2 and happened[-1] == "samples are good again" and bounded
        answers.append(shown(f"40 ms of {kind} samples", right, "; ".join(happened), conduct=Conduct.FALLS_BACK))
    return [*answers, refused("a guard that never fades", lambda: GuardLimits(fade_s=0.0))]


def draw(data: Data, chart: Figure) -> None:
    """Share of the force at the end of the gap, with and without the guard."""
    left, right = chart.subplots(1, 2, sharey=True)
    gap = 1e3 * data["late"]["gap_s"]
    longest, label = gap.max(), "length of the gap / ms"
    fine = np.linspace(0.0, 1e-3 * longest, 200)
    left.plot(1e3 * fine, np.clip(1.0 - fine / LIMITS.fade_s, 0.0, 1.0), color=GREY, label="theory: gone in 20 ms")
    guarded, bare = (
        [(kind, table[f"{what}_at_end"], *STYLES[kind]) for kind, table in data.items()] for what in ("guarded", "bare")
    )
    right.text(0.5 * longest, 0.5, "a repeated or late sample\nkeeps its force", color=RED, ha="center")
    panel(left, gap, label, "force at its end / force before", guarded, log="", xlim=(0.0, longest),
          conduct=[(Conduct.FALLS_BACK, 0.0, longest)], title="with the sample guard (ours)",
          ylim=(-0.05, 1.25))  # fmt: skip
    panel(right, gap, label, "", [*bare, ("_", 0.0, ":", GREY)], log="", xlim=(0.0, longest), conduct=(),
          title="every sample accepted", legend="center left")  # fmt: skip


PAGE = Page(
    "lost_samples",
    "Dropped, late and repeated samples",
    "A hand presses a device onto a wall and its samples stop coming, come 5 ms late, or are repeated. What does the "
    "hand feel while that lasts?",
    "Sample guard: samples older than 2.5 ms are missing, a missing one takes 1/20 of the force; Omni, wall of 1.5 "
    "kN/m",
    measure,
    judge,
    ask,
    draw,
)
