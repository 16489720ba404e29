"""E14: weights of a composite index from raw metrics follow their units and signs; squared loadings do not."""

import numpy as np
from matplotlib.figure import Figure

from meshes.base.arrays import Array
from tissue.evaluation.atlas.drawing import BLUE, GREEN, GREY, ORANGE, PINK, RED, panel
from tissue.evaluation.atlas.page import Answer, Conduct, Data, Page, Verdict, refused, shown, sweep
from tissue.evaluation.statistics.hpi import composite_index
from tissue.evaluation.statistics.trials import TrialTable

__all__ = ["PAGE"]

METRICS = {"accuracy": 1, "force_error": -1, "position_error": -1, "time_s": -1}
"""What an index is made of, and whether higher is better."""
USERS, TRIALS = 24, 4
METHODS = ("plain", "better")


def table(scale: float) -> TrialTable:
    """A study in which people differ in skill, which all metrics share; position errors in a unit of 1 / scale mm."""
    rng = np.random.default_rng(3)
    rows = [(u, t, m) for u in range(USERS) for t in range(TRIALS) for m in range(len(METHODS))]
    skill = rng.normal(size=USERS)
    good = np.array([skill[u] + 0.5 * m + 0.5 * rng.normal() for u, _, m in rows])
    noise = rng.normal(size=(4, len(rows)))
    metrics = {
        "accuracy": 0.8 + 0.05 * good + 0.04 * noise[0],
        "force_error": 0.1 - 0.01 * good + 0.01 * noise[1],
        "position_error": scale * (0.8 - 0.1 * good + 0.08 * noise[2]),
        "time_s": 14.0 - 1.5 * good + 1.5 * noise[3],
    }
    labels = np.array([f"u{u}" for u, _, _ in rows])
    same = np.full(len(rows), "wall")
    return TrialTable(
        task=same, group=np.full(len(rows), "novice"), user=labels, trial=np.array([t for _, t, _ in rows]),
        method=np.array([METHODS[m] for _, _, m in rows]), seed=np.arange(len(rows)), failure=np.full(len(rows), ""),
        metrics=metrics,
    )  # fmt: skip


def printed_weights(study: TrialTable) -> Array:
    """First principal component of the raw metrics' covariance, as it comes, over its sum."""
    raw = np.column_stack([study.values(name) for name in METRICS])
    _, vectors = np.linalg.eigh(np.cov(raw.T))
    first = vectors[:, -1] * np.sign(vectors[0, -1])
    return np.asarray(first / np.abs(first).sum())


def weights(scale: float) -> dict[str, float]:
    """Weights of all metrics with one in another unit, raw and by squared loadings."""
    study = table(scale)
    index = composite_index(study, METRICS, rng=np.random.default_rng(0), count=50)
    printed = {f"printed_{name}": value for name, value in zip(METRICS, printed_weights(study), strict=True)}
    return printed | {f"ours_{name}": each.value for name, each in zip(METRICS, index.weights, strict=True)}


def measure(quick: bool) -> Data:
    """Weights over the unit of one metric."""
    scales = np.array([1e-3, 1.0, 1e3]) if quick else 10.0 ** np.arange(-3.0, 3.5, 1.0)
    return {"unit": sweep("units_per_mm", scales, weights)}


def judge(data: Data) -> Verdict:
    """How far the weights of both move with the unit, their signs and their sums."""
    unit = data["unit"]
    printed = np.column_stack([unit[f"printed_{name}"] for name in METRICS])
    ours = np.column_stack([unit[f"ours_{name}"] for name in METRICS])
    moves, drift = float(np.ptp(np.abs(printed), axis=0).max()), float(np.ptp(ours, axis=0).max())
    mixed = bool((printed.min(axis=1) < 0.0).all() and (printed.max(axis=1) > 0.0).all())
    whole = float(np.abs(ours.sum(axis=1) - 1.0).max())
    return Verdict(
        moves > 0.5 and mixed,
        drift < 1e-9 and whole < 1e-12 and bool((ours >= 0.0).all()),
        f"As position errors are given in µm instead of m, their raw weight moves by {100 * moves:.0f} % and the signs "
        f"are mixed; oriented, standardised and squared, all weights are positive, sum to 1 to {whole:.0e} and move by "
        f"{drift:.0e}: "
        + ", ".join(f"{name} {value:.2f}" for name, value in zip(METRICS, ours[0].tolist(), strict=True))
        + ".",
    )


def ask() -> list[Answer]:
    """Directions that are none, metrics that never vary, and metrics that disagree."""
    study, rng = table(1.0), np.random.default_rng(0)
    flat = table(0.0)
    against = composite_index(study, METRICS | {"accuracy": -1}, rng=rng, count=50)
    return [
        refused("a direction of 0", lambda: composite_index(study, METRICS | {"time_s": 0}, rng=rng, count=50)),
        refused("an index of one metric", lambda: composite_index(study, {"time_s": -1}, rng=rng, count=50)),
        refused("a metric that is constant", lambda: composite_index(flat, METRICS, rng=rng, count=50)),
        shown("accuracy called lower-is-better", any(not each.holds for each in against.assumptions),
              "reported: " + "; ".join(each.finding for each in against.assumptions if not each.holds),
              conduct=Conduct.FALLS_BACK),
    ]  # fmt: skip


def draw(data: Data, chart: Figure) -> None:
    """Weights over the unit, raw and ours."""
    left, right = chart.subplots(1, 2, sharey=True)
    unit, label = data["unit"], "units of position error per mm"
    looks = dict(zip(METRICS, (("o-", BLUE), ("^-", ORANGE), ("s-", RED), ("D-", GREEN)), strict=True))
    printed, ours = (
        [(name.replace("_", " ").removesuffix(" s"), unit[f"{kind}_{name}"], *look) for name, look in looks.items()]
        for kind in ("printed", "ours")
    )
    panel(left, unit["units_per_mm"], label, "weight in the index", [*printed, ("_", 0.0, "-", PINK)], log="x",
          conduct=(), title="raw (printed)", ylim=(-1.1, 1.1))  # fmt: skip
    panel(right, unit["units_per_mm"], label, "", [*ours, ("theory of equally good metrics: ¼", 0.25, ":", GREY)],
          log="x", title="oriented, standardised, squared (ours)")  # fmt: skip


PAGE = Page(
    "index_weights",
    "E14 · What do weights from a principal component of raw metrics mean?",
    "A published index takes its weights from PCA on metrics with mixed signs and units. What becomes of them when one "
    "metric is given in other units?",
    "Statement E14; simulated study of 24 people in which all metrics share a skill",
    measure,
    judge,
    ask,
    draw,
)
