"""Loads of a probe on an organ along a log's poses, by runs with other constants."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fitting.fitted_file import FittedEntry, write_fitted
from tissue.models.tissue_model import TICK_S
from tissue.motion.replay import ReplayPoses
from tissue.scene.load import changed
from tissue.scene.named_parts import loaded
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.simulate import tick_count
from tissue.system.workers import worker_pool

__all__ = ["KEYS", "Poses", "organ_loads"]

PART, KEYS = "organ.parts.", "organ."
"""Beginning of the names of what is a key of the scene and no constant of a material."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Times [s], shape (n,), tips [m], shape (n, 3), and orientations, shape (n, 4), of a log in the scene's frame."""

    times_s: Array
    tips_m: Array
    quaternions: Array


def organ_loads(
    scene: Scene, poses: Poses, samples: Sequence[Mapping[str, float]], *, cores: int, report: Progress
) -> list[Array]:
    """Force [N] and torque about the tip [N m] on the tool for each set of constants, shape (ticks, 6) each.

    Parameters
    ----------
    scene
        The organ and the tool; its motion and device count for nothing.
    poses
        Where the tool went.
    samples
        Values by the names of constants, ``TABLE.MATERIAL.NAME`` or keys of the scene, one set a run.
    cores
        Processes that share the runs.
    report
        Called with what is being done.
    """
    run, found = partial(_loads, scene, poses), []
    for number, loads in enumerate(_shared(run, samples, cores)):
        found.append(loads)
        report(f"{number + 1} of {len(samples)} runs of the organ", (number + 1) / len(samples))
    return found


def _shared(run: "partial[Array]", samples: Sequence[Mapping[str, float]], cores: int) -> Iterator[Array]:
    if cores < 2 or len(samples) < 2:
        yield from map(run, samples)
        return
    with worker_pool(min(cores, len(samples))) as pool:
        yield from pool.map(run, samples)


def _loads(scene: Scene, poses: Poses, values: Mapping[str, float]) -> Array:
    """The loads of one run."""
    with TemporaryDirectory(prefix="tissue-fit-") as name:
        with_values = _with(scene, values, Path(name, "sample.toml"))
        motion = ReplayPoses(poses.times_s, poses.tips_m, poses.quaternions, step_s=TICK_S)
        stands_in = ReplayMotion(kind="replay", file="poses that were given")
        organ = with_values.organ.model_copy(update={"interval_ms": 0.0})
        ran = with_values.model_copy(update={"motion": stands_in, "device": "none", "duration_s": None, "organ": organ})
        build = loaded(ANATOMIES[ran.anatomy.kind].build)
        parts = build(ran, motion, step_s=TICK_S, compute="cpu", cores=1, report=silent)
    ticks = tick_count(ran, motion)
    loop = Loop(parts, ticks=ticks, output=ran.output)
    loop.place()
    with undisturbed():
        for _ in range(ticks):
            loop.step()
    loop.finish()
    found = np.hstack([loop.trace.vectors("model_force", "N"), loop.trace.vectors("model_torque", "Nm")])
    if not np.isfinite(found).all():
        raise InputError("measured must hold poses that the organ's contact can follow, got one without a force")
    return np.asarray(found)


def _with(scene: Scene, values: Mapping[str, float], path: Path) -> Scene:
    """A scene with constants in place of its own."""
    given = {name: one.value for name, one in scene.constants.given.items()}
    given |= {name: value for name, value in values.items() if not name.startswith(KEYS)}
    changes: dict[str, object] = {}
    if given:
        entries = [FittedEntry(name, value, value, value, "a sample of a fit", "L") for name, value in given.items()]
        write_fitted(path, entries, np.eye(len(entries)), remark=())
        changes["materials"] = str(path)
    parts = dict(scene.organ.parts or {})
    for name, value in values.items():
        if name.startswith(PART):
            parts[name.removeprefix(PART)] = value
        elif name.startswith(KEYS):
            changes[name] = value
    if parts:
        changes["organ.parts"] = parts
    return changed(scene, changes)
