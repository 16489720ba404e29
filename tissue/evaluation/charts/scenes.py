"""Charts of scenes: their frontiers by script and by hand, as pictures and as tables. Cutting scenes by script alone.

Before anything is timed, other processes may make what it needs: references and condensed meshes. They hand nothing
back; it all goes to the cache on disk, where measuring finds it.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor
from functools import partial
from math import isnan
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from tissue.evaluation.charts.frontier import Frontier, frontier_of, measured_keys, short_of, write_measured
from tissue.evaluation.charts.keys import machine, setting_key
from tissue.evaluation.charts.overview import draw_overview
from tissue.evaluation.charts.picture import draw_frontiers
from tissue.evaluation.charts.places import placed
from tissue.evaluation.charts.reference import grid_force_N, of_model, reference_words
from tissue.evaluation.charts.settings import by_hand, finest, grids, settings_of, untrained
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
    files = [f"{scene.name}{end}" for scene in scenes for end in (".csv", ".png")]
    with owned_folder(out, "chart", files, overwrite=overwrite, shared=("frontier.png", "machine.txt")):
        return _chart_scenes(scenes, out, quick=quick, pool=pool, report=report)


def _chart_scenes(
    scenes: Sequence[Scene], out: Path, *, quick: bool, pool: Executor | None, report: Progress
) -> list[list[Frontier]]:
    """Chart scenes into a folder that is held."""
    kinds = [charted(scene) for scene in scenes]
    begin = 0.0
    if pool is not None:
        begin = READY_SHARE
        every = [kind for both in kinds for kind in both]
        make_ready(every, pool, quick=quick, report=lambda doing, share: report(doing, begin * share))
    found, drawn = [], []
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


def charted(scene: Scene) -> list[Scene]:
    """Return the scenes whose frontiers are charted: a scene by script, by hand or both.

    A wall is touched by a hand alone. A cutting scene is charted by script alone: in a chart's short excerpt the hand
    presses less than the friction of its device, and its force error would be noise (54 to 200 % in ``milling``).
    """
    if isinstance(scene.tool, Tool) and scene.tool.spin_rpm != 0.0:
        return [scene if scene.device is None else of_model(scene)]
    return [by_hand(scene)] if scene.device is not None else [scene, by_hand(scene)]


def notes_before(names: Sequence[str]) -> list[str]:
    """Return a note for each scene whose chart leaves out predictors, known before anything is computed."""
    notes = []
    for name in names or scene_names():
        for kind in charted(load_scene(name)):
            missing = untrained(kind) if kind.device is not None else ()
            if missing:
                notes.append(
                    f"{name}: {', '.join(missing)} are left out, no trained predictor. "
                    f"Train one with 'tissue train {name}'."
                )
    return notes


def chart_lines(found: Sequence[Sequence[Frontier]]) -> list[str]:
    """Frontiers in words, a line for each setting that nothing beats."""
    lines = []
    for both in found:
        for each in both:
            how = "by script" if each.scene.device is None else f"by hand on {each.scene.held.kind}"
            lines.append(f"{each.scene.name} {how}, held to {reference_words(each.scene, each.gap)}")
            if not isnan(each.rounding):
                lines.append(f"  float32: a path moved by a last place, 1 nm, moves the force by {each.rounding:.1e}")
            if each.scene.device is None and isinstance(each.scene.anatomy, SoftAnatomy):
                law = each.law.line() if each.law else "all by the linear law, not compared with a neo-Hookean one"
                lines += [
                    f"  {law}",
                    "  forces all in float64; float32 are only the frames that a run keeps to be shown",
                ]
            lines += [
                f"  {point.setting:<28} error {100.0 * point.force_error:6.2g} %, over 50 ms "
                f"{100.0 * point.error_50_ms:6.2g} %   "
                f"tick {point.median_us:5.0f} µs, 99 % {point.p99_us:6.0f} µs"
                for point in each.best
            ]
    return lines


def make_ready(kinds: Sequence[Scene], pool: Executor, *, quick: bool, report: Progress) -> None:
    """Make ready what scenes by script and by hand need that were not measured on this machine yet."""
    waiting = [kind for kind in kinds if _unknown(kind, quick=quick)]
    try:
        for name, done in _done(pool, [(kind.name, partial(short_of, kind, quick)) for kind in waiting], report):
            report(f"{name}: first contact", 0.2 * done)
        work = [(kind.name, partial(_make, *each)) for kind in waiting for each in pieces(kind, quick=quick)]
        for name, done in _done(pool, work, report):
            report(f"{name}: references and meshes", 0.2 + 0.8 * done)
    except BrokenExecutor:
        report("the processes that make charts ready were lost: what is missing is made where it is measured", 1.0)


def pieces(scene: Scene, *, quick: bool) -> list[tuple[Scene, bool]]:
    """Runs whose results the measurements of a scene will find in the cache, and whether only for their mesh."""
    short = short_of(scene, quick)
    model = short_of(of_model(scene), quick)
    found: list[tuple[Scene, bool]] = []
    if scene.device is None:
        if has_exact_geometry(model):
            at = [(place, settings_of(model, quick=quick)[0].changes) for place in placed(model)]
        else:
            three = grids(model, quick=quick)
            at = [(model, each) for each in three] + [
                (place, each) for place in placed(model)[1:] for each in three[2:]
            ]
        found = [(changed(each, changes), False) for each, changes in at]
    if isinstance(scene.anatomy, SoftAnatomy):
        wanted = _unknown(scene, quick=quick)
        if scene.device is None:
            meshes = [changed(place, changes) for changes in wanted for place in placed(short)]
        else:
            meshes = [short, ideal_scene(short, finest(scene, quick=quick))] if wanted else []
        found += [(changed(mesh, {"duration_s": TICK_S}), True) for mesh in meshes]
    return found


def _unknown(scene: Scene, *, quick: bool) -> list[dict[str, object]]:
    """Settings of a scene that were not measured yet, of those that compute alike one."""
    known = measured_keys(scene, quick=quick)
    return [
        dict(setting.changes)
        for setting in settings_of(scene, quick=quick)
        if setting_key(scene, setting, quick=quick) not in known
    ]


def _make(scene: Scene, for_mesh: bool) -> None:
    """Run a scene, for a mesh one tick. What is refused here is refused again, and reported, where it is measured."""
    try:
        if for_mesh:
            simulate(scene, allow_unstable=True)
        elif has_exact_geometry(scene):
            reference_force(scene, simulate(scene, allow_unstable=True).trace)
        else:
            grid_force_N(scene, {})
    except InputError:
        return


def _done(
    pool: Executor, work: Sequence[tuple[str, Callable[[], object]]], report: Progress
) -> Iterator[tuple[str, float]]:
    """Do some work; yield whose was done and what share that makes."""
    names = {pool.submit(call): name for name, call in work}
    count = len(names)
    while names:
        for future in first_done(pool, names, report):
            future.result()
            yield names.pop(future), 1.0 - len(names) / count
