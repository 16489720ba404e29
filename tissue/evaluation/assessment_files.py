"""Assessment of a run as text, files and a section of a report."""

import json
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from meshes.base.errors import counted
from meshes.base.whole_file import write_text
from tissue.evaluation.assessment import Assessment, assess
from tissue.evaluation.same_task import AssessedRun
from tissue.evaluation.steadiness import SCALE, Steadiness
from tissue.show.figures.figure import figure, save
from tissue.system.owned_folder import OwnedFolder

MOST_BREACHES = 8
"""Largest number of breaches in the printed text. ``assessment.json`` holds all breaches."""
FILES = ("assessment.json", "assessment.png")
TRAINEE = "#0072B2"
REFERENCE = "0.45"
LIMIT = "#D55E00"
SHADE = "#E69F00"


def assessment_lines(found: Assessment) -> list[str]:
    """Return the assessment in words."""
    figures = found.figures
    apart = figures["deviation_mm"]
    time = figures["time_in_contact_s"]
    peak = figures["peak_force_N"]
    hand = found.steadiness
    removed = figures["removed_mm3"]
    more = len(found.breaches) - MOST_BREACHES
    return [
        f"no score: {found.unscored}" if hand is None else _score_line(hand),
        (
            f"path: mean distance from the path {apart['mean']:.2f} mm, largest "
            f"{apart['worst']:.2f} mm at {apart['worst_at_s']:.3f} s"
        ),
        f"depth: {figures['overshoot_mm']:.2f} mm beyond the reference's deepest point",
        f"force: peak {peak['trainee']:.3g} N against {peak['reference']:.3g}; the RMS difference "
        f"from the reference at the same place is {100.0 * figures['force_error']:.0f} % of the "
        "reference's RMS force",
        *(
            [
                f"removed: {removed['trainee']:.3g} mm3 against {removed['reference']:.3g}, "
                f"{100.0 * removed['trainee'] / removed['reference']:.0f} % of the reference volume"
            ]
            if removed["reference"] > 0.0
            else []
        ),
        f"time from first to last contact: {time['trainee']:.2f} s against {time['reference']:.2f}",
        *(
            f"smallest distance to {name}: {each['trainee']:.3f} mm against {each['reference']:.3f}"
            f"{_margin_text(found, name)}"
            for name, each in figures["least_distance_mm"].items()
        ),
        limits_line(found),
        *_structure_lines(found),
        *(f"limit exceeded: {each.sentence}" for each in found.breaches[:MOST_BREACHES]),
        *([f"{counted(more, 'more interval')} beyond a limit"] if more > 0 else []),
        *(f"only in the trainee's run, at {at:.3f} s: {what}" for at, what in found.events),
        *(f"only in the reference, at {at:.3f} s: {what}" for at, what in found.missing),
        *([] if found.breaches or found.breached else ["no limit was exceeded"]),
        *(f"the {who} was cut short" for who, whole in figures["complete"].items() if not whole),
        *(f"note: {note}" for note in found.notes),
    ]


def limits_line(found: Assessment) -> str:
    """Return a line with the limits of an assessment."""
    margins = "".join(
        f", {each.what} at least {each.limit:.3g} mm" for each in found.clearances.values()
    )
    return (
        f"limits: force {found.force.limit:.3g} N, distance from the path "
        f"{found.deviation.limit:.3g} mm, depth {found.depth.limit:.3g} mm from the first contact "
        f"of the reference{margins}"
    )


def _margin_text(found: Assessment, structure: str) -> str:
    """Return the margin of a structure in words; empty without a margin."""
    if structure not in found.clearances:
        return ""
    return f" (margin {found.clearances[structure].limit:.3g} mm)"


def _structure_lines(found: Assessment) -> list[str]:
    """Return a line for each structure that the trainee breached."""
    kept = found.figures["keep_clear"]
    return [
        f"breach: the tool was {kept[name]['breach_depth_mm']:.2f} mm deep in {name}, first at "
        f"{kept[name]['first_breach_s']:.3f} s"
        for name in found.breached
    ]


def _mistakes(found: Assessment) -> str:
    """Return the number of intervals beyond a limit, and the breached structures, in words."""
    limits = f"{counted(len(found.breaches), 'interval')} beyond a limit"
    return f"{limits}, {' and '.join(found.breached)} breached" if found.breached else limits


def _score_line(hand: Steadiness) -> str:
    """Return the score of a hand in words."""
    return (
        f"score: {hand.score:.0f} (95 %: {hand.low:.0f} to {hand.high:.0f}) from a tremor of "
        f"{hand.tremor_mm:.3f} mm; {SCALE}"
    )


def assessed_section(
    trainee: AssessedRun, reference: AssessedRun, **limits: float
) -> tuple[list[str], bytes]:
    """Assess a run; return the lines of text and the picture (PNG) for a report.

    See `assess` for the `limits`.
    """
    found = assess(trainee, reference, **limits)
    with TemporaryDirectory() as folder:
        picture = Path(folder) / FILES[1]
        draw_assessment(found, picture)
        return [*_run_lines(trainee, reference), *assessment_lines(found)], picture.read_bytes()


def _run_lines(trainee: AssessedRun, reference: AssessedRun) -> list[str]:
    """Return a line for each run with the last parts of its folder path.

    A run that exists only in memory has no folder and gets no line.
    """
    runs = {"trainee": trainee, "reference": reference}
    # A trainee may have a folder for each attempt, so two parts of the path are shown.
    return [
        f"{who}: {'/'.join(run.path.resolve().parts[-2:])}"
        for who, run in runs.items()
        if run.path is not None
    ]


def write_assessment(found: Assessment, folder: Path, *, overwrite: bool) -> list[Path]:
    """Write ``assessment.json`` and ``assessment.png``.

    Raises InputError if `folder` is a file, or if it contains an assessment and `overwrite` is
    false.
    """
    data = {
        "steadiness": None if found.steadiness is None else asdict(found.steadiness),
        "unscored": found.unscored,
        **found.figures,
        "limits": {
            "force_N": found.force.limit,
            "deviation_mm": found.deviation.limit,
            "depth_mm": found.depth.limit,
            **{f"margin_{name}_mm": each.limit for name, each in found.clearances.items()},
        },
        "breaches": [asdict(each) for each in found.breaches],
        "notes": list(found.notes),
        "events": [{"time_s": at, "what": what} for at, what in found.events],
        "missing_events": [{"time_s": at, "what": what} for at, what in found.missing],
    }
    with OwnedFolder(folder, "assessment", FILES, overwrite=overwrite):
        write_text(folder / FILES[0], json.dumps(data, indent=2) + "\n")
        draw_assessment(found, folder / FILES[1])
    return [folder / name for name in FILES]


def draw_assessment(found: Assessment, path: Path) -> None:
    """Draw the assessed quantities of trainee and reference over time, with their limits.

    Time spans in which a quantity exceeds its limit are shaded. A line marks the first breach of
    each structure.
    """
    clearances = found.clearances.values()
    quantities = (found.deviation, found.force, found.depth, *clearances)
    # inches: 2.4 for each panel; the margins are shares of the figure of three panels, with space
    # for title and legend on top
    larger = len(quantities) / 3.0
    chart = figure(9.0, 7.2 * larger)
    panels = chart.subplots(len(quantities), 1, sharex=True)
    top = 1.0 - 0.1 / larger
    bottom = 0.08 / larger
    chart.subplots_adjust(left=0.09, right=0.98, top=top, bottom=bottom, hspace=0.14)
    figures = found.figures
    time = found.time_s
    least = 0.002 * (time[-1] - time[0])  # a breach of a tick or two must still be seen
    labels = ["distance from\nthe path / mm", "force / N", "depth / mm"]
    labels += [f"{each.what} / mm" for each in clearances]
    for axes, label, each in zip(panels, labels, quantities, strict=True):
        for breach in (breach for breach in found.breaches if breach.what == each.what):
            end = max(breach.end_s, breach.start_s + least)
            axes.axvspan(breach.start_s, end, color=SHADE, alpha=0.35)
        # the distance from the reference has no reference itself
        if each.reference is not None:
            axes.plot(
                time,
                each.reference,
                color=REFERENCE,
                label="reference at that place",
            )
        axes.plot(time, each.values, color=TRAINEE, label="trainee")
        limits = np.full(len(time), each.limit)
        if each.limited is not None:
            limits[~each.limited] = np.nan
        axes.plot(time, limits, color=LIMIT, linestyle="--", label="limit")
        for name in found.breached:
            start_s = figures["keep_clear"][name]["first_breach_s"]
            axes.axvline(start_s, color=LIMIT, linewidth=0.8, label=f"breach of {name}")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
        drawn = each.values
        if each.reference is not None:
            drawn = np.concatenate([drawn, each.reference])
        high = max(each.limit, float(np.nanmax(drawn)))
        # the approach would leave no space for the depth
        low = max(min(0.0, float(np.nanmin(drawn))), -high)
        # 8 % of free space keep the limit's line off the frame
        axes.set_ylim(low, high + 0.08 * (high - low))
    panels[-1].set(xlabel="time / s", xlim=(time[0], time[-1]))
    chart.legend(
        *panels[1].get_legend_handles_labels(),
        loc="upper right",
        bbox_to_anchor=(0.985, 1.0 - 0.055 / larger),
        ncols=4,
        frameon=False,
    )
    title = f"{figures['scene']}: a trainee against the reference, {_mistakes(found)}"
    chart.text(0.09, 1.0 - 0.045 / larger, title, size=10)
    save(chart, path)
