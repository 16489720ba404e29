"""The table that `tissue run` prints of a run that has ended."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from tissue.cli.terminal import console

if TYPE_CHECKING:
    from tissue.simulation.run_summary import Summary

__all__ = ["print_summary"]


def print_summary(summary: "Summary", folder: Path, *, wall_s: float, saving_s: float) -> None:
    """The table a person reads after a run."""
    from rich.table import Table

    table = Table(title=f"{summary['scene']}: {summary['simulated_s']:g} s simulated in {wall_s:.1f} s")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    for layer, removed in summary["removed_mm3"].items() if summary["cuts"] else ():
        table.add_row(f"removed {layer}", f"{removed:.2f} of {summary['start_mm3'][layer]:.1f} mm³")
    band = summary.get("band")
    for name, key, unit in (("force", "force_N", "N"), ("torque", "torque_Nm", "N·m")):
        table.add_row(f"{name}, peak / mean in contact", _pair(summary[key], unit))
        if band is not None and band[key]["peak"]["p95"] > 0.0:
            table.add_row(f"{name}, 90 % of {band['samples']} samples", _ends(band[key], unit))
    tick = summary["tick_us"]
    table.add_row("tick, median / 99 % / max", f"{tick['median']:.0f} / {tick['p99']:.0f} / {tick['max']:.0f} µs")
    table.add_row("missed 1 ms deadlines", f"{summary['missed_deadlines']} of {summary['simulated_s'] * 1e3:.0f}")
    for quantity, value in _scheduling_rows(summary):
        table.add_row(quantity, value)
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
    if band is not None:
        from tissue.uncertainty.figures import band_lines

        for line in band_lines(band):
            console.print(f"band: {line}")
    console.print(f"files in {folder}")


def _scheduling_rows(summary: "Summary") -> Iterator[tuple[str, str]]:
    """How late the machine itself was, and what was chosen for launches and background work."""
    if (gaps := summary.get("machine_gaps")) is not None:
        met = f"{gaps['count']} in {gaps['spun_s']:.2g} s, longest {1e-3 * gaps['longest_us']:.2g} ms"
        over = f"gaps of the machine over {1e-3 * gaps['least_us']:g} ms, expected in these ticks"
        yield over, f"{gaps['expected_in_ticks']:.1f} ({met})"
    if (chosen := summary.get("scheduling")) is not None:
        large = f"{chosen['split_launches']} of {chosen['large_launches']} large ones"
        yield "launches split over cores", f"{large}, {chosen['cores']} cores"
        if "background" in chosen:
            yield "while the ticks go on", chosen["background"]


def _pair(figures: dict[str, float], unit: str) -> str:
    return f"{figures['peak']:.3g} / {figures['mean_in_contact']:.3g} {unit}"


def _ends(figures: dict[str, dict[str, float]], unit: str) -> str:
    """Ends of the 90 % intervals of the peak and of the mean."""
    peak, mean = (f"{figures[name]['p05']:.3g}–{figures[name]['p95']:.3g}" for name in ("peak", "mean_in_contact"))
    return f"{peak} / {mean} {unit}"
