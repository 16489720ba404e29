"""Measurement of a numerical setting: computing time of a tick, and force error."""

from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from meshes.base.arrays import Array
from meshes.base.cache import Arrays, cached_arrays
from meshes.base.errors import InputError
from meshes.paths.toolpath import arc_length, points_along
from tissue.evaluation.charts.settings import (
    Changes,
    Setting,
    finest,
    grids,
    machine,
    placed,
    relative_edges,
    scene_text,
    settings_of,
    sources,
)
from tissue.evaluation.reference.history import (
    grid_index,
    has_exact_geometry,
    means_over_50_ms,
    reference_force,
)
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Tool
from tissue.simulation.reference_force import ideal_force_N
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S, simulate


def of_model(scene: Scene) -> Scene:
    """Return the scene without its device; the tool then follows the scene's motion."""
    return changed(scene, {"device": "none"})


def grid_force_N(scene: Scene, changes: Changes) -> Array:
    """Compute the force on the tool [N], shape (n, 3), in a scene with changed model settings.

    The result is stored on disk.
    """
    at = changed(of_model(scene), changes)
    forces = cached_arrays(
        "grid-force",
        (scene_text(at), sources(), version("warp-lang")),
        lambda: {"force_N": simulate(at).trace.vectors("model_force", "N")},
    )
    return forces["force_N"]


def force_and_reference_N(run: Run, scene: Scene, *, quick: bool) -> tuple[Array, Array]:
    """Return the force of a run and the reference force for the same motion [N], each shape (n, 3).

    If a hand moves the tool, the returned force of the run is the filtered force before it is
    compressed to the range of the device. The reference is then the force of the finest model,
    without the delay of the haptic loop.
    """
    if scene.device is not None:
        # the force before it is compressed to the range of the device
        played = run.trace.vectors("filtered_force", "N")
        return played, ideal_force_N(run, finest(scene, quick=quick))
    force = run.trace.vectors("model_force", "N")
    if has_exact_geometry(scene):
        return force, reference_force(scene, run.trace).force_N
    return force, grid_force_N(scene, finest(scene, quick=quick))


def reference_gap(scene: Scene, *, quick: bool, by_hand: bool = False) -> float:
    """Return the relative uncertainty of the reference force.

    Force errors below this uncertainty are not significant.

    If the geometry is known exactly and no hand moves the tool, the reference is the force on the
    exact geometry. The numerical uncertainty of this force is returned. If a hand moves the tool,
    the reference is the force on the finest grid. Its relative difference from the force on the
    exact geometry is returned. Without an exact geometry, the grid-convergence index of the finest
    grid is returned. For a wall or a needle, the result is zero.
    """
    model = of_model(scene)
    if not has_exact_geometry(model):
        changes = grids(model, quick=quick)
        # a wall or a needle: the model is its own reference
        if not changes:
            return 0.0
        forces = [grid_force_N(model, each) for each in changes]
        return grid_index(forces, relative_edges(model, quick=quick)).index[-1]
    run = simulate(changed(model, finest(model, quick=quick) if by_hand else {"stress": None}))
    exact = reference_force(model, run.trace)
    if not by_hand:
        return exact.uncertainty
    return force_error(run.trace.vectors("model_force", "N"), exact.force_N)


def reference_words(scene: Scene, gap: float) -> str:
    """Describe the kind and the uncertainty of a scene's reference force in words."""
    model = of_model(scene)
    percent = f"{100.0 * gap:.2g} %"
    exact = has_exact_geometry(model)
    by_hand = scene.device is not None
    if exact and not by_hand:
        return f"the exact geometry (known to {percent})"
    if not grids(model, quick=True):
        return (
            "a loop without latency, with the model itself, which has no grid"
            if by_hand
            else "the model itself, which has no grid"
        )
    grid = (
        "a loop without latency, with the finest grid" if by_hand else "the finest of three grids"
    )
    if exact:
        return f"{grid} (which differs by {percent} from the exact geometry)"
    return f"{grid} (grid-convergence index of {percent}, for the discretisation alone)"


EXCERPT_S = {True: 1.2, False: 3.0}
"""Simulated time after the first contact [s], for a quick chart (True) or a full chart (False)."""
LATE_S = 0.3
"""Additional simulated time if a hand moves the tool [s].

A tool in a hand lags behind the scripted path.
"""
MARGIN_MM = 0.5
"""Width [mm] of the modelled bone around the region that a scripted tool reaches.

This is the smallest margin that a scene allows. The margin affects only the time to build the bone,
not the force.
"""
STRAY_MM = 1.5
"""Largest width [mm] of the modelled bone around the path if a hand moves the tool.

The margin is needed because a hand deviates from the path.
"""
REPEATS = 2
"""Number of runs of a numerical setting that is measured at a single tool position.

The time of the fastest run counts.

A quick chart of a haptic loop uses one run.
"""
SETTLED = 20
"""Number of ticks at the beginning of contact that are excluded from computing times.

In these ticks, code is loaded.
"""


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Time of a tick and force error of one setting.

    Attributes
    ----------
    scene, setting, family, machine
        The names of the scene, the setting and its family, and the machine on which times were
        measured.
    force_error
        ||F - F_ref|| / ||F_ref|| over the ticks of a run. If several tool positions were tested, it
        is the largest value.
    error_50_ms
        The error `force_error` after both forces are averaged over 50 ms.
    median_us, p99_us, missed
        Median and 99th percentile of the computing time of a tick in contact [us], and number of
        ticks that took longer than 1 ms.
    """

    scene: str
    setting: str
    family: str
    force_error: float
    error_50_ms: float
    median_us: float
    p99_us: float
    missed: int
    machine: str


def short_of(scene: Scene, quick: bool) -> Scene:
    """Return the shortened scene that is run at each numerical setting.

    A scene with a device and a spinning tool is not shortened. The reason is that, at the start of
    a cut, the force of the hand is smaller than the friction of the device. The force error of a
    short run would therefore be random.
    """
    cuts = isinstance(scene.tool, Tool) and scene.tool.spin_rpm != 0.0
    if scene.device is not None and cuts:
        return scene
    return excerpt(scene, settings_of(of_model(scene), quick=quick)[0].changes, quick=quick)


def excerpt(scene: Scene, coarse: Changes, *, quick: bool) -> Scene:
    """Return the scene up to `EXCERPT_S` after the first contact, with less bone around the path.

    The tool path is the same whether a hand or the scene's motion moves the tool. If a hand moves
    the tool, the run lasts `LATE_S` longer. ``coarse`` contains the scene values that define a
    coarse setting. The time of the first contact is computed with this setting.
    """
    if isinstance(scene.tool, Tool):
        # a hand deviates from its path, so it needs more margin of the scene
        margin = (
            MARGIN_MM
            if scene.device is None
            else max(MARGIN_MM, min(scene.voxels.margin_mm, STRAY_MM))
        )
        scene = changed(scene, {"voxels.margin_mm": margin})
    span_s = EXCERPT_S[quick]
    short = _until(scene, _first_contact_s(changed(of_model(scene), coarse), span_s) + span_s)
    if scene.device is None or short.duration_s is None:
        return short
    # times of ticks are whole milliseconds
    return short.model_copy(update={"duration_s": round(short.duration_s + LATE_S, 3)})


def _first_contact_s(scene: Scene, span_s: float) -> float:
    """Return the time [s] at which a scripted tool first touches the tissue, by test runs.

    The result is stored on disk.
    """

    def found() -> Arrays:
        """Run the scene with a duration that is doubled until the tool touches the tissue."""
        whole = _length_s(scene)
        span = span_s
        while span < whole:
            try:
                run = simulate(_until(scene, span), allow_unstable=True)
            except InputError:
                # A scene whose tool does not come near the tissue is refused. With a longer
                # duration it may.
                span *= 2.0
                continue
            if (run.trace["contact_mm2"] > 0.0).any():
                break
            span *= 2.0
        else:
            run = simulate(scene, allow_unstable=True)
        touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)
        if not touching.size:
            raise InputError(
                "scene",
                "have a tool that touches the tissue",
                f"no contact in {scene.name}",
                "change the scene's motion so that the tool reaches the tissue",
            )
        return {"time_s": TICK_S * touching[:1].astype(float)}

    key = (scene_text(scene), span_s, sources())
    return float(cached_arrays("contact", key, found)["time_s"][0])


def _length_s(scene: Scene) -> float:
    """Return the duration of a scene [s], or zero if it is unknown before the run."""
    # the duration of a tool that is pushed by a thrust follows from the force, so it is known only
    # after the run
    if scene.duration_s is not None or not isinstance(scene.motion, PathMotion):
        return scene.duration_s or 0.0
    return float(arc_length(scene.motion.points_mm)[-1]) / scene.motion.feed_mm_s


def _until(scene: Scene, end_s: float) -> Scene:
    """Return the scene with a shorter duration [s].

    The path of the tool is shortened too, because the model of an organ is prepared for contact
    along the whole path.
    """
    if 0.0 < _length_s(scene) <= end_s:
        return scene
    # times of ticks are whole milliseconds
    changes: dict[str, object] = {"duration_s": round(end_s, 3)}
    if isinstance(scene.motion, PathMotion):
        points = np.array(scene.motion.points_mm)
        along = arc_length(points)
        stop = min(scene.motion.feed_mm_s * end_s, along[-1])
        kept = [*points[along < stop].tolist(), *points_along(points, [stop]).tolist()]
        path = tuple((x, y, z) for x, y, z in kept)
        changes["motion"] = scene.motion.model_copy(update={"points_mm": path})
    return scene.model_copy(update=changes)


def measure(scene: Scene, setting: Setting, *, quick: bool) -> Measured:
    """Run a scene with one setting at several tool positions, or repeatedly at one position."""
    places = placed(scene)
    runs = []
    errors = []
    for place in places:
        try:
            runs.append(_run(place, setting))
            forces = force_and_reference_N(runs[-1], place, quick=quick)
        except InputError:
            # A tool that is shifted sideways or deeper may start inside the tissue or touch no
            # tissue.
            if place is scene:
                raise
            continue
        errors.append((force_error(*forces), force_error(*map(means_over_50_ms, forces))))
    # three places give three runs, and the fastest run counts; a single place is run again
    if len(places) == 1 and not (quick and scene.device is not None):
        runs += [_run(scene, setting) for _ in range(REPEATS - 1)]
    # Other work of the machine only adds time.
    run = min(runs, key=lambda each: np.median(each.timing["tick_us"]))
    ticks = run.timing["tick_us"]
    touching = run.trace["contact_mm2"] > 0.0
    touched = ticks[touching] if touching.any() else ticks
    counted = touched[SETTLED:] if len(touched) > SETTLED else touched
    error, error_50_ms = np.max(errors, axis=0).tolist()
    return Measured(
        scene=scene.name,
        setting=setting.name,
        family=setting.family,
        force_error=error,
        error_50_ms=error_50_ms,
        median_us=float(np.median(counted)),
        p99_us=float(np.percentile(counted, 99)),
        # 1 ms, the haptic tick
        missed=int((ticks > 1e3).sum()),
        machine=machine(),
    )


def _run(scene: Scene, setting: Setting) -> Run:
    """Run a scene with the changes of a setting."""
    return simulate(changed(scene, setting.changes), allow_unstable=True)
