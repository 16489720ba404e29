"""An assessment as files: figures as JSON, and a picture of path, force and depth over time with their limits."""

import json
from dataclasses import asdict
from pathlib import Path

from meshes.base.whole_file import whole_file
from tissue.evaluation.assessment import Assessment
from tissue.figures.figure import figure, save
from tissue.system.owned_folder import owned_folder, require_folder

__all__ = ["require_assessment_folder", "write_assessment"]

FILES = ("assessment.json", "assessment.png")

TRAINEE, REFERENCE, LIMIT, SHADE = "#0072B2", "0.45", "#D55E00", "#E69F00"
MARGIN = 0.08


def require_assessment_folder(folder: Path, *, overwrite: bool) -> None:
    """Check that a folder can take an assessment.

    Raises
    ------
    InputError
        If the folder is a file, or holds another assessment.
    """
    require_folder(folder, "assessment", FILES, overwrite=overwrite)


def write_assessment(found: Assessment, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write ``assessment.json`` and ``assessment.png``.

    Raises
    ------
    InputError
        If the folder is a file, or holds another assessment.
    """
    data = {
        **found.figures,
        "limits": {
            "force_N": found.force.limit, "deviation_mm": found.deviation.limit, "depth_mm": found.depth.limit
        },
        "breaches": [asdict(each) for each in found.breaches],
        "notes": list(found.notes),
        "events": [{"time_s": at, "what": what} for at, what in found.events],
    }  # fmt: skip
    with owned_folder(folder, "assessment", FILES, overwrite=overwrite):
        with whole_file(folder / FILES[0]) as temporary:
            temporary.write_text(json.dumps(data, indent=2) + "\n", "utf-8")
        _draw(found, folder / FILES[1])
    return [folder / name for name in FILES]


def _draw(found: Assessment, path: Path) -> None:
    """Draw what the trainee did over time, the reference at the same place, and the limits with their breaches."""
    chart = figure(9.0, 7.2)
    panels = chart.subplots(3, 1, sharex=True)
    chart.subplots_adjust(left=0.09, right=0.98, top=0.9, bottom=0.08, hspace=0.14)
    time = found.time_s
    least = 0.002 * float(time[-1] - time[0])  # a breach of a tick or two must still be seen
    labels = ("distance from\nthe path / mm", "force / N", "depth / mm")
    for axes, label, each in zip(panels, labels, (found.deviation, found.force, found.depth), strict=True):
        for breach in (breach for breach in found.breaches if breach.what == each.what):
            end = max(breach.end_s, breach.start_s + least)
            axes.axvspan(breach.start_s, end, color=SHADE, alpha=0.35, lw=0)
        if each.reference is not None:
            axes.plot(time, each.reference, color=REFERENCE, linewidth=1.4, label="reference at that place")
        axes.plot(time, each.values, color=TRAINEE, label="trainee")
        axes.axhline(each.limit, color=LIMIT, linestyle="--", linewidth=1.4, label="limit")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        high = max(each.limit, float(each.values.max()))
        low = max(min(0.0, float(each.values.min())), -high)  # the approach would leave no space for the depth
        axes.set_ylim(low, high + MARGIN * (high - low))
    panels[2].set(xlabel="time / s", xlim=(float(time[0]), float(time[-1])))
    chart.legend(*panels[1].get_legend_handles_labels(), loc="upper right", bbox_to_anchor=(0.985, 0.945), ncols=3,
                 frameon=False)  # fmt: skip
    count, figures = len(found.breaches), found.figures
    summary = "no limit passed" if not count else f"{count} breach{'es' if count > 1 else ''}, shaded"
    title = f"{figures['scene']}: a trainee against the reference, {summary}"
    chart.text(0.09, 0.955, title, size=11, va="center")
    mean, percent = figures["deviation_mm"]["mean"], 100.0 * figures["force_error"]
    below = f"{mean:.2f} mm off the path on average, force {percent:.0f} % off"
    chart.text(0.09, 0.92, below, size=9, color="0.25", va="center")
    save(chart, path)
