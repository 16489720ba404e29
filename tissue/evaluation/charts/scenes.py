"""Charts of force error against computing time for the numerical settings of scenes."""

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from meshes.base.errors import enumerated
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import write_text
from tissue.evaluation.charts.frontier import Frontier, frontier_of, write_measured
from tissue.evaluation.charts.measure import of_model, reference_words
from tissue.evaluation.charts.settings import (
    by_hand,
    machine,
    untrained,
)
from tissue.scene.load import load_scene, scene_names
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.show.figures.figure import figure, plain_numbers, save
from tissue.system.owned_folder import OwnedFolder


def chart_scenes(
    names: Sequence[str],
    out: Path,
    *,
    quick: bool,
    overwrite: bool = False,
    report: Progress = silent,
) -> list[list[Frontier]]:
    """Measure the force error and computing time of scenes at all settings, and draw them.

    If `names` is empty, all built-in scenes are measured. For each scene, ``NAME.png`` and
    ``NAME.csv`` are written. The picture ``frontier.png`` shows all measured scenes.

    Measurements are stored on disk, so an interrupted call can be continued.

    Raises
    ------
    InputError
        If a scene is unknown, or ``out`` is a file or already holds a chart.
    """
    scenes = [load_scene(name) for name in names or scene_names()]
    files = [f"{scene.name}{end}" for scene in scenes for end in (".csv", ".png")]
    with OwnedFolder(
        out, "chart", files, overwrite=overwrite, shared=("frontier.png", "machine.txt")
    ):
        found = []
        drawn = []
        for index, scene in enumerate(scenes):

            def report_share(doing: str, share: float, index: int = index) -> None:
                report(doing, (index + share) / len(scenes))

            frontiers = [
                frontier_of(kind, quick=quick, report=report_share) for kind in charted(scene)
            ]
            rows = [point for each in frontiers for point in each.points]
            found.append(frontiers)
            drawn.append([each for each in frontiers if len(each.points) > 1])
            draw_frontiers(drawn[-1], out / f"{scene.name}.png")
            write_measured(out / f"{scene.name}.csv", rows)
        draw_overview(drawn, out / "frontier.png")
        write_text(out / "machine.txt", machine() + "\n")
    return found


def charted(scene: Scene) -> list[Scene]:
    """Return the variants of a scene to measure: with the scene's motion, with a hand, or both.

    A scene with a device is measured only with a hand, unless the tool cuts.
    """
    cuts = isinstance(scene.tool, Tool) and scene.tool.spin_rpm != 0.0
    if scene.device is not None and not cuts:
        return [by_hand(scene)]
    return [of_model(scene), by_hand(scene)]


def notes_before(names: Sequence[str]) -> list[str]:
    """Return a note for each scene whose chart omits predictors that were not trained.

    Nothing is measured.
    """
    notes = []
    for name in names or scene_names():
        for kind in charted(load_scene(name)):
            if kind.device is not None and (missing := untrained(kind)):
                notes.append(
                    f"{name}: the chart omits {enumerated(missing)}, because no trained predictor "
                    f"was found. Train one with 'tissue train {name}'."
                )
    return notes


def chart_lines(found: Sequence[Sequence[Frontier]]) -> list[str]:
    """Describe measured scenes in words; each Pareto-optimal setting has its own line."""
    lines = []
    for each in (frontier for both in found for frontier in both):
        scene = each.scene
        lines.append(
            f"{scene.name} {_how(scene)}, compared with {reference_words(scene, each.gap)}"
        )
        if any(point.family == "cutting" for point in each.points):
            lines.append(
                "  simpler laws and drills: error against the scene's own law, not against "
                "measured forces"
            )
        for point in each.best:
            lines.append(
                f"  {point.setting:<28} error {100.0 * point.force_error:6.2g} %, over 50 ms "
                f"{100.0 * point.error_50_ms:6.2g} %   tick {point.median_us:5.0f} µs, 99 % "
                f"{point.p99_us:6.0f} µs"
            )
    return lines


def _how(scene: Scene) -> str:
    """Return a text that states how the tool of a scene is moved."""
    return "by script" if scene.device is None else f"by hand on {scene.held.kind}"


ORANGE = "#D55E00"
FAMILIES = {
    "voxels": ("#0072B2", "o", "voxels"),
    "shell": ("#56B4E9", "s", "elements of the cutter"),
    "cutting": ("#882255", "X", "simpler law or drill"),
    "stress": ("#CC79A7", "D", "with stress"),
    "elements": ("#009E73", "p", "elements"),
    "path": ("#E69F00", "H", "compliance"),
    "loop": (ORANGE, "o", "renderer, predictor, model rate"),
    "model": ("0.2", "o", "the model"),
}
"""Colour, marker and label of each family of settings.

Most colours are from Okabe and Ito (2008).
"""
SMALLEST_PERCENT = 1e-4
"""Error [%] that replaces zero on logarithmic axes."""
BY = {"script": ("#0072B2", "by script: model"), "hand": ("#B34700", "by hand: loop")}
"""Colour and label for scripted and hand-held tools in the picture of all scenes."""
COLUMNS = 4


def draw_frontiers(found: Sequence[Frontier], path: Path) -> None:
    """Draw force error against computing time per tick, one panel per scene variant.

    The median and the 99th percentile of the time are drawn. The uncertainty of the reference force
    is shaded.
    """
    # inches for each panel with its legend to the right
    chart = figure(7.0 * len(found), 4.6)
    chart.set_layout_engine("constrained")
    panels = chart.subplots(1, len(found), squeeze=False)[0]
    for axes, each in zip(panels, found, strict=True):
        _draw_frontier(axes, each)
    save(chart, path)


def draw_overview(found: Sequence[Sequence[Frontier]], path: Path) -> None:
    """Draw the Pareto-optimal settings of each scene, with tools on a given path or in a hand.

    There is one panel for each scene. The settings are numbered, and the names of the settings are
    listed next to the panel.
    """
    columns = min(COLUMNS, len(found))
    rows = -(-len(found) // columns)
    # inches for each panel, and 0.4 for the legend above
    chart = figure(4.0 * columns, 2.6 * rows + 0.4)
    chart.set_layout_engine("constrained")
    panels = chart.subplots(rows, columns, squeeze=False).ravel()
    for axes in panels[len(found) :]:
        axes.set_axis_off()
    for axes, both in zip(panels, found, strict=False):
        numbered = 0
        for each in both:
            colour, label = BY["script" if each.scene.device is None else "hand"]
            names = [point.setting for point in each.best]
            numbers = [str(number) for number in range(numbered + 1, numbered + len(names) + 1)]
            _draw_best(axes, each, colour, label, numbers)
            for number, name in zip(numbers, names, strict=True):
                # 12 points a line, to the right of the panel
                at = (6, -12 * int(number))
                words = f"{number}  {name}"
                axes.annotate(
                    words, (1, 1), at, "axes fraction", "offset points", color=colour, size=8
                )
            numbered += len(names)
        axes.axvline(1e3, color="0.2", linestyle="--", label="1 ms, the haptic tick")
        _log_axes(axes, title=both[0].scene.name, xlabel="tick / µs", ylabel="force error / %")
    lines = {str(line.get_label()): line for axes in panels for line in axes.lines}
    named = {label: line for label, line in lines.items() if not label.startswith("_")}
    # the width of one panel holds two entries
    entries = min(len(named), 2 * columns)
    chart.legend(
        named.values(), named.keys(), loc="outside upper center", ncols=entries, frameon=False
    )
    save(chart, path)


def _draw_best(axes: Axes, found: Frontier, colour: str, label: str, names: Sequence[str]) -> None:
    """Draw the Pareto-optimal settings of a scene as points with a text."""
    ticks = [point.median_us for point in found.best]
    errors = [_percent(point.force_error) for point in found.best]
    axes.step(ticks, errors, "-o", where="post", color=colour, label=label)
    for tick, error, name in zip(ticks, errors, names, strict=True):
        # 4 points to the right of the mark and above it
        axes.annotate(name, (tick, error), (4, 4), textcoords="offset points", color=colour)


def _draw_frontier(axes: Axes, found: Frontier) -> None:
    """Draw all settings of a scene into axes."""
    for point in found.points:
        colour, mark, label = FAMILIES[point.family]
        error = _percent(point.force_error)
        over = _percent(point.error_50_ms)
        axes.plot([point.median_us, point.p99_us], [error] * 2, color=colour, alpha=0.5)
        axes.plot([point.median_us] * 2, [error, over], color=colour, alpha=0.5)
        axes.plot(point.median_us, error, mark, color=colour, label=label)
        axes.plot(point.median_us, over, mark, color=colour, mfc="white")
    _draw_best(axes, found, "0.15", "frontier", [point.setting for point in found.best])
    axes.axvline(1e3, color=ORANGE, linestyle="--", label="1 ms")
    errors = [_percent(point.force_error) for point in found.points]
    low = 0.5 * min(*errors, *(_percent(point.error_50_ms) for point in found.points))
    gap = "uncertainty of the reference"
    axes.axhspan(low, max(100.0 * found.gap, low), color="0.9", label=gap)
    _log_axes(
        axes,
        title=f"{found.scene.name}, {_how(found.scene)}",
        xlabel="tick in contact / µs: median, line to its 99th percentile",
        ylabel="force error / %, open: over 50 ms",
    )
    # Factors of 2 keep marks off the edges; below 0.1 % the axis would show rounding alone.
    axes.set_ylim(low, 2.2 * max([*errors, 0.1]))
    # one entry for each label
    handles = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    axes.legend(handles.values(), handles.keys(), loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _percent(error: float) -> float:
    """Return an error in per cent, at least `SMALLEST_PERCENT`.

    A logarithmic axis cannot show the value 0.
    """
    return max(100.0 * error, SMALLEST_PERCENT)


def _log_axes(axes: Axes, **settings: str) -> None:
    """Make both axes logarithmic, with plain numbers at the ticks."""
    axes.set(xscale="log", yscale="log", **settings)
    for axis in (axes.xaxis, axes.yaxis):
        plain_numbers(axis)
    axes.grid(alpha=0.3, which="both")
