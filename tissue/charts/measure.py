"""Run a scene at a setting and say what a tick costs and how far its force is from the converged, undelayed one."""

import hashlib
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.cache import cached_arrays
from meshes.errors import InputError
from tissue.charts.settings import Changes, Setting, finest, nearly_finest
from tissue.ideal import ideal_force_N, played_force_N
from tissue.load import changed
from tissue.run import Run
from tissue.scene import Scene
from tissue.scene_soft import LiverAnatomy, SlabAnatomy
from tissue.scene_tool import PathMotion, Probe
from tissue.simulation import TICK_S, simulate
from tissue.statistics.metrics import force_error

__all__ = ["Measured", "excerpt", "machine", "measure", "reference_gap", "setting_key"]

Array = NDArray[np.float64]
EXCERPT_S = {True: 1.2, False: 3.0}
"""Time that is run beyond the first contact [s], quick or not."""
REPEATS = 2
"""Runs of each setting, of which the faster counts."""
SETTLED = 20
"""Ticks in contact that are not counted: the first ones load code."""


@dataclass(frozen=True)
class Measured:
    """What one setting costs and what it is worth.

    Attributes
    ----------
    key
        Hash of everything that was run.
    scene, setting, family, leaves_out
        Of what.
    force_error
        ||F - F_ref|| / ||F_ref|| over the run.
    median_us, p99_us, missed
        Tick in contact [us], and ticks over 1 ms.
    far_us
        Median tick out of contact [us]; NaN where there was none.
    engaged_mm2, elements, step_mm
        Mean area in contact, elements of the tool or contact points, and edge of a voxel or element: what a tick may
        grow with.
    built_s
        Time to build the scene and run it [s].
    machine
        Where.
    """

    key: str
    scene: str
    setting: str
    family: str
    leaves_out: str
    force_error: float
    median_us: float
    p99_us: float
    missed: int
    far_us: float
    engaged_mm2: float
    elements: int
    step_mm: float
    built_s: float
    machine: str

    def row(self) -> dict[str, str]:
        """Values as text, so that reading them back gives the same bits."""
        return {name: repr(value) if isinstance(value, float) else str(value) for name, value in asdict(self).items()}

    @classmethod
    def of_row(cls, row: dict[str, str]) -> "Measured":
        """From a table's row."""
        kinds = {"missed": int, "elements": int}
        numbers = {"force_error", "median_us", "p99_us", "far_us", "engaged_mm2", "step_mm", "built_s"}
        return cls(**{k: float(v) if k in numbers else kinds.get(k, str)(v) for k, v in row.items()})  # type: ignore[arg-type]


def machine() -> str:
    """What a cost belongs to: processor, cores, and the versions that compute."""
    import psutil

    return (
        f"{platform.machine()} {psutil.cpu_count()} cores {platform.system()}; tissue {version('tissue-sim')}, "
        f"warp {version('warp-lang')}, numpy {version('numpy')}, Python {platform.python_version()}"
    )


def setting_key(scene: Scene, setting: Setting, *, quick: bool) -> str:
    """Hash of a scene at a setting and of the machine."""
    text = f"{_plain(changed(scene, setting.changes))}|{setting.cores}|{setting.compute}|{quick}|{machine()}"
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def _plain(scene: Scene) -> str:
    """A scene without its words and its wishes."""
    return scene.model_copy(update={"description": "", "fidelity": None}).to_toml()


def excerpt(scene: Scene, coarse: Changes, *, quick: bool) -> Scene:
    """The scene up to some time after its first contact, found with a coarse setting."""
    run = simulate(changed(scene, coarse), allow_unstable=True)
    touching = np.flatnonzero(run.trace["contact_mm2"] > 0.0)
    if touching.size == 0:
        raise InputError(f"scene must touch to be charted, got no contact in {scene.name}: move its tool further")
    end = min(TICK_S * float(touching[0]) + EXCERPT_S[quick], TICK_S * len(run.trace.rows))
    changes: dict[str, Any] = {"duration_s": max(round(end, 3), TICK_S)}
    if isinstance(scene.motion, PathMotion):
        changes["motion"] = _cut_off(scene.motion, end)
    return scene.model_copy(update=changes)


def _cut_off(motion: PathMotion, end_s: float) -> PathMotion:
    """A path up to where it is at a time: an organ is only made ready where the tool can go."""
    points = np.array(motion.points_mm)
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    stop = min(motion.feed_mm_s * end_s, along[-1])
    last = [float(np.interp(stop, along, points[:, axis])) for axis in range(3)]
    kept = [*points[along < stop].tolist(), last]
    return motion.model_copy(update={"points_mm": tuple((x, y, z) for x, y, z in kept)})


def measure(scene: Scene, setting: Setting, *, quick: bool) -> Measured:
    """Run a scene, already cut to its excerpt, at a setting."""
    chosen = changed(scene, setting.changes)
    started = perf_counter()
    runs = [simulate(chosen, compute=setting.compute, cores=setting.cores, allow_unstable=True) for _ in range(REPEATS)]
    took = (perf_counter() - started) / REPEATS
    # What else the machine does only adds time.
    run = min(runs, key=lambda each: float(np.median(each.timing["tick_us"])))
    trace, ticks = run.trace, run.timing["tick_us"]
    touching = trace["contact_mm2"] > 0.0
    counted = np.flatnonzero(touching)[SETTLED:]
    if counted.size == 0:
        counted = np.flatnonzero(touching) if touching.any() else np.arange(len(ticks))
    far = ticks[~touching]
    elements, step = _counts(run)
    return Measured(
        key=setting_key(scene, setting, quick=quick),
        scene=scene.name,
        setting=setting.name,
        family=setting.family,
        leaves_out=setting.leaves_out,
        force_error=_error(run, scene, quick=quick),
        median_us=float(np.median(ticks[counted])),
        p99_us=float(np.percentile(ticks[counted], 99)),
        missed=int((ticks > 1e3).sum()),
        far_us=float(np.median(far)) if far.size else float("nan"),
        engaged_mm2=float(trace["contact_mm2"][counted].mean()),
        elements=elements,
        step_mm=step,
        built_s=took,
        machine=machine(),
    )


def reference_gap(scene: Scene, *, quick: bool) -> float:
    """Distance of the finest setting to one a step coarser: below it nothing is told apart."""
    model = _of_model(scene)
    changes = nearly_finest(model, quick=quick)
    if not changes:
        return 0.0
    return force_error(_forces(model, changes), _forces(model, finest(model, quick=quick)))


def _of_model(scene: Scene) -> Scene:
    """The same scene moved by its script."""
    return changed(scene, {"device": "none", "prediction": "none", "perception": "none"})


def _error(run: Run, scene: Scene, *, quick: bool) -> float:
    """Error of a run's force against the converged one on the same motion."""
    changes = finest(scene, quick=quick)
    if scene.device != "none":
        return force_error(played_force_N(run.trace), ideal_force_N(run, changes))
    return force_error(run.trace.vectors("model_force", "N"), _forces(scene, changes))


def _forces(scene: Scene, changes: Changes) -> Array:
    """Force on the tool over time [N], shape (n, 3), kept on disk."""
    at = changed(scene, changes)
    forces = cached_arrays(
        "reference",
        (_plain(at), version("tissue-sim"), version("warp-lang")),
        lambda: {"force_N": simulate(at).trace.vectors("model_force", "N")},
    )
    return np.asarray(forces["force_N"], dtype=np.float64)


def _counts(run: Run) -> tuple[int, float]:
    """Elements of the tool or touchable nodes, and edge of a voxel or element [mm]."""
    tissue, scene = run.parts.tissue, run.scene
    if run.parts.cutter is not None:
        from tissue.tooth.model import ToothModel

        milling: Any = tissue.milling if isinstance(tissue, ToothModel) else tissue
        return len(milling.shell.areas_m2), scene.voxels.spacing_mm
    if isinstance(scene.anatomy, LiverAnatomy | SlabAnatomy) and isinstance(scene.tool, Probe):
        from tissue.liver import LiverModel

        assert isinstance(tissue, LiverModel)
        return len(tissue.contact.point_forces_N()), scene.anatomy.touch_edge_mm or 0.25 * scene.tool.diameter_mm
    return 1, 1.0
