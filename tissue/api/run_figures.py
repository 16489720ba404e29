"""Figures of a run as a line, as rows and as HTML."""

import numpy as np
from numpy.typing import NDArray

from tissue.api.html import curve, folded, table_html
from tissue.figures.events import event_lines
from tissue.simulation.run_summary import Summary

__all__ = ["figures_of", "run_html", "run_line", "run_rows"]

CURVE_POINTS = 300
"""Points of the small curve of the force."""


def run_line(summary: Summary) -> list[str]:
    """The most important figures, in a few words each."""
    name = str(summary.get("scene"))
    if summary["status"] != "complete":
        return [name, str(summary["status"])]
    cut = [f"{sum(summary['removed_mm3'].values()):.3g} mm³ removed"] if summary["cuts"] else []
    return [name, f"{summary['simulated_s']:g} s", f"peak force {summary['force_N']['peak']:.3g} N", *cut]


def run_rows(summary: Summary) -> list[tuple[str, str]]:
    """Figures and their values in words; of a run that did not come to its end only what ended it."""
    if summary["status"] != "complete":
        problem = summary.get("problem")
        return [("status", str(summary["status"])), *([("what ended it", str(problem))] if problem else [])]
    force, torque, tick = summary["force_N"], summary["torque_Nm"], summary["tick_us"]
    rows = [("simulated", f"{summary['simulated_s']:g} s")]
    if summary["cuts"]:
        rows += [
            (f"removed {layer}", f"{removed:.3g} of {summary['start_mm3'][layer]:.4g} mm³")
            for layer, removed in summary["removed_mm3"].items()
        ]
    return [
        *rows,
        ("force, peak / mean in contact", f"{force['peak']:.3g} / {force['mean_in_contact']:.3g} N"),
        ("torque, peak / mean in contact", f"{torque['peak']:.3g} / {torque['mean_in_contact']:.3g} N m"),
        ("tick, median / 99 %", f"{tick['median']:.0f} / {tick['p99']:.0f} µs"),
        ("missed 1 ms deadlines", f"{summary['missed_deadlines']} of {summary['simulated_s'] * 1e3:.0f}"),
    ]


def figures_of(summary: Summary) -> dict[str, float]:
    """Numbers of a run that came to its end, by names with units; none of another one."""
    if summary["status"] != "complete":
        return {}
    force, torque, tick = summary["force_N"], summary["torque_Nm"], summary["tick_us"]
    removed = summary["removed_mm3"] if summary["cuts"] else {}
    return {
        "simulated_s": summary["simulated_s"],
        "peak_force_N": force["peak"],
        "mean_force_N": force["mean_in_contact"],
        "peak_torque_Nm": torque["peak"],
        "mean_torque_Nm": torque["mean_in_contact"],
        **({"removed_mm3": sum(removed.values())} if removed else {}),
        **({f"removed_{layer}_mm3": volume for layer, volume in removed.items()} if len(removed) > 1 else {}),
        "events": len(summary["events"]),
        "tick_median_us": tick["median"],
        "tick_99_percent_us": tick["p99"],
        "missed_deadlines": summary["missed_deadlines"],
    }


def run_html(summary: Summary, events: list[tuple[float, str]], force_N: NDArray[np.float64]) -> str:
    """A short table and the size of the force over time, with events and notes folded below."""
    shown = table_html(run_rows(summary), caption=f"run of {summary.get('scene')}")
    if len(force_N):
        every = max(len(force_N) // CURVE_POINTS, 1)
        highest = np.maximum.reduceat(force_N, np.arange(0, len(force_N), every))
        shown += curve(highest.tolist(), title=f"force over time, up to {force_N.max():.3g} N")
    if events:
        shown += folded("events", table_html([(line,) for line in event_lines(events)]), is_open=True)
    if notes := summary.get("notes"):
        shown += folded("notes", table_html(notes.items()))
    return f"<div>{shown}</div>"
