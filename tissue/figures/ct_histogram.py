"""How often each grey value of a CT occurs, with the threshold of bone and the density that the values stand for."""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tissue.figures.figure import figure, save, styled

__all__ = ["draw_ct_histogram"]

ALL, INSIDE, LEVEL = "0.6", "#E69F00", "#D55E00"
BINS = 160
RANGE_HU = (-1100.0, 2200.0)


@styled
def draw_ct_histogram(
    values: NDArray[np.int64],
    counts: NDArray[np.int64],
    inside: NDArray[np.number],
    path: Path,
    *,
    threshold: float | None,
    density: tuple[float, float] | None,
    title: str,
) -> None:
    """Draw the histogram to a file.

    Parameters
    ----------
    values, counts
        Each whole value of the image, and how many voxels have it.
    inside
        Values of the voxels of the bone.
    threshold
        Value above which a voxel is bone; None with a label.
    density
        Density per value and at value 0 [kg/m3]; None where it is unknown.
    """
    low, high = max(RANGE_HU[0], float(values[0])), min(RANGE_HU[1], float(values[-1]))
    edges = np.linspace(low, high, BINS)
    chart = figure(6.4, 3.4)
    axes = chart.add_axes((0.11, 0.16, 0.86, 0.62))
    axes.stairs(np.histogram(values, edges, weights=counts)[0], edges, color=ALL, fill=True, label="image")
    axes.stairs(np.histogram(inside, edges)[0], edges, color=INSIDE, linewidth=1.4, label="bone")
    if threshold is not None:
        axes.axvline(threshold, color=LEVEL, linestyle="--", label=f"threshold {threshold:g}")
    axes.set_yscale("log")
    axes.set(xlim=(low, high), ylim=(0.7, None), xlabel="grey value [HU]", ylabel="voxels")
    axes.spines["right"].set_visible(False)
    axes.legend(frameon=False, loc="upper right")
    if density is not None:
        slope, offset = density

        def to_density(x: ArrayLike) -> NDArray[np.float64]:
            return slope * np.asarray(x, dtype=np.float64) + offset

        def to_value(y: ArrayLike) -> NDArray[np.float64]:
            return (np.asarray(y, dtype=np.float64) - offset) / slope

        upper = axes.secondary_xaxis("top", functions=(to_density, to_value))
        upper.set_xlabel("apparent density of bone [kg/m³]")
        upper.set_xticks([ticks for ticks in range(0, 4000, 500) if offset <= ticks <= slope * high + offset])
    else:
        axes.set_xlabel("grey value")
        axes.spines["top"].set_visible(False)
    chart.suptitle(title, size=10, y=0.98)
    save(chart, path)
