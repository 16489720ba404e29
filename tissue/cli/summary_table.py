"""The table that a person reads after a run."""

from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from tissue.simulation.run_summary import Summary

__all__ = ["print_summary"]


def print_summary(console: Console, summary: "Summary", folder: Path, *, wall_s: float, saving_s: float) -> None:
    """The table a person reads after a run."""
    table = Table(title=f"{summary['scene']}: {summary['simulated_s']:g} s simulated in {wall_s:.1f} s")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    for layer, removed in summary["removed_mm3"].items() if summary["cuts"] else ():
        table.add_row(f"removed {layer}", f"{removed:.2f} of {summary['start_mm3'][layer]:.1f} mm³")
    table.add_row("force, peak / mean in contact", _pair(summary["force_N"], "N"))
    table.add_row("torque, peak / mean in contact", _pair(summary["torque_Nm"], "N·m"))
    tick = summary["tick_us"]
    table.add_row("tick, median / 99 % / max", f"{tick['median']:.0f} / {tick['p99']:.0f} / {tick['max']:.0f} µs")
    table.add_row("missed 1 ms deadlines", f"{summary['missed_deadlines']} of {summary['simulated_s'] * 1e3:.0f}")
    if "late_us" in summary:
        late = summary["late_us"]
        table.add_row(
            "delay of ticks, median / 99 % / max", f"{late['median']:.0f} / {late['p99']:.0f} / {late['max']:.0f} µs"
        )
        table.add_row("wall clock skipped", f"{summary['skipped_ms']:.1f} ms")
    table.add_row("writing files and pictures", f"{saving_s:.1f} s")
    console.print(table)
    for event in summary["events"]:
        console.print(f"at {event['time_s']:.3f} s: {event['what']}")
    for name, note in summary["notes"].items():
        console.print(f"{name}: {note}")
    console.print(f"files in {folder}")


def _pair(figures: dict[str, float], unit: str) -> str:
    return f"{figures['peak']:.3g} / {figures['mean_in_contact']:.3g} {unit}"
