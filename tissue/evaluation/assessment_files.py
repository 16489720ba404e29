"""An assessment as files: figures as JSON, and a picture of path, force and depth over time with their limits."""

import json
from dataclasses import asdict
from pathlib import Path

from meshes.base.whole_file import whole_file
from tissue.evaluation.assessment import Assessment
from tissue.figures.figure import figure, save
from tissue.system.outputs import require_free_folder

__all__ = ["draw_assessment", "write_assessment"]

FILES = ("assessment.json", "assessment.png")

TRAINEE, REFERENCE, LIMIT, SHADE = "#0072B2", "0.45", "#D55E00", "#E69F00"
MARGIN = 0.08


def write_assessment(found: Assessment, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write ``assessment.json`` and ``assessment.png``.

    Raises
    ------
    InputError
        If the folder is a file, or holds another assessment.
    """
    require_free_folder(folder, FILES, "assessment", overwrite=overwrite)
    folder.mkdir(parents=True, exist_ok=True)
    limits = {
        "force_N": found.force_limit_N,
        "deviation_mm": found.deviation_limit_mm,
        "depth_mm": found.depth_limit_mm,
    }
    data = found.figures | {
        "limits": limits,
        "breaches": [asdict(each) for each in found.breaches],
        "events": [{"time_s": at, "what": what} for at, what in found.events],
    }
    with whole_file(folder / FILES[0]) as temporary:
        temporary.write_text(json.dumps(data, indent=2) + "\n", "utf-8")
    draw_assessment(found, folder / FILES[1])
    return [folder / name for name in FILES]


def draw_assessment(found: Assessment, path: Path) -> None:
    """Draw what the trainee did over time, the reference at the same place, and the limits with their breaches."""
    chart = figure(9.0, 7.2)
    panels = chart.subplots(3, 1, sharex=True)
    chart.subplots_adjust(left=0.09, right=0.98, top=0.9, bottom=0.08, hspace=0.14)
    time = found.time_s
    curves = (
        ("distance from the path", "distance from\nthe path / mm", found.deviation_mm, found.deviation_limit_mm),
        ("force", "force / N", found.force_N, found.force_limit_N),
        ("depth", "depth / mm", found.depth_mm, found.depth_limit_mm),
    )
    for axes, (what, label, values, limit) in zip(panels, curves, strict=True):
        for breach in found.breaches:
            if breach.what == what:
                # A breach of a tick or two must still be seen.
                least = 0.002 * float(time[-1] - time[0])
                axes.axvspan(breach.start_s, max(breach.end_s, breach.start_s + least), color=SHADE, alpha=0.35, lw=0)
        reference = {"force": found.reference_force_N, "depth": found.reference_depth_mm}.get(what)
        if reference is not None:
            axes.plot(time, reference, color=REFERENCE, linewidth=1.4, label="reference at that place")
        axes.plot(time, values, color=TRAINEE, label="trainee")
        axes.axhline(limit, color=LIMIT, linestyle="--", linewidth=1.4, label="limit")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        low, high = min(0.0, float(values.min())), max(limit, float(values.max()))
        low = max(low, -high)  # the approach to the tissue would leave no space for the depth in it
        axes.set_ylim(low, high + MARGIN * (high - low))
    panels[2].set(xlabel="time / s", xlim=(float(time[0]), float(time[-1])))
    handles, labels = panels[1].get_legend_handles_labels()
    chart.legend(handles, labels, loc="upper right", bbox_to_anchor=(0.985, 0.945), ncols=3, frameon=False)
    count = len(found.breaches)
    summary = "no limit passed" if not count else f"{count} breach{'es' if count > 1 else ''}, shaded"
    apart = found.figures["deviation_mm"]
    chart.text(
        0.09, 0.955, f"{found.figures['scene']}: a trainee against the reference, {summary}", size=11, va="center"
    )
    figures = f"{apart['mean']:.2f} mm off the path on average, force {100.0 * found.figures['force_error']:.0f} % off"
    chart.text(0.09, 0.92, figures, size=9, color="0.25", va="center")
    save(chart, path)
