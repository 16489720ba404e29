"""Picture of `chart_liver.py`: error over cost with named frontiers.

It also shows where the linear law stops being enough.
"""

from pathlib import Path

import numpy as np
from linear_limits import LinearLimits

from tissue.fem.hyperelastic import Law

__all__ = ["SHARES", "Point", "draw", "frontier"]

SHARES = (0.01, 0.05, 0.10)
COLOURS = {
    "linear": "#0072B2",
    "corotational": "#E69F00",
    "neo-Hookean": "#000000",
    "linear, 1 kHz": "#56B4E9",
    "factor": "#000000",
    "multigrid": "#E69F00",
    "condensed": "#0072B2",
    "reduced": "#CC79A7",
}
MARKERS = {
    "linear": "o",
    "corotational": "^",
    "neo-Hookean": "s",
    "linear, 1 kHz": "D",
    "factor": "s",
    "multigrid": "^",
    "condensed": "o",
    "reduced": "v",
}
Point = tuple[str, str, float, float]
"""Kind, name, cost [s], error."""


def frontier(points: list[Point]) -> list[Point]:
    """Points that no other beats in both cost and error, by rising cost."""
    best, kept = np.inf, []
    for point in sorted(points, key=lambda p: (p[2], p[3])):
        if point[3] < best:
            kept.append(point)
            best = point[3]
    return kept


def draw(
    panels: list[tuple[str, str, list[Point], float]], judged: dict[str, LinearLimits], out: Path
) -> None:
    """Error over cost with named frontiers, and the linear law's error over depth."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    pyplot.rcParams.update({"font.size": 13})
    figure, axes = pyplot.subplots(1, 3, figsize=(22, 8), layout="constrained")
    for axis, (title, label, points, resolution) in zip(axes, panels, strict=False):
        drawn = [p for p in points if np.isfinite(p[3])]
        for kind in dict.fromkeys(p[0] for p in drawn):
            chosen = [(1e3 * p[2], 100.0 * max(p[3], 1e-10)) for p in drawn if p[0] == kind]
            axis.scatter(
                *zip(*chosen, strict=True),
                color=COLOURS[kind],
                marker=MARKERS[kind],
                s=90,
                label=kind,
                zorder=3,
            )
        best = frontier(drawn)
        axis.plot(
            [1e3 * p[2] for p in best],
            [100.0 * max(p[3], 1e-10) for p in best],
            color="0.6",
            zorder=1,
        )
        for point in best:
            axis.annotate(
                point[1],
                (1e3 * point[2], 100.0 * max(point[3], 1e-10)),
                textcoords="offset points",
                xytext=(10, -5),
                fontsize=12,
            )
        if resolution > 0.0:
            axis.axhspan(30.0 * resolution, 100.0 * resolution, color="0.9", zorder=0)
            axis.text(
                0.98,
                100.0 * resolution,
                "reference uncertain below ",
                ha="right",
                va="bottom",
                color="0.4",
                transform=axis.get_yaxis_transform(),
            )
        axis.axvline(1.0, color="0.5", linestyle="--")
        axis.text(1.0, 0.02, " 1 ms", color="0.4", transform=axis.get_xaxis_transform())
        axis.set(xscale="log", yscale="log", xlabel="cost / ms", ylabel=label, title=title)
        axis.margins(x=0.15, y=0.1)
        axis.grid(alpha=0.3)
        axis.legend(loc="best", fontsize=12)
    axis = axes[2]
    styles = dict(
        zip(judged, ("#0072B2", "#E69F00", "#000000", "#CC79A7", "#009E73"), strict=False)
    )
    for (name, found), marker in zip(judged.items(), "osD^v", strict=False):
        error = 100.0 * np.abs(found.error(Law.LINEAR))
        axis.plot(
            1e3 * found.depth_m,
            np.maximum(error, 0.02),
            color=styles[name],
            marker=marker,
            markersize=8,
            label=name,
        )
    for share in SHARES:
        axis.axhline(100.0 * share, color="0.6", linestyle="--", zorder=0)
        axis.text(
            0.01,
            100.0 * share,
            f"{share:.0%}",
            va="bottom",
            color="0.4",
            transform=axis.get_yaxis_transform(),
        )
    ticks_mm = (0.25, 0.5, 1, 2, 4, 8)
    axis.set(
        xscale="log",
        yscale="log",
        xlabel="depth of a 10 mm sphere / mm",
        ylabel="linear force, error to neo-Hookean / %",
        title="where linear stops being enough",
    )
    axis.set_xticks(ticks_mm, [f"{tick:g}" for tick in ticks_mm])
    axis.minorticks_off()
    axis.grid(alpha=0.3)
    axis.legend(fontsize=12)
    figure.savefig(out, dpi=100)
    print("picture in", out)
