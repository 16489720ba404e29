"""E8: a recursive estimate that forgets its own last variance is overconfident; the Kalman filter is not."""

from typing import TYPE_CHECKING

import numpy as np

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, finish, region
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.perception.recursive import LocalLevel

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["RECURSIVE_VARIANCE"]


def measure(quick: bool) -> Data:
    """Squared error of both filters over q / r, and the variance that each estimates; 1000 levels at a time."""
    ratios = np.geomspace(1e-3, 1e2, 4 if quick else 11)
    rng, count = np.random.default_rng(8), 2000 if quick else 4000
    rows = []
    for q in ratios.tolist():
        law = LocalLevel(wander=q, noise=1.0)
        printed_variance = q / (q + 1.0)
        printed_gain = printed_variance  # of r = 1
        level, ours, theirs, variance = np.zeros(count), np.zeros(count), np.zeros(count), 0.0
        for _ in range(round(min(6.0 / np.sqrt(q), 200.0)) + 12):
            level = level + np.sqrt(q) * rng.standard_normal(count)
            seen = level + rng.standard_normal(count)
            ours, variance = law.step(ours, variance, seen)
            theirs = theirs + printed_gain * (seen - theirs)
        rows.append((variance, law.steady_variance, float(((ours - level) ** 2).mean()),
                     printed_variance, float(((theirs - level) ** 2).mean())))  # fmt: skip
    found = np.array(rows)
    names = ("ours_believed", "theory", "ours_error", "printed_believed", "printed_error")
    return {"variance": {"q_over_r": ratios, **{name: found[:, i] for i, name in enumerate(names)}}}


def judge(data: Data) -> Verdict:
    """Belief over error of both, and the steady state against the closed form."""
    table = data["variance"]
    printed = table["printed_error"] / table["printed_believed"]
    ours = table["ours_error"] / table["ours_believed"]
    closed = float(np.abs(table["ours_believed"] / table["theory"] - 1.0).max())
    law = LocalLevel(wander=1.0, noise=1.0)
    return Verdict(
        float(printed.max()) > 5.0,
        # 2000 runs leave 3 % on a variance: five times that.
        bool((np.abs(ours - 1.0) < 0.16).all()) and closed < 0.02,
        f"The printed variance qr/(q+r) is up to {printed.max():.0f} times below the filter's true squared error, the "
        f"Kalman filter's within {100 * np.abs(ours - 1.0).max():.0f} % of it. At q = r = 1 its steady state is "
        f"{law.steady_variance:.3f}, not 0.5.",
    )


def ask() -> list[Answer]:
    """Impossible variances, and the steady state of the engine's filter."""
    law, variance = LocalLevel(wander=1.0, noise=1.0), 1e6
    for _ in range(60):
        _, variance = law.step(0.0, variance, 0.0)
    return [
        refused("looks without noise", lambda: LocalLevel(wander=1.0, noise=0.0)),
        refused("a level that wanders by −1", lambda: LocalLevel(wander=-1.0, noise=1.0)),
        shown("its variance after 60 looks, begun at a million", abs(variance - law.steady_variance) < 1e-12,
              f"{variance:.12f}, closed form {law.steady_variance:.12f}"),
    ]  # fmt: skip


def draw(data: Data, chart: "Figure") -> None:
    """Variances over q / r."""
    left, right = chart.subplots(1, 2)
    table = data["variance"]
    ratio = table["q_over_r"]
    for axes in (left, right):
        region(axes, Conduct.HOLDS, ratio[0], ratio[-1])
    left.loglog(ratio, table["theory"], color=GREY, label="theory: (−q + √(q² + 4qr))/2")
    left.loglog(ratio, table["printed_believed"], "--", color=RED, label="printed: qr/(q+r)")
    left.loglog(ratio, table["ours_believed"], "o", color=BLUE, label="estimated by ours")
    left.loglog(ratio, table["ours_error"], "^", color=ORANGE, label="squared error of ours, measured")
    finish(left, "wander over noise q / r", "variance / r", xlim=ratio[[0, -1]])
    right.axhline(1.0, color=GREY, label="theory: estimates its own error")
    right.loglog(ratio, table["printed_error"] / table["printed_believed"], "s", color=RED, label="printed")
    right.loglog(ratio, table["ours_error"] / table["ours_believed"], "o", color=BLUE, label="ours")
    finish(right, "wander over noise q / r", "squared error / estimated variance", xlim=ratio[[0, -1]])


RECURSIVE_VARIANCE = Page(
    "recursive_variance",
    "E8 · Is σ² = q·r/(q + r) the variance of a recursive estimate?",
    "A published update forgets the variance of the step before. How far is its estimate from the error that it makes?",
    "Statement E8; scalar Kalman filter (1960), errors over thousands of simulated levels",
    measure,
    judge,
    ask,
    draw,
)
