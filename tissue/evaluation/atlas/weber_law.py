"""E6: a Gaussian Weber fraction gives negative thresholds, and none at zero force; ours are positive everywhere."""

import numpy as np
from matplotlib.figure import Figure
from scipy.special import ndtr

from tissue.evaluation.atlas.drawing import BLUE, GREY, ORANGE, RED, panel
from tissue.evaluation.atlas.page import Answer, Data, Page, Verdict, refused, shown
from tissue.perception.laws import Weber, weber
from tissue.perception.observer import Observer
from tissue.perception.perceived import held_back

__all__ = ["PAGE"]

KAPPA, DRAWS = 0.07, 20_000
LOW_N, LOW_SHARES = 0.5, (0.10, 0.28)
"""Below half a newton thresholds of 10 to 28 % were measured."""


def measure(quick: bool) -> Data:
    """Share of negative thresholds over the scatter of people; threshold over force by both laws."""
    rng = np.random.default_rng(4)
    scatter = np.array([0.3, 0.8] if quick else [0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5])
    negative = [float((rng.normal(KAPPA, t * KAPPA, DRAWS) < 0.0).mean()) for t in scatter.tolist()]
    ours = []
    for t in scatter.tolist():
        spread = float(np.sqrt(np.log1p(t * t)))  # of a log-normal with this coefficient of variation
        person = Observer.known("someone", alpha=1.0, beta=1.7, kappa=KAPPA, offset_N=0.2, lapse=0.02, sigma=0.2,
                                spread={"kappa": spread, "offset_N": spread})  # fmt: skip
        drawn = person.draws(DRAWS, rng)
        ours.append(float((drawn["kappa"] * drawn["offset_N"] <= 0.0).mean()))
    forces, law = np.geomspace(0.01, 20.0, 12 if quick else 25), weber("force")
    return {
        "negative": {
            "scatter_over_kappa": scatter,
            "printed_share": np.array(negative),
            "theory_share": ndtr(-1.0 / scatter),
            "ours_share": np.array(ours),
        },
        "threshold": {
            "force_N": forces,
            "printed_share": np.full(len(forces), KAPPA),
            "ours_share": law.threshold(forces) / forces,
            "theory_share": law.kappa * (1.0 + law.offset / forces),
        },
    }


def judge(data: Data) -> Verdict:
    """Negative draws against the normal law; thresholds at low force against the published range."""
    negative, threshold = data["negative"], data["threshold"]
    force, theory = threshold["force_N"], negative["theory_share"]
    inside = threshold["ours_share"][(force > 0.1) & (force < LOW_N)]
    # Three standard errors of a share of 20,000 draws.
    error = 3.0 * np.sqrt(theory / DRAWS) + 1e-4
    expected = bool((np.abs(negative["printed_share"] - theory) < error).all())
    held = bool((negative["ours_share"] == 0.0).all() and inside.min() >= LOW_SHARES[0] - 0.01 and inside.max() < 0.3)
    return Verdict(
        expected and negative["printed_share"].max() > 0.05 and LOW_SHARES[0] > KAPPA,
        held,
        f"With people scattering by {negative['scatter_over_kappa'].max():g} of κ, "
        f"{100 * negative['printed_share'].max():.0f} % of the printed thresholds are negative (normal law "
        f"{100 * theory.max():.0f} %), of ours none. Between 0.1 and 0.5 N ours are "
        f"{100 * inside.min():.0f} to {100 * inside.max():.0f} % where 10 to 28 % were measured and κF predicts "
        f"{100 * KAPPA:.0f} %.",
    )


def ask() -> list[Answer]:
    """Impossible laws and levels, and a deadband at no force."""
    law = weber("force")
    quiet = np.random.default_rng(1).normal(0.0, 2e-3, (500, 3))
    _, changes = held_back(quiet, law)
    return [
        refused("a fraction of −7 %", lambda: Weber(kappa=-0.07, offset=0.2)),
        refused("a law without its low-force term", lambda: Weber(kappa=0.07, offset=0.0)),
        refused("the threshold at −1 N", lambda: law.threshold(-1.0)),
        shown("noise of 2 mN about no force, 500 ticks", int(changes[1:].sum()) == 0,
              f"{int(changes[1:].sum())} changes are played; it is {1e3 * float(law.threshold(0.0)):.0f} mN"),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Share of negative thresholds; threshold over force."""
    left, right = chart.subplots(1, 2)
    negative, threshold = data["negative"], data["threshold"]
    panel(left, negative["scatter_over_kappa"], "scatter of people τ / κ", "thresholds that are negative / %", [
        ("theory: Φ(−κ/τ)", 100.0 * negative["theory_share"], "-", GREY),
        ("printed: N(κ, τ²), drawn", 100.0 * negative["printed_share"], "s", RED),
        ("ours: log-normal, drawn", 100.0 * negative["ours_share"], "o", BLUE),
    ], log="")  # fmt: skip
    right.fill_between([0.1, LOW_N], *(100.0 * share for share in LOW_SHARES), color=ORANGE, alpha=0.4, zorder=1,
                       label="published: 10–28 % below 0.5 N")  # fmt: skip
    panel(right, threshold["force_N"], "force / N", "threshold / force / %", [
        ("theory: κ(1 + F0/F)", 100.0 * threshold["theory_share"], "-", GREY),
        ("printed: κ", 100.0 * threshold["printed_share"], "--", RED),
        ("ours", 100.0 * threshold["ours_share"], "o", BLUE),
    ])  # fmt: skip


PAGE = Page(
    "weber_law",
    "E6 · Is the threshold ΔF/F normal about κ?",
    "A published model draws Weber fractions from N(κ, τ²). How many thresholds are negative, and what does the law "
    "predict for weak forces?",
    "Statement E6; κ = 7 % of Pang et al. (1991), 10 to 28 % below half a newton, F0 from the engine's data file",
    measure,
    judge,
    ask,
    draw,
)
