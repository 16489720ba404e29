"""E11: relaxation of a force towards a wanted one settles up to 2 without delay, and less with every sample of it."""

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, TINTS, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, error_of, refused, shown, sweep
from tissue.haptics.loop.filters import DelayLine, LowPass, low_pass_gain, relaxation_bound

__all__ = ["PAGE"]


def measured_bound(delay: int) -> float:
    """Least gain a of many, run all at once, at which F <- F + a (1 - F delayed) leaves 1."""
    gains, ticks = np.linspace(0.0, 3.0, 4097)[1:], 400 * (delay + 2)
    line, force = DelayLine(delay, size=len(gains)), np.zeros(len(gains))
    early = late = np.zeros(len(gains))
    with np.errstate(over="ignore", invalid="ignore"):
        for tick in range(ticks):
            force = force + gains * (1.0 - line.step(force))
            if tick >= 3 * ticks // 4:
                late = np.maximum(late, np.abs(force - 1.0))
            elif tick >= ticks // 2:
                early = np.maximum(early, np.abs(force - 1.0))
        return float(gains[np.argmin(late < np.maximum(early, 1e-12))])


def measure(quick: bool) -> Data:
    """The bound over delays."""
    delays = np.array([0.0, 1.0, 2.0, 5.0] if quick else [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0])
    return {
        "bound": sweep(
            "delay_samples",
            delays,
            lambda d: {"measured": measured_bound(int(d)), "theory": relaxation_bound(int(d))},
        )
    }


def judge(data: Data) -> Verdict:
    """Measured against 2 sin(pi / (2 (2 d + 1))), and both against the printed 1."""
    found = data["bound"]
    off, last = error_of(found["measured"], found["theory"]), found["measured"][-1]
    return Verdict(
        bool(found["measured"][0] > 1.5 and last < 0.9),
        off < 0.02,
        f"Without delay every gain below {found['measured'][0]:.3f} settles, not only those below the printed 1; with "
        f"{found['delay_samples'][-1]:.0f} samples of delay those above {last:.3f} run away though printed as stable. "
        f"The bound 2 sin(π/(2(2d+1))) is met to {100 * off:.1f} % (runs end: near it a run must be long).",
    )


def ask() -> list[Answer]:
    """What the engine relaxes with, and how it reports the bound."""
    gains = [low_pass_gain(constant, 1e-3) for constant in (0.0, 1e-4, 1e-3, 1e-2)]
    filtered = LowPass(1e-4, step_s=1e-3, size=1)
    reached = [float(filtered.step(np.ones(1))[0]) for _ in range(20)]
    return [
        refused("the bound for −1 samples", lambda: relaxation_bound(-1)),
        shown(
            "the only relaxation in the loop, the low-pass: it has no delay inside",
            max(gains) <= 1.0 and max(reached) <= 1.0,
            f"its gain is {min(gains):.3f} to {max(gains):g} for time constants of 10 to 0 ms, and it never overshoots",
        ),
    ]


def draw(data: Data, chart: Figure) -> None:
    """Bound over delay."""
    axes, found = chart.subplots(), data["bound"]
    delay, tint, label = found["delay_samples"], TINTS[Conduct.HOLDS], "engine holds: no delay, a ≤ 1"
    axes.fill_between([-0.25, 0.25], 0.0, 1.0, color=tint, zorder=0, label=label)
    fine = np.arange(0.0, delay[-1] + 0.05, 0.05)
    axes.plot(fine, 2.0 * np.sin(np.pi / (2.0 * (2.0 * fine + 1.0))), color=GREY, label="theory: 2 sin(π/(2(2d+1)))")
    axes.annotate("runs away", (0.62 * delay[-1], 1.5), color=GREY)
    axes.annotate("settles", (1.0, 0.15), color=GREY)
    panel(axes, delay, "delay d / samples", "gain a", [
        ("printed: 1, whatever the delay", 1.0, "--", RED),
        ("measured", found["measured"], "o", BLUE),
    ], log="", conduct=(), xlim=(-0.25, delay[-1] + 0.25), ylim=(0.0, 2.2))  # fmt: skip


PAGE = Page(
    "relaxation",
    "E11 · Does F ← F + a(F_wanted − F) need 0 < a < 1?",
    "A published theorem asks for a gain between 0 and 1. Which gains settle, without and with samples of delay?",
    "Statement E11; bound of Levin and May (1976)",
    measure,
    judge,
    ask,
    draw,
)
