"""E7: the posterior of a force can have two maxima, and Newton's method from an observation of zero or less breaks."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, finish, region
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown
from tissue.perception.estimate import log_posterior, map_force_N, require_prior_fits

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["TWO_MAXIMA"]

Array = NDArray[np.float64]
MEDIAN_N, SPREAD, NOISE_N = 0.1, 0.3, 0.3
GRID = np.linspace(np.log(1e-4), np.log(20.0), 20_001)
"""Logarithms of forces among which the greatest density is looked for by brute force."""


def density(seen: float) -> Array:
    """Logarithm of the posterior density on the grid."""
    one = np.array
    return np.asarray(log_posterior(GRID, one(seen), one(NOISE_N), one(np.log(MEDIAN_N)), one(SPREAD)))


def newton_N(seen: float) -> float:
    """Newton's method on the posterior's slope in F, begun at the observation; NaN where it leaves positive ones."""
    force = seen
    for _ in range(100):
        if not 0.0 < force < 1e6:
            return float("nan")
        off = np.log(force / MEDIAN_N) / SPREAD**2
        slope = -off / force - 1.0 / force + (seen - force) / NOISE_N**2
        bend = (off + 1.0 - 1.0 / SPREAD**2) / force**2 - 1.0 / NOISE_N**2
        force -= slope / bend
    return float(force)


def bimodal(seen: float) -> bool:
    """Whether theory has two maxima: the slope in ln F turns twice, and has opposite signs where it does."""
    square = seen * seen - 8.0 * (NOISE_N / SPREAD) ** 2
    if seen <= 0.0 or square <= 0.0:
        return False
    turns = 0.25 * (seen + np.sqrt(square) * np.array([-1.0, 1.0]))
    slopes = -np.log(turns / MEDIAN_N) / SPREAD**2 - 1.0 + (seen - turns) * turns / NOISE_N**2
    return bool(slopes[0] < 0.0 < slopes[1])


def measure(quick: bool) -> Data:
    """Estimates over the observation: brute force, Newton from the observation, and ours."""
    seen = np.linspace(-1.0, 5.0, 25 if quick else 73)
    exact, maxima, newton = [], [], []
    for value in seen.tolist():
        found = density(value)
        inner = (found[1:-1] > found[:-2]) & (found[1:-1] > found[2:])
        exact.append(float(np.exp(GRID[np.argmax(found)])))
        maxima.append(float(inner.sum()))
        newton.append(newton_N(value))
    return {
        "seen": {
            "seen_N": seen,
            "brute_force_N": np.array(exact),
            "maxima": np.array(maxima),
            "theory_maxima": np.array([1.0 + bimodal(value) for value in seen.tolist()]),
            "newton_N": np.array(newton),
            "ours_N": map_force_N(seen, NOISE_N, median_N=MEDIAN_N, log_spread=SPREAD),
        }
    }


def judge(data: Data) -> Verdict:
    """Where Newton's method breaks or keeps the lower maximum, and how far ours is from brute force."""
    table = data["seen"]
    broken = ~np.isfinite(table["newton_N"])
    wrong = np.abs(table["newton_N"] / table["brute_force_N"] - 1.0) > 0.05
    wrong &= ~broken
    off = float(np.abs(table["ours_N"] / table["brute_force_N"] - 1.0).max())
    two = table["maxima"] == 2.0
    agree = bool((table["maxima"] == table["theory_maxima"]).all())
    between = table["seen_N"][two] if two.any() else np.array([np.nan])
    return Verdict(
        bool(broken[table["seen_N"] <= 0.0].all() and two.any() and wrong.any() and agree),
        off < 1e-3,  # the grid's spacing is 6e-4 of a force
        f"Between {between.min():.2f} and {between.max():.2f} N the posterior has two maxima, as in theory. "
        f"Newton's method from the observation gives no force in {int(broken.sum())} of {len(broken)} cases, among "
        f"them all at or below zero, and the lesser maximum in {int(wrong.sum())}; ours is the global one to {off:.0e} "
        "in all.",
    )


def ask() -> list[Answer]:
    """Observations that are none, priors that exclude what was seen, and a wide range at once."""
    rng = np.random.default_rng(2)
    seen, noise = rng.normal(0.0, 5.0, 2_000), 10.0 ** rng.uniform(-3.0, 1.0, 2_000)
    found = map_force_N(seen, noise)
    return [
        refused("an observation that is not a number", lambda: map_force_N(float("nan"), 0.1)),
        refused("a noise of zero", lambda: map_force_N(1.0, 0.0)),
        refused("50 N where the prior is 0.1 N to 10 %",
                lambda: require_prior_fits(50.0, 0.1, median_N=0.1, log_spread=0.1)),
        shown("2,000 observations of −20 to 20 N", bool((np.isfinite(found) & (found > 0.0)).all()),
              f"all positive, {found.min():.1e} to {found.max():.1f} N"),
    ]  # fmt: skip


def draw(data: Data, chart: "Figure") -> None:
    """Estimate over observation; the posterior where it has two maxima."""
    left, right = chart.subplots(1, 2)
    table = data["seen"]
    seen = table["seen_N"]
    region(left, Conduct.HOLDS, seen[0], seen[-1])
    two = seen[table["maxima"] == 2.0]
    if len(two):
        left.axvspan(
            two.min(), two.max(), facecolor="none", edgecolor="0.55", hatch="//", linewidth=0.0, label="two maxima"
        )
    left.plot(seen, table["brute_force_N"], color=GREY, label="brute force: greatest density")
    left.plot(seen, table["newton_N"], "s", color=RED, markersize=5, label="Newton from the observation")
    left.plot(seen[::2], table["ours_N"][::2], "o", color=BLUE, markersize=4, label="ours")
    left.plot(seen[~np.isfinite(table["newton_N"])], 0.0 * seen[~np.isfinite(table["newton_N"])], "x", color=RED,
              label="Newton: no force")  # fmt: skip
    finish(left, "observed force / N", "most probable force / N", xlim=seen[[0, -1]], legend="upper left")
    for share, colour in zip((0.25, 0.5, 0.75), (BLUE, RED, ORANGE), strict=True):
        value = float(two.min() + share * np.ptp(two)) if len(two) else 3.0
        log_density = density(value)
        right.plot(np.exp(GRID), log_density - log_density.max(), color=colour, label=f"observed {value:.2f} N")
    finish(right, "force / N", "log density, less its maximum", xlim=(0.0, 5.0), ylim=(-8.0, 0.5))


TWO_MAXIMA = Page(
    "two_maxima",
    "E7 · Has a log-normal prior times a Gaussian likelihood one maximum?",
    "A published estimate runs Newton's method on the posterior of a force. Where does that have two maxima, and what "
    "happens to observations at or below zero?",
    "Statement E7; prior median 0.1 N with log spread 0.3, noise 0.3 N; brute force over 20,001 forces",
    measure,
    judge,
    ask,
    draw,
)
