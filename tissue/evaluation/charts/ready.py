"""What a chart needs before anything is timed, made by several processes at once: references and condensed meshes.

Nothing is handed back; it all goes to the cache on disk, where measuring finds it.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor
from functools import partial

from meshes.base.errors import InputError
from meshes.base.progress import Progress
from tissue.evaluation.charts.frontier import measured_keys, short_of
from tissue.evaluation.charts.measure import of_model, reference_force_N, setting_key
from tissue.evaluation.charts.places import placed
from tissue.evaluation.charts.settings import finest, nearly_finest, settings_of
from tissue.scene.load import changed
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.simulation.reference_force import ideal_scene
from tissue.simulation.simulate import TICK_S, simulate
from tissue.system.workers import first_done

__all__ = ["make_ready", "pieces"]


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
    if scene.device == "none":
        at = [
            *((place, finest(model, quick=quick)) for place in placed(model)),
            (model, nearly_finest(model, quick=quick)),
        ]
        found = [(changed(each, changes), False) for each, changes in at if changes]
    if isinstance(scene.anatomy, SoftAnatomy):
        wanted = _unknown(scene, quick=quick)
        if scene.device == "none":
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
        else:
            reference_force_N(scene, {})
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
