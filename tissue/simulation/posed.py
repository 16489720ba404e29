"""Session in which a program gives poses of a tool and receives force and torque on the tool."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated
from tissue.models.state import State, fingerprint
from tissue.models.tissue_model import TICK_S, Response, ToolMotion
from tissue.motion.motion import Motion
from tissue.motion.posed import PosedTool, pose_in
from tissue.scene.anatomy import WallAnatomy
from tissue.scene.organ import IncisedAnatomy, LayersAnatomy
from tissue.scene.scene import Output, Scene, without_fields
from tissue.simulation import loop as engine
from tissue.simulation.builders.parts import Parts, motion_of, require_no_pause
from tissue.simulation.simulate import builder_of

ACROSS = 5
"""Number of shifted copies of a path along each of the two axes across the tool's axis.

The tissue is prepared along all copies. The number was chosen by judgement.
"""
LEFT_REGION = "the tool left the region in which the tissue is prepared"
"""First words of the event that reports a tool outside the region with prepared tissue.

A remedy follows these words.
"""
WIDER = "use a larger reach_mm"
"""Remedy for a tip that has left the region with prepared tissue sideways."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State of a session, which can be pickled and restored later.

    The state can be restored in any session that was made with equal arguments.

    Attributes
    ----------
    time_s
        Simulated time [s].
    tissue
        Class and layers of the tissue. A session that restores the snapshot must have the same
        class and layers.
    made_from
        Fingerprint of the constants, the step, the tool and the prepared tissue of the session.
    state
        State of the tool, of the tissue, and of the measured distances to structures.
    """

    time_s: float
    tissue: tuple[str, ...]
    made_from: str
    state: State = field(repr=False)


@dataclass(frozen=True, eq=False)
class Region:
    """Box in which the tissue is prepared for the tip of the tool.

    The edges of the box are parallel to the axes of the tool at the start.

    Attributes
    ----------
    rotation
        Axes of the tool at the start, shape (3, 3).
    low_m, high_m
        Coordinates of two corners of the box along these axes [m], shape (3,) each. The tip may not
        leave the box, except at its top, where the box is open.
    deeper
        Advice that the event reports if the tip is below the box.
    """

    rotation: Array
    low_m: Array
    high_m: Array
    deeper: str = WIDER

    @classmethod
    def of(cls, motion: Motion) -> "Region":
        """Return the smallest region that contains all tip positions of a motion."""
        rotation = motion.rotations()[0].copy()
        tips = motion.sweep_m() @ rotation
        high = tips.max(axis=0)
        high[2] = np.inf
        # The copies of a path lie across the tool's axis, so they are not deeper than the path.
        deeper = "give the motion of the scene a deeper path, because reach_mm adds no depth"
        # 1e-6 m allows for a program that rounds positions to 0.001 mm.
        return cls(rotation, tips.min(axis=0) - 1e-6, high + 1e-6, deeper)

    def remedies(self, tip_m: Array) -> list[str]:
        """Return the advice for a tip outside the region; empty for a tip inside."""
        place = tip_m @ self.rotation
        is_outside = (place < self.low_m) | (place > self.high_m)
        found = [WIDER] if is_outside[:2].any() else []
        if is_outside[2] and self.deeper not in found:
            found.append(self.deeper)
        return found


class _Widened(Motion):
    """Motion along shifted copies of a scene's path, with which the tissue is prepared."""

    def __init__(self, motion: Motion, reach_m: float) -> None:
        self.duration_s = motion.duration_s
        self.balances = motion.balances
        path = motion.sweep_m()
        turns = motion.rotations()
        side = np.linspace(-reach_m, reach_m, ACROSS) if reach_m > 0.0 else np.zeros(1)
        x, y = (each.ravel() for each in np.meshgrid(side, side))
        # The path itself comes first, because a tissue is checked at the start of the motion.
        order = np.argsort(np.hypot(x, y), kind="stable")
        shifts = np.column_stack([x, y, np.zeros(len(x))])[order] @ turns[0].T
        self._path = np.concatenate([path + shift for shift in shifts])
        self._turns = np.concatenate([turns] * len(shifts))
        self._motion = motion

    def sweep_m(self) -> Array:
        """Return the corners of all copies of the path [m]."""
        return self._path

    def rotations(self) -> Array:
        """Return the orientation of the tool at each corner that `sweep_m` returns."""
        return self._turns

    def begin(self, motion: ToolMotion) -> None:
        """Write the start pose of the scene's motion."""
        self._motion.begin(motion)

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Leave the tool at the start, because this motion is only used to prepare the tissue."""


def posed_parts(scene: Scene, *, reach_m: float, cores: int | None) -> tuple[Parts, Region]:
    """Build the objects that simulate a scene, for a tool that is moved to given poses.

    The second result is the region in which the tissue is prepared.

    The anatomy is prepared within `reach_m` [m] around the path of the scene. Stress, heat and
    frames of the scene are not computed, because they do not change the force.

    Raises
    ------
    InputError
        As for `tissue.simulation.simulate.build`.
    """
    left_out = {"device": None, "stress": None, "heat": False, "fidelity": None}
    unused = [name for name, value in left_out.items() if getattr(scene, name) != value]
    scene = without_fields(scene.model_copy(update=left_out))
    require_no_pause(scene)
    motion = _Widened(motion_of(scene), reach_m)
    parts = builder_of(scene.anatomy.kind)(
        scene, motion, step_s=TICK_S, compute="cpu", cores=cores, report=lambda what, share: None
    )
    parts.notes["reach"] = (
        "the tissue is prepared along the path of the scene, to the depth of the path, and "
        f"{1e3 * reach_m:g} mm to its sides"
    )
    if isinstance(scene.anatomy, LayersAnatomy | IncisedAnatomy | WallAnatomy):
        parts.notes["reach"] += (
            ". This tissue is a half-space, so its force is also valid outside this region"
        )
    if unused:
        parts.notes["not used"] = (
            f"{', '.join(unused)} of the scene, because a program moves the tool and only the "
            "force is computed"
        )
    return parts, Region.of(motion)


def scene_arguments(scene: Scene) -> tuple[object, ...]:
    """Return the values of a scene on which the state and the forces of a session depend.

    The output and the times of frames are not included, because they have no effect on the forces.
    """
    frames = {"interval_ms"}
    table = scene.model_dump_json(
        include={"voxels", "tool", "motion", "cutting", "keep_clear", "seed"}
    )
    shapes = [part.model_dump_json(exclude=frames) for part in (scene.anatomy, scene.organ)]
    given = {name: constant.value for name, constant in scene.constants.given.items()}
    return (table, *shapes, given)


class PosedSession:
    """Session in which a program moves a tool to given poses, in steps of whole ticks.

    Parameters
    ----------
    parts
        Objects that simulate the scene. Only the start pose of their motion is used; the later
        poses are given to `step`.
    ticks
        Number of ticks of 1 ms in a step.
    rows
        Number of ticks that the trace keeps.
    made_from
        Constants, tool and tissue from which `parts` was made. A snapshot can be restored only if
        these objects are equal; see `tissue.models.state.fingerprint`.
    keep_ready
        Function that is called with the tip [m] before every tick, to prepare more tissue.
    region
        Region in which the tissue is prepared; None if the tissue has no limits.

    Attributes
    ----------
    loop
        Loop of the session, which contains the trace.
    """

    def __init__(
        self,
        parts: Parts,
        *,
        ticks: int,
        rows: int,
        made_from: tuple[object, ...],
        keep_ready: Callable[[Array], None] | None = None,
        region: Region | None = None,
    ) -> None:
        self._ticks = ticks
        self._keep_ready = keep_ready
        self._region = region
        self._left_region = False
        placed = ToolMotion()
        parts.motion.begin(placed)
        self._start = (placed.tip_m, placed.rotation)
        self._tool = parts.motion = PosedTool(*self._start)
        # Without a cutter the loop keeps no log of poses, which would become full in a long
        # session.
        parts.cutter = None
        self.loop = engine.Loop(parts, ticks=rows, output=Output(low_pass_ms=0.0))
        self._names = (type(parts.tissue).__name__, *parts.tissue.layer_names)
        self._made_from = fingerprint(ticks, region, *made_from)
        self._untouched: State | None = None
        # A tissue that does not support snapshots can still be used.
        with suppress(InputError):
            self._untouched = self.loop.state()
        self.loop.place()

    def step(self, pose: ArrayLike, velocity: ArrayLike | None = None) -> Array:
        """Move the tool to a pose in one step; return the force and the torque on the tool.

        The result has shape (6,), with the force [N] first and then the torque [N m].

        Parameters
        ----------
        pose
            As for `tissue.motion.posed.pose_in`. If the pose has no rotation, the tool keeps its
            orientation.
        velocity
            Velocity of the tip [mm/s], shape (3,), or velocity and angular velocity [rad/s] in one
            array, shape (6,). With None, the velocity is the change of the pose divided by the
            duration of the step.
        """
        loop = self.loop
        present = loop.tool
        tip_m, rotation = pose_in(pose, present.rotation)
        known = None if velocity is None else _velocity(velocity)
        self._tool.aim(present, tip_m, rotation, velocity=known, ticks=self._ticks)
        for _ in range(self._ticks):
            if self._keep_ready is not None:
                self._keep_ready(loop.tool.tip_m)
            loop.wait()
            loop.step()
        region = self._region
        if region is not None and not self._left_region:
            remedies = region.remedies(loop.tool.tip_m)
            self._left_region = bool(remedies)
            if remedies:
                event = f"{LEFT_REGION}: {', and '.join(remedies)}"
                loop.events.append((loop.ticks * TICK_S, event))
        return loop.response.wrench.copy()

    def reset(self, pose: ArrayLike | None = None) -> None:
        """Restore the initial state of the tissue, and put the tool at a pose.

        The default is the start pose of the scene.
        """
        if self._untouched is None:
            self.loop.state()  # raises why
            raise InputError("reset", "have a state to return to", "none", "make a new loop")
        self.loop.restore(self._untouched)
        tip_m, rotation = self._start
        if pose is not None:
            tip_m, rotation = pose_in(pose, rotation)
        self._tool.put(tip_m, rotation)
        self._left_region = False
        if self._keep_ready is not None:
            self._keep_ready(tip_m)
        self.loop.place()

    def snapshot(self) -> Snapshot:
        """Return a copy of the session's state, which `restore` accepts."""
        return Snapshot(self.loop.ticks * TICK_S, self._names, self._made_from, self.loop.state())

    def restore(self, snapshot: Snapshot) -> None:
        """Restore the state of a snapshot.

        Raises
        ------
        InputError
            If the session of the snapshot has another tissue, tool, step or constants. The error is
            also raised if the snapshot needs bone that this session has not prepared.
        """
        if snapshot.tissue != self._names:
            raise InputError(
                "snapshot",
                f"contain the state of {enumerated(self._names)}",
                f"the state of {enumerated(snapshot.tissue)}",
                "make both loops from equal arguments",
            )
        if snapshot.made_from != self._made_from:
            raise InputError(
                "snapshot",
                "come from a loop with the same constants, step_ms, tool and prepared tissue",
                "a snapshot of another loop",
                "make both loops from equal arguments",
            )
        self.loop.restore(snapshot.state)
        self._tool.put(self.loop.tool.tip_m, self.loop.tool.rotation)
        self._left_region = any(what.startswith(LEFT_REGION) for _, what in self.loop.events)


def _velocity(velocity: ArrayLike) -> Array:
    """Return the velocity [m/s] and the angular velocity [rad/s], shape (2, 3)."""
    values = np.asarray(velocity, dtype=np.float64)
    if values.shape not in ((3,), (6,)) or not np.isfinite(values).all():
        raise InputError(
            "velocity",
            "be finite, of shape (3,) [mm/s] or (6,) with the angular velocity [rad/s]",
            f"shape {values.shape}",
            "leave it out to use the change of the pose",
        )
    found = np.zeros((2, 3))
    found[0] = 1e-3 * values[:3]
    if len(values) == 6:
        found[1] = values[3:]
    return found
