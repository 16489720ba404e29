"""Pictures of a fit: measured and simulated loads, residuals, constants before and after."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tissue.figures.figure import figure, plain, save
from tissue.figures.style import COMPONENTS

__all__ = ["FittedConstant", "draw_constants", "draw_measured", "draw_residuals"]

Array = NDArray[np.float64]

MEASURED, SIMULATED, PRIOR = "0.55", "#0072B2", "0.75"
ROW, FRAME = 0.44, 1.0
"""Height of a constant's row, and of what is around the rows [in]."""


@dataclass(frozen=True)
class FittedConstant:
    """A constant before and after a fit, for a picture.

    Attributes
    ----------
    label
        Its name without unit.
    unit
        Its unit.
    cited, fitted
        Median and the ends of the 90 % interval, (low, value, high), before and after.
    fitted_z, cited_z
        The fitted three, and the ends of the cited range, in standard deviations of the prior.
    is_identified
        Whether the log narrows it.
    """

    label: str
    unit: str
    cited: tuple[float, float, float]
    fitted: tuple[float, float, float]
    fitted_z: tuple[float, float, float]
    cited_z: tuple[float, float]
    is_identified: bool


def draw_measured(times_s: Array, measured: Array, simulated: Array, channels: Sequence[str], path: Path) -> None:
    """Draw measured and simulated loads over time, forces and torques apart, and below each what is left.

    Parameters
    ----------
    times_s
        Times [s], shape (n,).
    measured, simulated
        Loads, shape (n, channels); NaN where nothing was measured.
    channels
        Names with units, such as ``force_x_N``.
    path
        File to write.
    """
    whats = list(dict.fromkeys(name.partition("_")[0] for name in channels))
    groups = [(what, [at for at, name in enumerate(channels) if name.startswith(f"{what}_")]) for what in whats]
    chart = figure(8.0, 0.9 + 2.9 * len(groups))
    rows = 2 * len(groups)
    panels = chart.subplots(rows, 1, sharex=True, height_ratios=(2.0, 1.0) * len(groups), squeeze=False)[:, 0]
    chart.subplots_adjust(left=0.11, right=0.98, top=0.93, bottom=0.5 / (0.9 + 2.9 * len(groups)), hspace=0.22)
    for (what, places), loads, rest in zip(groups, panels[::2], panels[1::2], strict=True):
        unit = channels[places[0]].rpartition("_")[2]
        shown = "N m" if unit == "Nm" else unit
        for colour, at in zip(_colours(len(places)), places, strict=True):
            axis = channels[at].removesuffix(f"_{unit}").rpartition("_")[2]
            loads.plot(times_s, measured[:, at], color=MEASURED, linewidth=2.2, zorder=1)
            loads.plot(times_s, simulated[:, at], color=colour, linewidth=1.1, label=axis, zorder=2)
            rest.plot(times_s, measured[:, at] - simulated[:, at], color=colour, linewidth=0.8)
        loads.plot([], [], color=MEASURED, linewidth=2.2, label="measured")
        loads.set_ylabel(f"{what} / {shown}")
        rest.set_ylabel(f"residual / {shown}")
    panels[0].legend(frameon=False, ncols=4, loc="lower left", bbox_to_anchor=(0.0, 0.98))
    panels[-1].set_xlabel("time / s")
    plain(panels)
    save(chart, path)


def draw_residuals(innovations: Array, correlations: Array, freedom: float, path: Path) -> None:
    """Draw the spread of what noise adds in each sample beside the density assumed, and how it is correlated.

    Parameters
    ----------
    innovations
        Standardised, shape (n, channels), NaN where nothing was measured.
    correlations
        Autocorrelation of residuals and of innovations over lags, each the mean over channels, shape (2, lags + 1).
    freedom
        Degrees of freedom of the assumed Student's t.
    path
        File to write.
    """
    from scipy.stats import t

    chart = figure(8.0, 3.2)
    spread, over = chart.subplots(1, 2)
    chart.subplots_adjust(left=0.09, right=0.98, top=0.9, bottom=0.18, wspace=0.28)
    known = innovations[np.isfinite(innovations)]
    at = np.linspace(-6.0, 6.0, 121)
    spread.hist(np.clip(known, -6.0, 6.0), bins=60, range=(-6.0, 6.0), density=True, color="0.8")
    spread.plot(at, t.pdf(at, freedom), color=SIMULATED, label=f"Student's t, {freedom:.3g} degrees of freedom")
    spread.set(xlabel="noise added in a sample / its scale", ylabel="density", yscale="log", ylim=(1e-4, 1.0))
    spread.legend(frameon=False, loc="upper left", bbox_to_anchor=(0.0, 1.14))
    lags = np.arange(correlations.shape[1])
    over.axhspan(*np.array([-1.96, 1.96]) / np.sqrt(max(len(innovations), 1)), color="0.9", label="95 % of white noise")
    over.plot(lags, correlations[0], color=MEASURED, label="residual")
    over.plot(lags, correlations[1], color=SIMULATED, label="after the noise model")
    over.set(xlabel="lag / samples", ylabel="autocorrelation")
    over.legend(frameon=False)
    plain((spread, over))
    save(chart, path)


def draw_constants(constants: Sequence[FittedConstant], path: Path) -> None:
    """Draw the 90 % intervals of constants before and after, on the scale of their cited range, with their values."""
    height = FRAME + ROW * len(constants)
    chart = figure(8.0, height)
    axes = chart.subplots()
    chart.subplots_adjust(left=0.34, right=0.7, top=1.0 - 0.4 / height, bottom=0.55 / height)
    for row, one in enumerate(constants):
        least, most = one.cited_z
        axes.barh(row, most - least, left=least, height=0.7, color=PRIOR, linewidth=0.0)
        low, middle, high = one.fitted_z
        colour = SIMULATED if one.is_identified else "0.45"
        axes.plot([low, high], [row, row], color=colour, linewidth=3.2, solid_capstyle="butt")
        axes.plot(middle, row, "o", color=colour, markersize=5.0)
        cited, found = (f"{value:.3g} ({least:.3g} to {most:.3g})" for least, value, most in (one.cited, one.fitted))
        across = axes.get_yaxis_transform()
        result = f"{found} {one.unit}" if one.is_identified else "not narrowed by this log"
        axes.text(1.03, row - 0.2, result, transform=across, va="center", fontsize=8.0, color=colour)
        axes.text(
            1.03, row + 0.22, f"cited {cited} {one.unit}", transform=across, va="center", fontsize=7.5, color="0.45"
        )
    axes.barh(0, 0, color=PRIOR, label="cited")
    axes.plot([], [], "o-", color=SIMULATED, linewidth=3.2, label="fitted")
    axes.legend(frameon=False, ncols=2, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    axes.set_yticks(range(len(constants)), [one.label for one in constants])
    axes.set_ylim(len(constants) - 0.4, -0.6)
    axes.set_xlim(*_ends(constants))
    axes.set_xlabel("standard deviations of the cited range")
    axes.spines[["top", "right"]].set_visible(False)
    save(chart, path)


def _ends(constants: Sequence[FittedConstant]) -> tuple[float, float]:
    reach = [2.2, *(abs(z) for one in constants for z in one.fitted_z)]
    return -1.05 * max(reach), 1.05 * max(reach)


def _colours(count: int) -> tuple[str, ...]:
    return COMPONENTS[:count] if count > 1 else (SIMULATED,)
