"""Constants of an organ and its contact that a fit can estimate, and runs of the organ."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import silent
from tissue.fitting.bands.sample import sample_text
from tissue.fitting.log_files import CHANNELS
from tissue.fitting.problem import Parameter, chosen
from tissue.materials.constants import Prior
from tissue.models.tissue_model import TICK_S
from tissue.motion.replay import ReplayPoses
from tissue.scene.load import changed
from tissue.scene.organ import LAW_SHAPES, SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import ReplayMotion
from tissue.scene.used_constants import used_constants
from tissue.simulation.builders.organ import NODULE_KPA, PART_NODULE
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.simulate import builder_of, tick_count
from tissue.system.workers import worker_pool

KEYS = "organ."
PART = "organ.parts."
"""Prefix of the name of a modulus that belongs to a part of the organ.

Like the names with the prefix `KEYS`, these names are keys of the scene and not constants of a
material.
"""
FRICTION = (0.25, 2.5)
"""5 and 95 % quantiles of the friction between tool and organ, relative to the scene's friction.

Friction of wet tissue on metal is 0.1 to 0.6 (from memory of the literature).
"""
MODULUS = (1.0 / 3.0, 3.0)
"""5 and 95 % quantiles of a modulus that the scene sets, relative to the scene's value.

The range is the scatter of the modulus of liver in tissue/materials/soft.toml.
"""
SHAPE = (0.4, 2.5)
"""5 and 95 % quantiles of shape constants of a hyperelastic law, relative to the scene's values.

The range is assumed, because no source gives a range for an organ.
"""
SHAPES = tuple(chain.from_iterable(LAW_SHAPES.values()))
"""Keys in the table `organ` of a scene for the shape constants of hyperelastic laws."""
SHARE = "second_share"
NEAREST = 0.1
"""Smallest ratio (1 - q) / (1 - s) in the prior of `second_share`.

The 95 % quantile is q, and the scene's value is s. The ratio is assumed. It keeps the share below
1, which is its physical bound. The other shape constants have no physical bound.
"""


def organ_parameters(
    scene: Scene, free: Sequence[str]
) -> tuple[tuple[Parameter, ...], tuple[int, ...]]:
    """Return the free parameters and the indices of the moduli that scale the loads.

    The loads are proportional to these moduli if all of them change by the same factor. The tuple
    of indices is empty if the organ deforms under its own weight, or if a modulus is not free.

    Raises
    ------
    InputError
        If `free` contains a name that selects no free parameter.
    """
    cited, stiffnesses = _cited(scene)
    stated = _stated(scene)
    shapes = {"organ.friction", *(f"organ.{name}" for name in SHAPES)}
    stiffnesses |= {each.name for each in stated if each.name not in shapes}
    parameters = tuple(chosen(free, [*cited, *stated]))
    places = tuple(at for at, each in enumerate(parameters) if each.name in stiffnesses)
    together = len(places) == len(stiffnesses) and not scene.organ.gravity
    # with weight or a fixed modulus, scaling the free moduli does not scale the loads
    return parameters, places if together else ()


def _cited(scene: Scene) -> tuple[list[Parameter], set[str]]:
    """Return the constants of the organ's material that the scene does not set.

    The second result holds the names of all moduli among these constants.
    """
    used = [
        each
        for each in used_constants(scene, ())
        if each.full.startswith("soft.") and each.stated is None
    ]
    free = [
        Parameter(each.full, Prior.of(each.cited, each.full))
        for each in used
        if each.cited.low < each.cited.high
    ]
    return free, {each.full for each in used if each.name == "modulus_kPa"}


def _stated(scene: Scene) -> list[Parameter]:
    """Return the moduli, the friction and the shape constants that the keys of the scene set.

    The modulus of a nodule (a stiffer or softer ball in the organ) is included. A constant with a
    value of 0 or below, or a share of 1, has no range and stays fixed.
    """
    organ = scene.organ
    anatomy = scene.anatomy
    assert isinstance(anatomy, SoftAnatomy)
    parts = dict(organ.parts or {})
    # the nodule of a slab is a part with a default modulus
    if anatomy.nodule_mm > 0.0:
        parts.setdefault(PART_NODULE, NODULE_KPA)
    found = {"organ.young_kPa": organ.young_kPa, "organ.young_end_kPa": organ.young_end_kPa}
    found |= {f"{PART}{name}": modulus for name, modulus in parts.items()}
    moduli = [
        Parameter(name, Prior(value, MODULUS[0] * value, MODULUS[1] * value))
        for name, value in found.items()
        if value is not None
    ]
    shapes = [
        Parameter(f"organ.{name}", prior)
        for name in SHAPES
        if (value := getattr(organ, name)) is not None
        and (prior := _shape_prior(name, value)) is not None
    ]
    # a prior relative to a value of 0 has no width
    if (friction := organ.friction) == 0.0:
        return [*moduli, *shapes]
    low, high = FRICTION
    return [
        *moduli,
        Parameter("organ.friction", Prior(friction, low * friction, high * friction)),
        *shapes,
    ]


def _shape_prior(name: str, value: float) -> Prior | None:
    """Return the prior of a shape constant of a law, or None if it has no range."""
    low, high = SHAPE
    # a range of factors needs a positive value, and a share of 1 cannot increase
    if value <= 0.0 or (name == SHARE and value >= 1.0):
        return None
    # a share stays below 1: its distance from 1 is multiplied by a factor instead
    if name == SHARE:
        return Prior(
            value, low * value, min(high * value, 1.0 - NEAREST * (1.0 - value)), (0.0, 1.0)
        )
    return Prior(value, low * value, high * value)


LAW_MS = 5.0
"""Time between two solutions of a hyperelastic organ [ms]; the smallest that a scene can set.

A short time is needed because measured tissue has no latency.
"""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a log in the scene's frame.

    The times [s] have shape (n,), the tip positions [m] have shape (n, 3), and the orientations
    have shape (n, 4).
    """

    times_s: Array
    tips_m: Array
    quaternions: Array


class OrganRuns:
    """Simulations of an organ and a tool that moves along the poses of a log.

    Runs are distributed over several processes.

    Parameters
    ----------
    scene
        Scene with the organ and the tool. The motion and the device of the scene are ignored.
    poses
        Poses of the tool.
    channels
        Names of the loads that are kept, such as ``force_x_N``.
    every
        Number of ticks from one kept load to the next.
    cores
        Largest number of processes for the runs.

    Attributes
    ----------
    poses
        Poses of the tool.
    count
        Number of runs so far.
    """

    def __init__(
        self,
        scene: Scene,
        poses: Poses,
        channels: Sequence[str] = CHANNELS,
        *,
        every: int = 1,
        cores: int = 1,
    ) -> None:
        self.poses = poses
        self.count = 0
        self._settings = poses, tuple(channels), every
        self._run = partial(_loads, scene, *self._settings)
        self._cores = cores

    def of(self, scene: Scene, sample: Mapping[str, float]) -> Array:
        """Return the loads of a run of `scene` with the constants `sample` along the same poses."""
        return _loads(scene, *self._settings, sample)

    def __call__(self, samples: Sequence[Mapping[str, float]]) -> list[Array]:
        """Return the loads on the tool, shape (n, channels), for each set of constants.

        The loads are forces [N] and torques about the tip [N m].

        Parameters
        ----------
        samples
            Values keyed by the names of constants: ``TABLE.MATERIAL.NAME`` or a key of the scene.
            Each set is one run.
        """
        self.count += len(samples)
        cores = min(self._cores, len(samples))
        if cores == 1:
            return [self._run(sample) for sample in samples]
        with worker_pool(cores) as pool:
            return list(pool.map(self._run, samples))


def _loads(
    scene: Scene, poses: Poses, channels: tuple[str, ...], every: int, values: Mapping[str, float]
) -> Array:
    """Return the loads of one run."""
    with TemporaryDirectory(prefix="tissue-fit-") as name:
        with_values = _with(scene, values, Path(name, "sample.toml"))
        motion = ReplayPoses(poses.times_s, poses.tips_m, poses.quaternions)
        stands_in = ReplayMotion(kind="replay", file="poses that were given")
        # no frames of the organ are needed, only loads
        prompt = {"interval_ms": 0.0, "law_interval_ms": LAW_MS}
        organ = with_values.organ.model_copy(update=prompt)
        ran = with_values.model_copy(
            update={"motion": stands_in, "device": None, "duration_s": None, "organ": organ}
        )
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
        raise InputError(
            "measured",
            "contain only poses at which the contact with the organ can be computed",
            "a pose at which the computed force is not finite",
            "check the unit and the frame of the poses",
        )
    return np.asarray(found, dtype=np.float64)


def _with(scene: Scene, values: Mapping[str, float], path: Path) -> Scene:
    """Return a scene with replaced constants. Constants of materials are written to a file."""
    changes: dict[str, object] = {}
    parts = dict(scene.organ.parts or {})
    constants: dict[str, float] = {}
    for name, value in values.items():
        if name.startswith(PART):
            parts[name.removeprefix(PART)] = value
        elif name.startswith(KEYS):
            changes[name] = value
        else:
            constants[name] = value
    if constants:
        text = sample_text(scene.constants, tuple(constants), np.array(list(constants.values())))
        path.write_text(text, "utf-8")
        changes["materials"] = str(path)
    if parts:
        changes["organ.parts"] = parts
    return changed(scene, changes)
