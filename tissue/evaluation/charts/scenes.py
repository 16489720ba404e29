"""Charts of scenes: frontiers by script and by hand, as pictures and tables.

Before anything is timed, other processes compute references and condensed meshes. Their results go
to the cache on disk, where measurements find them.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor
from functools import partial
from math import isnan
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.charts.frontier import Frontier, frontier_of, unmeasured, write_measured
from tissue.evaluation.charts.measure import grid_force_N, of_model, reference_words, short_of
from tissue.evaluation.charts.pictures import draw_frontiers, draw_overview
from tissue.evaluation.charts.settings import (
    by_hand,
    finest,
    grids,
    machine,
    placed,
    settings_of,
    untrained,
)
from tissue.evaluation.reference.history import has_exact_geometry, reference_force
from tissue.scene.load import changed, load_scene, scene_names
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.reference_force import ideal_scene
from tissue.simulation.simulate import TICK_S, simulate
from tissue.system.owned_folder import owned_folder
from tissue.system.workers import first_done

__all__ = ["chart_lines", "chart_scenes", "charted", "make_ready", "notes_before"]

READY_SHARE = 0.3
"""Share of a chart's time that the preparation takes."""


def chart_scenes(
    names: Sequence[str],
    out: Path,
    *,
    quick: bool,
    overwrite: bool = False,
    pool: Executor | None = None,
    report: Progress = silent,
) -> list[list[Frontier]]:
    """Chart some scenes, or all scenes if no names are given.

    Each scene writes NAME.png and NAME.csv. All scenes together write frontier.png.

    Settings that were measured on this machine before are not measured again. An interrupted chart
    therefore continues. The processes of ``pool`` prepare references and meshes, and are idle
    during all timings.

    Raises
    ------
    InputError
        If a scene is unknown, ``out`` is a file, or it holds a chart already.
    """
    scenes = [load_scene(name) for name in names or scene_names()]
    files = [f"{scene.name}{end}" for scene in scenes for end in (".csv", ".png")]
    with owned_folder(
        out, "chart", files, overwrite=overwrite, shared=("frontier.png", "machine.txt")
    ):
        begin = 0.0
        if pool is not None:
            begin = READY_SHARE
            kinds = [kind for scene in scenes for kind in charted(scene)]
            make_ready(
                kinds, pool, quick=quick, report=lambda doing, share: report(doing, begin * share)
            )
        found = []
        drawn = []
        for index, scene in enumerate(scenes):

            def report_share(doing: str, share: float, index: int = index) -> None:
                report(doing, begin + (1.0 - begin) * (index + share) / len(scenes))

            frontiers = [
                frontier_of(kind, quick=quick, report=report_share) for kind in charted(scene)
            ]
            rows = [row for each in frontiers for row in (*each.points, *each.bounds)]
            found.append(frontiers)
            drawn.append([each for each in frontiers if len(each.points) > 1])
            draw_frontiers(drawn[-1], out / f"{scene.name}.png")
            write_measured(out / f"{scene.name}.csv", rows)
        draw_overview(drawn, out / "frontier.png")
        with whole_file(out / "machine.txt") as temporary:
            temporary.write_text(machine() + "\n", "utf-8")
    return found


def charted(scene: Scene) -> list[Scene]:
    """Return the scenes whose frontiers are charted: a scene by script, by hand or both.

    A wall is touched only by hand. A cutting scene is charted only by script. In a chart's short
    excerpt, the hand presses less than the friction of its device, so its force error would be
    noise (54 to 200 % in ``milling``).
    """
    if isinstance(scene.tool, Tool) and scene.tool.spin_rpm != 0.0:
        return [scene if scene.device is None else of_model(scene)]
    return [by_hand(scene)] if scene.device is not None else [scene, by_hand(scene)]


def notes_before(names: Sequence[str]) -> list[str]:
    """Return a note, before any computation, for each scene whose chart leaves out predictors."""
    notes = []
    for name in names or scene_names():
        for kind in charted(load_scene(name)):
            if kind.device is not None and (missing := untrained(kind)):
                notes.append(
                    f"{name}: {', '.join(missing)} are left out, no trained predictor. "
                    f"Train one with 'tissue train {name}'."
                )
    return notes


def chart_lines(found: Sequence[Sequence[Frontier]]) -> list[str]:
    """Return frontiers in words, a line for each Pareto-optimal setting."""
    lines = []
    for each in (frontier for both in found for frontier in both):
        scene = each.scene
        how = "by script" if scene.device is None else f"by hand on {scene.held.kind}"
        lines.append(f"{scene.name} {how}, held to {reference_words(scene, each.gap)}")
        if not isnan(each.rounding):
            lines.append(
                "  float32: a path moved by a last place, 1 nm, changes the force by "
                f"{each.rounding:.1e}"
            )
        if scene.device is None and isinstance(scene.anatomy, SoftAnatomy):
            law = (
                each.law.line()
                if each.law
                else "all by the linear law, not compared with a neo-Hookean one"
            )
            lines.append(f"  {law}")
        for point in each.best:
            lines.append(
                f"  {point.setting:<28} error {100.0 * point.force_error:6.2g} %, over 50 ms "
                f"{100.0 * point.error_50_ms:6.2g} %   tick {point.median_us:5.0f} µs, 99 % "
                f"{point.p99_us:6.0f} µs"
            )
    return lines


def make_ready(kinds: Sequence[Scene], pool: Executor, *, quick: bool, report: Progress) -> None:
    """Compute the inputs of settings not yet measured on this machine, in other processes."""
    waiting = [kind for kind in kinds if unmeasured(kind, quick=quick)]
    try:
        for name, done in _done(
            pool, [(kind.name, partial(short_of, kind, quick)) for kind in waiting], report
        ):
            report(f"{name}: first contact", 0.2 * done)
        work = [(kind.name, call) for kind in waiting for call in _preparations(kind, quick=quick)]
        for name, done in _done(pool, work, report):
            report(f"{name}: references and meshes", 0.2 + 0.8 * done)
    except BrokenExecutor:
        report(
            (
                "the processes that make charts ready were lost: what is missing is made where "
                "it is measured"
            ),
            1.0,
        )


def _preparations(scene: Scene, *, quick: bool) -> list[Callable[[], None]]:
    """Return calls whose results the measurements of a scene will find in the cache."""
    short = short_of(scene, quick)
    model = short_of(of_model(scene), quick)
    by_script = scene.device is None
    references: list[Scene] = []
    if by_script and has_exact_geometry(model):
        coarse = settings_of(model, quick=quick)[0].changes
        references = [changed(place, coarse) for place in placed(model)]
    elif by_script:
        three = grids(model, quick=quick)
        references = [changed(model, each) for each in three]
        references += [changed(place, each) for place in placed(model)[1:] for each in three[2:]]
    meshes: list[Scene] = []
    if isinstance(scene.anatomy, SoftAnatomy) and by_script:
        wanted = unmeasured(scene, quick=quick)
        meshes = [changed(place, setting.changes) for setting in wanted for place in placed(short)]
    elif isinstance(scene.anatomy, SoftAnatomy):
        meshes = [short, ideal_scene(short, finest(scene, quick=quick))]
    calls = [partial(_reference, each) for each in references]
    return [*calls, *(partial(_mesh, each) for each in meshes)]


def _reference(scene: Scene) -> None:
    """Compute a reference. A refused scene is refused again, and reported, where it is measured."""
    try:
        if has_exact_geometry(scene):
            reference_force(scene, simulate(scene, allow_unstable=True).trace)
        else:
            grid_force_N(scene, {})
    except InputError:
        return


def _mesh(scene: Scene) -> None:
    """Condense a mesh by a run of one tick."""
    try:
        simulate(changed(scene, {"duration_s": TICK_S}), allow_unstable=True)
    except InputError:
        return


def _done(
    pool: Executor, work: Sequence[tuple[str, Callable[[], object]]], report: Progress
) -> Iterator[tuple[str, float]]:
    """Submit named calls; yield the name of each finished one and the finished share."""
    names = {pool.submit(call): name for name, call in work}
    count = len(names)
    while names:
        for future in first_done(pool, names, report):
            future.result()
            yield names.pop(future), 1.0 - len(names) / count
