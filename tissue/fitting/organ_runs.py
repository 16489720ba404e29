"""Loads of a probe on an organ along a log's poses, by runs with other constants."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import silent
from tissue.builders.registry import builder_of
from tissue.fitting.cutting import CHANNELS
from tissue.fitting.fitted_file import FittedEntry, write_fitted
from tissue.fitting.organ_constants import KEYS, PART
from tissue.models.tissue_model import TICK_S
from tissue.motion.replay import ReplayPoses
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.simulate import tick_count
from tissue.system.workers import worker_pool

__all__ = ["OrganRuns", "Poses"]

LAW_MS = 5.0
"""Time between two solves of a hyperelastic law [ms], the least that a scene may have: measured tissue is not late."""
PAYS_S = 2.0
"""Time of a run from which processes pay, each of which takes as long to start [s]."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Times [s], shape (n,), tips [m], shape (n, 3), and orientations, shape (n, 4), of a log in the scene's frame."""

    times_s: Array
    tips_m: Array
    quaternions: Array


class OrganRuns:
    """Runs of an organ along a log's poses, in this process, or in several where a run takes long.

    Parameters
    ----------
    scene
        The organ and the tool; its motion and device count for nothing.
    poses
        Where the tool went.
    channels
        Loads that are kept, such as ``force_x_N``.
    every
        Ticks between two of them.
    cores
        Processes that may share the runs.

    Attributes
    ----------
    poses
        The same.
    count
        Runs that were made.
    """

    def __init__(
        self, scene: Scene, poses: Poses, channels: Sequence[str] = CHANNELS, *, every: int = 1, cores: int = 1
    ) -> None:
        self.poses, self.count = poses, 0
        self._run, self._cores = partial(_loads, scene, poses, tuple(channels), every), cores
        self._pool: Executor | None = None
        self._ends, self._longest_s = ExitStack(), 0.0

    def __enter__(self) -> "OrganRuns":
        return self

    def __exit__(self, *problem: object) -> None:
        self._ends.close()

    def __call__(self, samples: Sequence[Mapping[str, float]]) -> list[Array]:
        """Loads on the tool [N, N m], torques about its tip, for each set of constants, shape (n, channels) each.

        Parameters
        ----------
        samples
            Values by the names of constants, ``TABLE.MATERIAL.NAME`` or keys of the scene, one set a run.
        """
        self.count += len(samples)
        if self._pool is None and min(self._cores, len(samples)) > 1 and self._longest_s > PAYS_S:
            self._pool = self._ends.enter_context(worker_pool(self._cores))
        if self._pool is not None:
            return list(self._pool.map(self._run, samples))
        found = []
        for sample in samples:
            begun_s = perf_counter()
            found.append(self._run(sample))
            self._longest_s = max(self._longest_s, perf_counter() - begun_s)
        return found


def _loads(scene: Scene, poses: Poses, channels: tuple[str, ...], every: int, values: Mapping[str, float]) -> Array:
    """The loads of one run."""
    with TemporaryDirectory(prefix="tissue-fit-") as name:
        with_values = _with(scene, values, Path(name, "sample.toml"))
        motion = ReplayPoses(poses.times_s, poses.tips_m, poses.quaternions, step_s=TICK_S)
        stands_in = ReplayMotion(kind="replay", file="poses that were given")
        prompt = {"interval_ms": 0.0, "law_interval_ms": LAW_MS}
        organ = with_values.organ.model_copy(update=prompt)
        ran = with_values.model_copy(update={"motion": stands_in, "device": None, "duration_s": None, "organ": organ})
        build = builder_of(ran.anatomy.kind)
        parts = build(ran, motion, step_s=TICK_S, compute="cpu", cores=1, report=silent)
    ticks = tick_count(ran, motion)
    loop = Loop(parts, ticks=ticks, output=ran.output)
    loop.place()
    with undisturbed():
        for _ in range(ticks):
            loop.wait()
            loop.step()
    loop.finish()
    found = np.column_stack([loop.trace[f"model_{name}"] for name in channels])[::every]
    if not np.isfinite(found).all():
        raise InputError("measured must hold poses that the organ's contact can follow, got one without a force")
    return np.asarray(found, dtype=np.float64)


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
