"""E11: relaxation of a force towards a wanted one settles up to 2 without delay, and less with every sample of it."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.evaluation.atlas.drawing import BLUE, GREY, RED, TINTS, finish
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.haptics.loop.filters import DelayLine, LowPass, low_pass_gain, relaxation_bound

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["RELAXATION"]

Array = NDArray[np.float64]
BISECTIONS = 12
"""Of the interval 0 to 3: 7e-4."""


def grows(gains: Array, delay: int, ticks: int) -> NDArray[np.bool_]:
    """Whether F <- F + a (1 - F delayed) leaves 1 for each gain a, all at once; shape (k,)."""
    line, force = DelayLine(delay, size=len(gains)), np.zeros(len(gains))
    early = late = np.zeros(len(gains))
    with np.errstate(over="ignore", invalid="ignore"):
        for tick in range(ticks):
            force = force + gains * (1.0 - line.step(force))
            error = np.abs(force - 1.0)
            if ticks // 2 <= tick < 3 * ticks // 4:
                early = np.maximum(early, error)
            elif tick >= 3 * ticks // 4:
                late = np.maximum(late, error)
        return ~(late < np.maximum(early, 1e-12))


def measured_bound(delay: int) -> float:
    """Gain at which the iteration starts to grow, by bisection over runs."""
    low, high, ticks = 0.0, 3.0, 400 * (delay + 2)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if grows(np.array([middle]), delay, ticks)[0]:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


def measure(quick: bool) -> Data:
    """The bound over delays."""
    delays = np.array([0, 1, 2, 5] if quick else [0, 1, 2, 3, 4, 5, 6, 8, 10])
    return {
        "bound": {
            "delay_samples": delays.astype(float),
            "measured": np.array([measured_bound(int(d)) for d in delays]),
            "theory": np.array([relaxation_bound(int(d)) for d in delays]),
        }
    }


def judge(data: Data) -> Verdict:
    """Measured against 2 sin(pi / (2 (2 d + 1))), and both against the printed 1."""
    found = data["bound"]
    off = float(np.abs(found["measured"] / found["theory"] - 1.0).max())
    last = found["measured"][-1]
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


def draw(data: Data, chart: "Figure") -> None:
    """Bound over delay."""
    axes, found = chart.subplots(), data["bound"]
    delay = found["delay_samples"]
    axes.fill_between(
        [-0.25, 0.25], 0.0, 1.0, color=TINTS[Conduct.HOLDS], zorder=0, label="engine holds: no delay, a ≤ 1"
    )
    fine = np.arange(0.0, delay[-1] + 0.05, 0.05)
    axes.plot(fine, 2.0 * np.sin(np.pi / (2.0 * (2.0 * fine + 1.0))), color=GREY, label="theory: 2 sin(π/(2(2d+1)))")
    axes.axhline(1.0, color=RED, linestyle="--", label="printed: 1, whatever the delay")
    axes.plot(delay, found["measured"], "o", color=BLUE, label="measured")
    axes.annotate("runs away", (0.62 * delay[-1], 1.5), color=GREY)
    axes.annotate("settles", (1.0, 0.15), color=GREY)
    finish(axes, "delay d / samples", "gain a", ylim=(0.0, 2.2))


RELAXATION = Page(
    "relaxation",
    "E11 · Does F ← F + a(F_wanted − F) need 0 < a < 1?",
    "A published theorem asks for a gain between 0 and 1. Which gains settle, without and with samples of delay?",
    "Statement E11; bound of Levin and May (1976)",
    measure,
    judge,
    ask,
    draw,
)
