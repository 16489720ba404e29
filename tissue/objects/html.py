"""HTML of tables, runs and scenes for notebooks."""

from collections.abc import Iterable, Sequence
from html import escape

import numpy as np

from meshes.base.arrays import Array
from tissue.models.tissue_model import TICK_S
from tissue.show.figures.force_time import event_lines
from tissue.show.report.page import run_rows
from tissue.simulation.run import load_figures
from tissue.simulation.run_folder import Summary
from tissue.simulation.trace import Table


def table_html(
    rows: Iterable[Sequence[object]],
    *,
    titles: Sequence[str] = (),
    caption: str = "",
    numbers: bool = False,
) -> str:
    """Return an HTML table; with ``numbers``, the cells are aligned to the right."""
    side = "right" if numbers else "left"
    head = f"<caption>{escape(caption)}</caption>" if caption else ""
    if titles:
        head += f"<thead><tr>{_cells(titles, 'th', side)}</tr></thead>"
    body = "".join(f"<tr>{_cells(row, 'td', side)}</tr>" for row in rows)
    return f"<table>{head}<tbody>{body}</tbody></table>"


def curve(values: Sequence[float], *, title: str) -> str:
    """Return HTML of the values as a small curve without axes, with a vertical range from zero."""
    top = max(*values, 0.0) or 1.0
    step = 320.0 / max(len(values) - 1, 1)
    # One pixel is left above and below for the width of the line.
    points = " ".join(
        f"{step * i:.1f},{47.0 - 46.0 * value / top:.1f}" for i, value in enumerate(values)
    )
    line = f'<polyline points="{points}" fill="none" stroke="currentColor" stroke-width="1.2"/>'
    return f'<svg width="320" height="48" role="img"><title>{escape(title)}</title>{line}</svg>'


def folded(title: str, inner: str, *, is_open: bool = False) -> str:
    """Return an HTML section that expands and collapses when its title is clicked."""
    return (
        f"<details{' open' if is_open else ''}><summary>{escape(title)}</summary>{inner}</details>"
    )


def scrolled(inner: str) -> str:
    """Wrap HTML in an element that scrolls horizontally if it is wider than the page."""
    return f'<div style="overflow-x: auto">{inner}</div>'


def _cells(row: Sequence[object], name: str, side: str) -> str:
    wrapped = "; white-space: nowrap" * (side == "right")
    style = f' style="text-align: {side}{wrapped}"'
    return "".join(f"<{name}{style}>{escape(str(each))}</{name}>" for each in row)


CURVE_POINTS = 300
"""Largest number of points of the small force curve, which is 320 pixels wide."""


def run_line(summary: Summary) -> list[str]:
    """Return the most important results of a run as the cells of a table row."""
    name = str(summary.get("scene"))
    if summary["status"] != "complete":
        return [name, str(summary["status"])]
    cut = [f"{sum(summary['removed_mm3'].values()):.3g} mm³ removed"] if summary["cuts"] else []
    return [
        name,
        f"{summary['simulated_s']:g} s",
        f"peak force {summary['force_N']['peak']:.3g} N",
        *cut,
    ]


BANDED = {
    "peak_force_N": ("force_N", "peak"),
    "mean_force_N": ("force_N", "mean_in_contact"),
    "peak_torque_Nm": ("torque_Nm", "peak"),
    "mean_torque_Nm": ("torque_Nm", "mean_in_contact"),
}
"""Keys (load, statistic) of a value in a summary and in its band, keyed by the value's name."""


def figures_of_trace(trace: Table) -> dict[str, float]:
    """Return summary values of a run that ended early, keyed by names with units.

    The values are the simulated time and the peak and mean loads in the trace. The trace may have
    no rows.
    """
    if not len(trace.rows):
        return {}
    loads = load_figures(trace)
    return {
        "simulated_s": len(trace.rows) * TICK_S,
        **{name: loads[load][figure] for name, (load, figure) in BANDED.items()},
    }


def figures_of(summary: Summary) -> dict[str, float]:
    """Return the summary values of a complete run, keyed by names with units."""
    if summary["status"] != "complete":
        return {}
    tick = summary["tick_us"]
    removed = summary["removed_mm3"] if summary["cuts"] else {}
    rise = summary.get("largest_rise")
    return {
        "simulated_s": summary["simulated_s"],
        **{name: summary[load][figure] for name, (load, figure) in BANDED.items()},
        **({"removed_mm3": sum(removed.values())} if removed else {}),
        **(
            {f"removed_{layer}_mm3": volume for layer, volume in removed.items()}
            if len(removed) > 1
            else {}
        ),
        **{
            f"least_distance_{name}_mm": each["least_distance_mm"]
            for name, each in summary.get("keep_clear", {}).items()
        },
        # Only a run with a margin has these times.
        **{
            f"below_margin_{name}_s": each["below_margin_s"]
            for name, each in summary.get("keep_clear", {}).items()
            if "below_margin_s" in each
        },
        **({f"largest_rise_{rise['tissue']}_K": rise["rise_K"]} if rise else {}),
        # Forces and distances of the run do not count after this time.
        **({"left_region_s": summary["left_region_s"]} if "left_region_s" in summary else {}),
        "events": len(summary["events"]),
        "tick_median_us": tick["median"],
        "tick_99_percent_us": tick["p99"],
        "missed_deadlines": summary["missed_deadlines"],
    }


def intervals_of(summary: Summary) -> dict[str, tuple[float, float]]:
    """Return the 90 % intervals of summary values, keyed by names with units.

    The result is empty for a run without an uncertainty band.
    """
    band = summary.get("band")
    if band is None:
        return {}
    found = {name: band[load][figure] for name, (load, figure) in BANDED.items()}
    return {name: (each["p05"], each["p95"]) for name, each in found.items()}


def run_html(summary: Summary, events: list[tuple[float, str]], force_N: Array) -> str:
    """Return HTML of a run: a table, the force curve, and collapsible lists of events and notes."""
    shown = table_html(run_rows(summary), caption=f"run of {summary.get('scene')}")
    if len(force_N):
        every = max(len(force_N) // CURVE_POINTS, 1)
        # The largest value of each group is drawn, so no peak is lost.
        highest = np.maximum.reduceat(force_N, np.arange(0, len(force_N), every))
        shown += curve(highest.tolist(), title=f"force over time, up to {force_N.max():.3g} N")
    if events:
        shown += folded(
            "events", table_html([(line,) for line in event_lines(events)]), is_open=True
        )
    if notes := summary.get("notes"):
        shown += folded("notes", table_html(notes.items()))
    return f"<div>{shown}</div>"
