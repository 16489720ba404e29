"""Bases of the environments: ticks, observation and reward, and bone that can be restored."""

from abc import abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from os import PathLike
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Singles
from meshes.base.errors import InputError, enumerated, require_positive, require_range
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.materials.scene_constants import Materials
from tissue.models.bone.model import BoneModel
from tissue.models.state import State, copied, put_back
from tissue.models.tissue_model import TICK_S, Response, TissueModel, ToolMotion
from tissue.motion.motion import Motion
from tissue.scene.used_constants import used_of_cutting
from tissue.simulation.builders.arguments import given_note
from tissue.simulation.builders.cutting import VoxelBone
from tissue.simulation.loop import Stepper

FORCE_WEIGHT = 1.0
"""Penalty for an episode in which the force is always twice the limit."""
TIME_WEIGHT = 0.1
"""Penalty for the time of a whole episode.

Without any action, the score is the negative of this value.
"""


@dataclass(frozen=True)
class Entry:
    """Group of numbers in an observation.

    Attributes
    ----------
    name
        Name of the quantity.
    scale
        Value of the quantity, in `unit`, that corresponds to 1 in the observation. Larger values
        are clipped to 1.
    unit
        Unit of the scale.
    count
        Number of values in the group.
    """

    name: str
    scale: float
    unit: str
    count: int = 1


class ContactEnvironment(gymnasium.Env[Any, Singles], Motion):
    """Environment in which a policy moves a tool against tissue.

    The environment object is also the `Motion` that moves the tool in the simulation.

    In a step, one action is applied for `ticks` ticks, each of 1 ms. The numbers of an action lie
    in [-1, 1]. The observation consists of the values of `entries`, each divided by its scale and
    clipped to [-1, 1]. Forces and torques in the observation are means over the step. The reward of
    a step is::

        P(after) - P(before)
            - 1.0 / M * sum over the ticks of max(0, F / limit - 1)
            - 0.1 * ticks / M

    Here P is the potential of the task, and F is the magnitude of the contact force in a tick of
    the step. M is the number of ticks of a whole episode. ``info`` has the keys ``reward_terms``
    (parts of the reward) and ``drawn`` (random draws of the episode). It also contains the largest
    force of the step in ``peak_force_N``, and the sum of rewards so far in ``score``.

    Parameters
    ----------
    ticks
        Number of ticks of 1 ms in a step, 1 to 200.
    duration_s
        Time after which an episode is truncated [s]; None for the default of the task.
    force_limit_N
        Contact force above which the reward is reduced [N]; None for the default of the task.
    """

    entries: ClassVar[tuple[Entry, ...]]
    action_count: ClassVar[int]
    ranges: ClassVar[Mapping[str, tuple[float, float]]]
    """Limits of the quantities that an episode draws uniformly.

    `reset(options={...})` sets any of these quantities to a fixed value.
    """
    usual_duration_s: ClassVar[float]
    usual_force_limit_N: ClassVar[float]
    episode: ClassVar[tuple[str, ...]] = ()
    """Names of additional attributes that `reset` or a step changes."""
    solve_ticks: ClassVar[int] = 1
    """Number of ticks of motion between two solutions of the tissue within a step."""

    def __init__(
        self,
        *,
        ticks: int = 20,
        duration_s: float | None = None,
        force_limit_N: float | None = None,
    ) -> None:
        # from one action per tick to five actions per second
        self.ticks = int(require_range("ticks", ticks, 1, 200, "use 20 for 50 actions a second"))
        self.force_limit_N = require_positive(
            "force_limit_N",
            self.usual_force_limit_N if force_limit_N is None else force_limit_N,
            f"use a value such as {self.usual_force_limit_N:g}",
        )
        self.duration_s = require_range(
            "duration_s",
            self.usual_duration_s if duration_s is None else duration_s,
            # An episode must last several steps. The limit of ten minutes detects typing errors.
            0.1,
            600.0,
            f"use a value such as {self.usual_duration_s:g}",
        )
        self._steps = max(round(self.duration_s / (self.ticks * TICK_S)), 1)
        self._scales = np.concatenate([np.full(each.count, each.scale) for each in self.entries])
        self.action_space = spaces.Box(-1.0, 1.0, (self.action_count,), np.float32)
        self.observation_space = spaces.Box(-1.0, 1.0, self._scales.shape, np.float32)
        self._done_steps = 0
        self.score = 0.0
        self._loads = np.zeros(6)
        self._wrench = np.zeros(6)
        self._command = np.zeros(self.action_count)
        self.drawn: dict[str, float] = {}
        """Random draws of the current episode."""

    @cached_property
    def stepper(self) -> Stepper:
        """Object that advances the motion and the tissue tick by tick, made at the first reset."""
        return Stepper(self, self.model, balances=self.balances)

    @property
    def tool(self) -> ToolMotion:
        """Current pose of the tool."""
        return self.stepper.tool

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode with random draws of the quantities in `ranges`.

        `options` sets fixed values for some of these quantities.

        Raises
        ------
        InputError
            If an option is unknown or out of range.
        """
        super().reset(seed=seed)
        self.drawn = {
            name: float(self.np_random.uniform(*limits)) for name, limits in self.ranges.items()
        }
        for name, value in (options or {}).items():
            if name not in self.ranges:
                raise InputError(
                    "options",
                    f"have only the keys {enumerated(self.ranges)}",
                    f"the key {name}",
                    f"remove the key {name}",
                )
            self.drawn[name] = require_range(
                f"options[{name!r}]", value, *self.ranges[name], "use a value in this range"
            )
        self._done_steps = 0
        self.score = 0.0
        self._loads[:] = 0.0
        self._wrench = np.zeros(6)
        self._prepare()
        self.stepper.place()
        return self._observe(), {"drawn": dict(self.drawn), "score": 0.0, **self._facts()}

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Apply one action for `ticks` ticks."""
        self._require_episode("step")
        command = np.clip(self._checked(action), -1.0, 1.0)
        start = self._potential()
        peak = 0.0
        excess = 0.0
        self._loads[:] = 0.0
        for done in range(0, self.ticks, self.solve_ticks):
            count = min(self.solve_ticks, self.ticks - done)
            before = self._wrench
            self._wrench = wrench = self._tick(command, count).copy()
            # Sum over the ticks between two solutions; the loads are interpolated linearly.
            mean = (0.5 - 0.5 / count) * before + (0.5 + 0.5 / count) * wrench
            self._loads += count * mean
            first = before + (wrench - before) / count
            peak = max(peak, _force(first), _force(wrench))
            excess += count * max(_force(mean) / self.force_limit_N - 1.0, 0.0)
        self._loads /= self.ticks
        self._done_steps += 1
        after = self._potential()
        terms = {name: after[name] - start[name] for name in after}
        terms["force"] = -FORCE_WEIGHT * excess / (self._steps * self.ticks)
        terms["time"] = -TIME_WEIGHT / self._steps
        reward = float(sum(terms.values()))
        self.score += reward
        terminated = self._is_over()
        info = {
            "reward_terms": terms,
            "peak_force_N": peak,
            "score": self.score,
            "drawn": dict(self.drawn),
        }
        truncated = not terminated and self._done_steps >= self._steps
        return self._observe(), reward, terminated, truncated, info | self._facts()

    def _checked(self, action: ArrayLike) -> Array:
        """Return an action as an array; refuse an action of another shape."""
        wanted = (self.action_count,)
        found: Array | None = None
        with suppress(TypeError, ValueError):
            found = np.asarray(action, np.float64)
        if found is None or found.shape != wanted:
            raise InputError(
                "action",
                f"be an array of shape {wanted}, with numbers in [-1, 1]",
                "an object of another type"
                if found is None
                else f"an array of shape {found.shape}",
                "call env.action_space.sample() to see an example",
            )
        return found

    def snapshot(self) -> State:
        """Return a copy of the state, which can be pickled.

        The state contains the tissue, the tool, the episode and the random generator. The state can
        be restored in any environment made with the same arguments.
        """
        self._require_episode("snapshot")
        return {
            "own": copied(self, self._kept),
            "stepper": self.stepper.state(),
            "random": self.np_random.bit_generator.state,
        }

    def restore(self, snapshot: State) -> None:
        """Restore a snapshot of this environment, or of another with the same arguments."""
        self.drawn = dict(snapshot["own"]["drawn"])
        self._prepare()
        put_back(self, snapshot["own"])
        self.stepper.restore(snapshot["stepper"])
        self.np_random.bit_generator.state = snapshot["random"]

    @property
    def _kept(self) -> tuple[str, ...]:
        """Names of the attributes that `reset` or a step changes."""
        return ("drawn", "score", "_done_steps", "_loads", "_wrench", "_command", *self.episode)

    @property
    def time_left(self) -> float:
        """Remaining share of the episode's duration, from 1 (start) to 0 (end)."""
        return 1.0 - self._done_steps / self._steps

    @property
    def mean_force_N(self) -> Array:
        """Mean contact force of the last step [N], shape (3,)."""
        return self._loads[:3].copy()

    @property
    def _loads_shown(self) -> tuple[Array, Array]:
        """Mean force [N] and torque [N mm] of the last step."""
        return self._loads[:3], 1e3 * self._loads[3:]

    def named(self, observation: Any) -> dict[str, Array]:
        """Return the values of an observation in their units, keyed by the names of `entries`."""
        values = np.asarray(observation, np.float64) * self._scales
        places = np.cumsum([e.count for e in self.entries])
        return {
            entry.name: values[end - entry.count : end]
            for entry, end in zip(self.entries, places.tolist(), strict=True)
        }

    def _scaled(self, *values: ArrayLike) -> Singles:
        """Return the scaled values of `entries` as an observation."""
        whole = np.concatenate([np.atleast_1d(each) for each in values])
        return np.clip(whole / self._scales, -1.0, 1.0).astype(np.float32)

    def _require_episode(self, method: str) -> None:
        if not self.drawn:
            raise InputError(
                method, "be called after reset", "a call before reset", "call reset first"
            )

    @property
    @abstractmethod
    def model(self) -> TissueModel:
        """Model of the tissue."""

    @abstractmethod
    def _prepare(self) -> None:
        """Restore the tissue, and apply the random draws of the episode."""

    def _tick(self, command: Array, count: int) -> Array:
        """Advance by `count` ticks; return force [N] and torque [N m] on the tool, shape (6,)."""
        self._command = command
        # The motions of environments do not depend on the time.
        self.stepper.step(0, step_s=count * TICK_S)
        return self._felt(self.stepper.response)

    def _felt(self, response: Response) -> Array:
        """Return the loads on the tool in a tick, from the response of the tissue."""
        return response.wrench

    @abstractmethod
    def _potential(self) -> dict[str, float]:
        """Return the terms of the potential, whose sum is 0 at the start of an episode."""

    @abstractmethod
    def _is_over(self) -> bool:
        """Return whether the task has ended."""

    @abstractmethod
    def _observe(self) -> Any:
        """Return the observation for a policy."""

    @abstractmethod
    def _facts(self) -> dict[str, Any]:
        """Return additional entries of ``info``."""


def _force(wrench: Array) -> float:
    """Return the magnitude [N] of the force in a wrench."""
    return sqrt(wrench[:3].dot(wrench[:3]))


LAYER_BITS = 255
"""Mask of the layer in the material word of a voxel.

The upper half of the word is the density [kg/m3].
"""


class BoneEnvironment(ContactEnvironment):
    """Environment whose tool cuts voxels of bone.

    Parameters
    ----------
    materials
        File of constants that replace the built-in constants, in the format that `tissue fit`
        writes.
    options
        As for `ContactEnvironment`.
    """

    cutter: ClassVar[Cutter]
    """Cutter of the environment."""

    def __init__(self, *, materials: str | PathLike[str] | None = None, **options: Any) -> None:
        super().__init__(**options)
        self._materials = materials

    @property
    @abstractmethod
    def volume(self) -> VoxelVolume:
        """Voxels of the bone with their layers."""

    @cached_property
    def model(self) -> BoneModel:
        """Model of the bone under the cutter; made at the first reset."""
        volume = self.volume
        given = Materials.of(self._materials)
        layers = volume.layer_names
        used = used_of_cutting(given, layers, bone="bone", stated={}, has_reference_density=False)
        given_note(given, used, layers=layers, by="environment")
        # The material applies to layers that have no coefficients of their own. Environments run in
        # parallel, so each one uses one core.
        bone = VoxelBone(volume, given.coefficients(layers, {}, bone="bone"))
        model = bone.model(self.cutter, shell_spacing_m=volume.spacing_m, cores=1)
        self._uncut = model.state()
        self._material = model.store.material.numpy()
        self._uncut_content = model.store.remaining.numpy().copy()
        return model

    def restore_bone(self, density_kg_m3: Mapping[str, float]) -> None:
        """Restore the uncut bone, and set the densities [kg/m3] of the given layers."""
        names = self.model.store.grid.layer_names
        self.model.restore(self._uncut)
        layer = self._material & LAYER_BITS
        density = self._material >> 16
        for name, value in density_kg_m3.items():
            density[layer == names.index(name)] = round(value)
        np.copyto(self._material, density << 16 | layer)
