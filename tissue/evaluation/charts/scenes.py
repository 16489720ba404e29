"""Charts of scenes: their frontiers by script and by hand, as pictures and as tables."""

from collections.abc import Sequence
from concurrent.futures import Executor
from math import isnan
from pathlib import Path

from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.charts.frontier import Frontier, frontier_of, write_measured
from tissue.evaluation.charts.measure import machine
from tissue.evaluation.charts.overview import draw_overview
from tissue.evaluation.charts.picture import draw_frontiers
from tissue.evaluation.charts.ready import make_ready
from tissue.evaluation.charts.settings import by_hand
from tissue.scene.load import load_scene, scene_names
from tissue.scene.organ import SoftAnatomy
from tissue.system.outputs import require_free_folder

__all__ = ["chart_lines", "chart_scenes"]

READY_SHARE = 0.3
"""Share of a chart's time that making ready takes."""


def chart_scenes(
    names: Sequence[str],
    out: Path,
    *,
    quick: bool,
    overwrite: bool = False,
    pool: Executor | None = None,
    report: Progress = silent,
) -> list[list[Frontier]]:
    """Chart some scenes, or all where none is named; each leaves NAME.png and NAME.csv, all frontier.png.

    What was measured on this machine before is not measured again, so that a call that was interrupted goes on. Where
    there are other processes, they make references and meshes ready, and are idle while anything is timed.

    Raises
    ------
    InputError
        If a scene is unknown, ``out`` is a file, or it holds a chart already.
    """
    scenes = [load_scene(name) for name in names or scene_names()]
    require_free_folder(out, [f"{scene.name}.csv" for scene in scenes], "chart", overwrite=overwrite)
    # A wall is met by a hand alone; other scenes move by script as well.
    kinds = [[by_hand(scene)] if scene.device != "none" else [scene, by_hand(scene)] for scene in scenes]
    begin = 0.0
    if pool is not None:
        begin = READY_SHARE
        every = [kind for both in kinds for kind in both]
        make_ready(every, pool, quick=quick, report=lambda doing, share: report(doing, begin * share))
    found, drawn = [], []
    out.mkdir(parents=True, exist_ok=True)
    for index, (scene, both) in enumerate(zip(scenes, kinds, strict=True)):

        def report_share(doing: str, share: float, index: int = index) -> None:
            report(doing, begin + (1.0 - begin) * (index + share) / len(scenes))

        frontiers = [frontier_of(kind, quick=quick, report=report_share) for kind in both]
        drawn.append([each for each in frontiers if len(each.points) > 1])
        draw_frontiers(drawn[-1], out / f"{scene.name}.png")
        write_measured(out / f"{scene.name}.csv", [row for each in frontiers for row in (*each.points, *each.bounds)])
        found.append(frontiers)
    draw_overview(drawn, out / "frontier.png")
    with whole_file(out / "machine.txt") as temporary:
        temporary.write_text(machine() + "\n", "utf-8")
    return found


def chart_lines(found: Sequence[Sequence[Frontier]]) -> list[str]:
    """Frontiers in words, a line for each setting that nothing beats."""
    lines = []
    for both in found:
        for each in both:
            how = "by script" if each.scene.device == "none" else f"by hand on {each.scene.device}"
            lines.append(f"{each.scene.name} {how}; the reference is known to {100.0 * each.gap:.2g} %")
            if not isnan(each.rounding):
                lines.append(f"  float32: a path moved by a last place, 1 nm, moves the force by {each.rounding:.1e}")
            if each.scene.device == "none" and isinstance(each.scene.anatomy, SoftAnatomy):
                law = each.law.line() if each.law else "all by the linear law, not compared with a neo-Hookean one"
                lines += [
                    f"  {law}",
                    "  forces all in float64; float32 are only the frames that a run keeps to be shown",
                ]
            lines += [
                f"  {point.setting:<28} error {100.0 * point.force_error:6.2g} %   "
                f"tick {point.median_us:5.0f} µs, 99 % {point.p99_us:6.0f} µs"
                for point in each.best
            ]
    return lines
