"""E7: the posterior of a force can have two maxima, and Newton's method from an observation of zero or less breaks."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, error_of, refused, shown, sweep
from tissue.perception.estimate import log_posterior, map_force_N, require_prior_fits

__all__ = ["PAGE"]

MEDIAN_N, SPREAD, NOISE_N = 0.1, 0.3, 0.3
GRID = np.linspace(np.log(1e-4), np.log(20.0), 20_001)
"""Logarithms of forces among which the greatest density is looked for by brute force."""


def density(seen: float) -> Array:
    """Logarithm of the posterior density on the grid."""
    given = np.array([seen, NOISE_N, np.log(MEDIAN_N), SPREAD])
    return np.asarray(log_posterior(GRID, *given[:, None]))


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


def estimates(seen: float) -> dict[str, float]:
    """Estimate by brute force and by Newton's method, and maxima that there are and that theory has."""
    found = density(seen)
    inner = (found[1:-1] > found[:-2]) & (found[1:-1] > found[2:])
    return {
        "brute_force_N": np.exp(GRID[np.argmax(found)]),
        "maxima": inner.sum(),
        "theory_maxima": 1.0 + bimodal(seen),
        "newton_N": newton_N(seen),
    }


def measure(quick: bool) -> Data:
    """Estimates over the observation: brute force, Newton from the observation, and ours."""
    seen = np.linspace(-1.0, 5.0, 25 if quick else 73)
    ours = map_force_N(seen, NOISE_N, median_N=MEDIAN_N, log_spread=SPREAD)
    return {"seen": sweep("seen_N", seen, estimates) | {"ours_N": ours}}


def judge(data: Data) -> Verdict:
    """Where Newton's method breaks or keeps the lower maximum, and how far ours is from brute force."""
    table = data["seen"]
    broken = ~np.isfinite(table["newton_N"])
    wrong = ~broken & (np.abs(table["newton_N"] / table["brute_force_N"] - 1.0) > 0.05)
    off = error_of(table["ours_N"], table["brute_force_N"])
    between = table["seen_N"][table["maxima"] == 2.0]
    agree = bool((table["maxima"] == table["theory_maxima"]).all())
    low, high = between.min(initial=np.inf), between.max(initial=-np.inf)
    return Verdict(
        bool(broken[table["seen_N"] <= 0.0].all() and len(between) and wrong.any() and agree),
        off < 1e-3,  # the grid's spacing is 6e-4 of a force
        f"Between {low:.2f} and {high:.2f} N the posterior has two maxima, as in theory. "
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


def draw(data: Data, chart: Figure) -> None:
    """Estimate over observation; the posterior where it has two maxima."""
    left, right = chart.subplots(1, 2)
    table = data["seen"]
    seen, two = table["seen_N"], table["seen_N"][table["maxima"] == 2.0]
    left.axvspan(two.min(), two.max(), facecolor="none", edgecolor="0.55", hatch="//", linewidth=0.0,
                 label="two maxima")  # fmt: skip
    panel(left, seen, "observed force / N", "most probable force / N", [
        ("brute force: greatest density", table["brute_force_N"], "-", GREY),
        ("Newton from the observation", table["newton_N"], "s", RED),
        ("ours", np.where(np.arange(len(seen)) % 2 == 0, table["ours_N"], np.nan), "o", BLUE),
        ("Newton: no force", np.where(np.isfinite(table["newton_N"]), np.nan, 0.0), "x", RED),
    ], log="", legend="upper left")  # fmt: skip
    observed = two.min() + np.array([0.25, 0.5, 0.75]) * np.ptp(two)
    curves = [(f"observed {value:.2f} N", density(value), "-", colour)
              for value, colour in zip(observed.tolist(), (BLUE, RED, ORANGE), strict=True)]  # fmt: skip
    panel(right, np.exp(GRID), "force / N", "log density, less its maximum",
          [(label, log_density - log_density.max(), style, colour) for label, log_density, style, colour in curves],
          log="", conduct=(), xlim=(0.0, 5.0), ylim=(-8.0, 0.5))  # fmt: skip


PAGE = Page(
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
