"""Run a scene at a setting; measure the time of a tick and the error of its force against the reference."""

from dataclasses import asdict, dataclass, fields
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError
from meshes.shapes.polyline import arc_length, points_along
from tissue.evaluation.charts.keys import machine, scene_text, setting_key, sources
from tissue.evaluation.charts.places import placed
from tissue.evaluation.charts.reference import force_and_reference_N, of_model
from tissue.evaluation.charts.settings import Changes, Setting
from tissue.evaluation.reference.error import means_over_50_ms
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.load import changed
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Probe, Tool
from tissue.simulation.run import Run
from tissue.simulation.simulate import TICK_S, simulate

__all__ = [
    "SETTLED",
    "Measured",
    "counts",
    "excerpt",
    "measure",
]

EXCERPT_S = {True: 1.2, False: 3.0}
"""Time that is run beyond the first contact [s], quick or not."""
LATE_S = 0.3
"""How much later than a path a hand on it may come [s]."""
MARGIN_MM = 0.5
"""Bone around what a script reaches, the least that a scene takes: no force needs more, and building grows with it."""
STRAY_MM = 1.5
"""The same by hand, which strays from the path."""
REPEATS = 2
"""Runs of a setting at one place, of which the faster counts; a quick chart of a loop makes do with one."""
SETTLED = 20
"""Ticks in contact that are not counted: the first ones load code."""


@dataclass(frozen=True)
class Measured:
    """Time of a tick and force error of one setting.

    Attributes
    ----------
    key
        Hash of everything that was run.
    scene, setting, family, leaves_out
        Of what; rows of the families law and rounding are no settings.
    force_error
        ||F - F_ref|| / ||F_ref|| over the run, the worst of the places it was run at; of a law F_ref is neo-Hookean.
    error_50_ms
        The same of means over 50 ms; NaN in rows that are no settings.
    median_us, p99_us, missed
        Tick in contact [us], and ticks over 1 ms.
    far_us
        Median tick out of contact [us]; NaN where there was none.
    engaged_mm2, step_mm
        Mean area in contact, and edge of a voxel or element.
    elements, met
        What a tick grows with: elements of a cutter and voxels over its area of contact; of an organ contacts that a
        tick visits, in all its sweeps, and other contacts that these meet.
    built_s
        Time to build the scene, run it and find its error [s], of one run.
    machine
        Where.
    """

    key: str
    scene: str
    setting: str
    family: str
    leaves_out: str
    force_error: float
    error_50_ms: float
    median_us: float
    p99_us: float
    missed: int
    far_us: float
    engaged_mm2: float
    elements: int
    step_mm: float
    met: float
    built_s: float
    machine: str

    def row(self) -> dict[str, str]:
        """Values as text, so that reading them back gives the same bits."""
        return {name: repr(value) if isinstance(value, float) else str(value) for name, value in asdict(self).items()}

    @classmethod
    def of_row(cls, row: dict[str, str]) -> "Measured":
        """From a table's row."""
        return cls(**{each.name: each.type(row[each.name]) for each in fields(cls)})  # type: ignore[operator]


def excerpt(scene: Scene, coarse: Changes, *, quick: bool) -> Scene:
    """The scene up to some time after its path first touches, with little tissue around it.

    A hand is given the path that a script is, and more time for being late, so that both have the same references.
    """
    if isinstance(scene.tool, Tool):
        margin = MARGIN_MM if scene.device is None else max(MARGIN_MM, min(scene.voxels.margin_mm, STRAY_MM))
        scene = changed(scene, {"voxels.margin_mm": margin})
    end = _first_contact_s(changed(of_model(scene), coarse), EXCERPT_S[quick]) + EXCERPT_S[quick]
    short = _until(scene, end)
    if scene.device is None or short.duration_s is None:
        return short
    return short.model_copy(update={"duration_s": round(short.duration_s + LATE_S, 3)})


def _first_contact_s(scene: Scene, span_s: float) -> float:
    """When a script first touches [s], found on as little of it as will do and kept on disk."""

    def found() -> dict[str, NDArray[np.generic]]:
        """Time of the first contact, on twice as much of the scene until there is one."""
        whole, span = _length_s(scene), span_s
        while True:
            try:
                run = simulate(_until(scene, span) if span < whole else scene, allow_unstable=True)
                touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)
                if touching.size:
                    return {"time_s": TICK_S * touching[:1].astype(float)}
                if span >= whole:
                    raise InputError(
                        f"scene must touch to be charted, got no contact in {scene.name}: move its tool further"
                    )
            except InputError:
                # A tool that comes nowhere near is refused; further on it may.
                if span >= whole:
                    raise
            span *= 2.0

    key = (scene_text(scene), span_s, sources())
    return float(np.asarray(cached_arrays("contact", key, found)["time_s"])[0])


def _length_s(scene: Scene) -> float:
    """Length of a scene; zero where only its run can show it, so that the first try is all of it."""
    if scene.duration_s is not None or not isinstance(scene.motion, PathMotion):
        return scene.duration_s or 0.0
    return float(arc_length(scene.motion.points_mm)[-1]) / scene.motion.feed_mm_s


def _until(scene: Scene, end_s: float) -> Scene:
    """The scene up to a time; a path ends there, since an organ is only made ready where the tool can go."""
    if 0.0 < _length_s(scene) <= end_s:
        return scene
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
    """Run a scene, already cut to its excerpt, at a setting: once at each place, or again where there is only one."""
    started, places, runs, errors = perf_counter(), placed(scene), [], []
    for count, place in enumerate(places):
        try:
            runs.append(_run(place, setting))
            got, wanted = force_and_reference_N(runs[-1], place, quick=quick)
            errors.append((force_error(got, wanted), force_error(means_over_50_ms(got), means_over_50_ms(wanted))))
        except InputError:
            # Aside or deeper a tool may start inside the tissue or meet none.
            if count == 0:
                raise
    if len(places) == 1 and not (quick and scene.device is not None):
        runs += [_run(scene, setting) for _ in range(REPEATS - 1)]
    took = (perf_counter() - started) / len(runs)
    # What else the machine does only adds time.
    run = min(runs, key=lambda each: float(np.median(each.timing["tick_us"])))
    trace, ticks = run.trace, run.timing["tick_us"]
    touching = trace["contact_mm2"] > 0.0
    touched = np.flatnonzero(touching) if touching.any() else np.arange(len(ticks))
    counted = touched[SETTLED:] if len(touched) > SETTLED else touched
    far = ticks[~touching]
    elements, met, step = counts(run, counted)
    return Measured(
        key=setting_key(scene, setting, quick=quick),
        scene=scene.name,
        setting=setting.name,
        family=setting.family,
        leaves_out=setting.leaves_out,
        force_error=max(error for error, _ in errors),
        error_50_ms=max(error for _, error in errors),
        median_us=float(np.median(ticks[counted])),
        p99_us=float(np.percentile(ticks[counted], 99)),
        missed=int((ticks > 1e3).sum()),
        far_us=float(np.median(far)) if far.size else float("nan"),
        engaged_mm2=float(trace["contact_mm2"][counted].mean()),
        elements=elements,
        step_mm=step,
        met=met,
        built_s=took,
        machine=machine(),
    )


def _run(scene: Scene, setting: Setting) -> Run:
    at = changed(scene, setting.changes)
    return simulate(at, compute=setting.compute, cores=setting.cores, allow_unstable=True)


def counts(run: Run, counted: NDArray[np.intp]) -> tuple[int, float, float]:
    """Elements or visits, what they meet, and the edge of a voxel or element [mm]."""
    tissue, scene, trace = run.parts.tissue, run.scene, run.trace
    if run.parts.cutter is not None:
        from tissue.models.bone.model import BoneModel
        from tissue.models.tooth.model import ToothModel

        milling = tissue.milling if isinstance(tissue, ToothModel) else tissue
        assert isinstance(milling, BoneModel)
        step = scene.voxels.spacing_mm
        return len(milling.shell.areas_m2), float(trace["contact_mm2"][counted].mean()) / step**2, step
    if isinstance(scene.anatomy, SoftAnatomy) and isinstance(scene.tool, Probe):
        contacts, sweeps = trace["contact_points"][counted], trace["sweeps"][counted]
        visits, pairs = float(np.median(contacts * sweeps)), float(np.median(contacts**2 * sweeps))
        return round(visits), pairs, scene.anatomy.touch_edge_mm or 0.25 * scene.tool.size_mm
    return 1, 1.0, 1.0
