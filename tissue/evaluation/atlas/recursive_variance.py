"""E8: a recursive estimate that forgets its own last variance is overconfident; the Kalman filter is not."""

import numpy as np
from matplotlib.figure import Figure

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, error_of, refused, shown, sweep
from tissue.perception.estimate import LocalLevel

__all__ = ["PAGE"]


def measure(quick: bool) -> Data:
    """Squared error of both filters over q / r, and the variance that each estimates; thousands of levels at a time."""
    rng, count = np.random.default_rng(8), 2000 if quick else 4000

    def errors(q: float) -> dict[str, float]:
        """Of r = 1."""
        law, printed = LocalLevel(wander=q, noise=1.0), q / (q + 1.0)  # variance and, of r = 1, gain
        level, ours, theirs, variance = np.zeros(count), np.zeros(count), np.zeros(count), 0.0
        for _ in range(round(min(6.0 / np.sqrt(q), 200.0)) + 12):
            level = level + np.sqrt(q) * rng.standard_normal(count)
            seen = level + rng.standard_normal(count)
            ours, variance = law.step(ours, variance, seen)
            theirs = theirs + printed * (seen - theirs)
        return {
            "ours_believed": variance,
            "theory": law.steady_variance,
            "ours_error": ((ours - level) ** 2).mean(),
            "printed_believed": printed,
            "printed_error": ((theirs - level) ** 2).mean(),
        }

    return {"variance": sweep("q_over_r", np.geomspace(1e-3, 1e2, 4 if quick else 11), errors)}


def judge(data: Data) -> Verdict:
    """Belief over error of both, and the steady state against the closed form."""
    table = data["variance"]
    printed = float((table["printed_error"] / table["printed_believed"]).max())
    off, closed = (
        error_of(table["ours_error"], table["ours_believed"]),
        error_of(table["ours_believed"], table["theory"]),
    )
    return Verdict(
        printed > 5.0,
        # 2000 runs leave 3 % on a variance: five times that.
        off < 0.16 and closed < 0.02,
        f"The printed variance qr/(q+r) is up to {printed:.0f} times below the filter's true squared error, the "
        f"Kalman filter's within {100 * off:.0f} % of it. At q = r = 1 its steady state is "
        f"{LocalLevel(wander=1.0, noise=1.0).steady_variance:.3f}, not 0.5.",
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


def draw(data: Data, chart: Figure) -> None:
    """Variances over q / r."""
    left, right = chart.subplots(1, 2)
    table = data["variance"]
    panel(left, table["q_over_r"], "wander over noise q / r", "variance / r", [
        ("theory: (−q + √(q² + 4qr))/2", table["theory"], "-", GREY),
        ("printed: qr/(q+r)", table["printed_believed"], "--", RED),
        ("estimated by ours", table["ours_believed"], "o", BLUE),
        ("squared error of ours, measured", table["ours_error"], "^", ORANGE),
    ])  # fmt: skip
    panel(right, table["q_over_r"], "wander over noise q / r", "squared error / estimated variance", [
        ("theory: estimates its own error", 1.0, "-", GREY),
        ("printed", table["printed_error"] / table["printed_believed"], "s", RED),
        ("ours", table["ours_error"] / table["ours_believed"], "o", BLUE),
    ])  # fmt: skip


PAGE = Page(
    "recursive_variance",
    "E8 · Is σ² = q·r/(q + r) the variance of a recursive estimate?",
    "A published update forgets the variance of the step before. How far is its estimate from the error that it makes?",
    "Statement E8; scalar Kalman filter (1960), errors over thousands of simulated levels",
    measure,
    judge,
    ask,
    draw,
)
