"""Motion of a tool through poses that the caller sets one after the other."""

from math import sqrt

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.models.tissue_model import TICK_S, Response, ToolMotion
from tissue.motion.motion import StaysAt, matrix_of
from tissue.motion.quaternion import OFF_UNIT, exponential, logarithm, of_matrix

FASTEST_M_S = 10.0
"""Largest accepted speed of a tool [m/s]; a larger speed indicates a pose in a wrong unit.

Carving visits all voxels in the swept region, so a single wrong pose would take minutes.
"""
OFF_ROTATION = 1e-4
"""Largest accepted deviation of a matrix from a rotation.

The value allows for numbers in single precision or with five digits.
"""
RESTS = 1e-9
"""Speed below which a tool counts as resting [m/s, rad/s]; rounding errors are smaller."""


def pose_in(pose: ArrayLike, rotation: Array) -> tuple[Array, Array]:
    """Return the tip [m], shape (3,), and the rotation, shape (3, 3), of a pose.

    See `poses_in` for the accepted formats of a pose, and for the argument `rotation`.
    """
    tips, rotations = poses_in("pose", np.asarray(pose, dtype=np.float64)[None], rotation)
    return tips[0], rotations[0]


def poses_in(name: str, poses: ArrayLike, rotation: Array) -> tuple[Array, Array]:
    """Return the tips [m], shape (n, 3), and the rotations, shape (n, 3, 3), of poses.

    Parameters
    ----------
    name
        Name of the argument in error messages.
    poses
        Tip positions [mm], shape (n, 3); tip positions and unit quaternions (x, y, z, w), shape (n,
        7); or matrices from the tool frame to the tissue frame with translations in mm, shape (n,
        4, 4). A quaternion whose length is within 1 % of 1 is normalised.
    rotation
        Rotation that is used if the poses are positions only, shape (3, 3).

    Raises
    ------
    InputError
        If the poses have a wrong shape, are not finite, or contain a matrix or quaternion that is
        not a rotation.
    """
    try:
        values = np.asarray(poses, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(name, "be numbers", type(poses).__name__, "give numbers in mm") from None
    if values.shape[1:] not in ((3,), (7,), (4, 4)) or len(values) == 0:
        is_one = name == "pose"
        raise InputError(
            name,
            "be a tip [mm] of shape (3,), tip and quaternion (7,) or a matrix (4, 4)"
            if is_one
            else "be tips [mm] of shape (n, 3), tips and quaternions (n, 7) or matrices (n, 4, 4)",
            f"shape {values.shape[is_one:]}",
            "use one of these forms",
        )
    if not np.isfinite(values).all():
        raise InputError(name, "be finite", values[~np.isfinite(values)][0], "give finite numbers")
    if values.shape[1:] == (3,):
        return 1e-3 * values, np.broadcast_to(rotation, (len(values), 3, 3))
    if values.shape[1:] == (7,):
        lengths = np.linalg.norm(values[:, 3:], axis=1)
        # The network protocol has the same limit. Rounding of the length is removed below.
        is_off = np.abs(lengths**2 - 1.0) > OFF_UNIT
        if is_off.any():
            raise InputError(
                name,
                "contain quaternions (x, y, z, w) of length 1 within 1 %",
                f"a quaternion of length {lengths[is_off][0]:.4g}",
                "divide the quaternion by its length",
            )
        quaternions = values[:, 3:] / lengths[:, None]
        return 1e-3 * values[:, :3], np.array([matrix_of(each) for each in quaternions])
    if (values[:, 3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise InputError(
            name,
            "have 0, 0, 0, 1 in the last row of each matrix",
            "other numbers",
            "transpose a matrix whose last row is the tip",
        )
    turns = values[:, :3, :3]
    error = float(np.abs(turns @ turns.transpose(0, 2, 1) - np.eye(3)).max())
    if error > OFF_ROTATION or (np.linalg.det(turns) < 0.0).any():
        raise InputError(
            name,
            "contain rotations without scale or mirroring",
            f"a matrix with an error of {error:.2g}",
            "normalise the rotation",
        )
    return 1e-3 * values[:, :3, 3], turns


class PosedTool(StaysAt):
    """Motion of a tool through poses that are set one after another during the run.

    The motion from one pose to the next pose is divided equally among the ticks between them.

    Parameters
    ----------
    tip_m, rotation
        Start pose: position of the tip [m], and rotation from tool to world.
    """

    def __init__(self, tip_m: Array, rotation: Array) -> None:
        self.put(tip_m, rotation)

    def put(self, tip_m: Array, rotation: Array) -> None:
        """Set the start pose, which `begin` writes."""
        self._tip = np.array(tip_m)
        self._rotation = np.array(rotation)
        self._left = 0
        self._turn = np.zeros(3)
        self._velocity = np.zeros((2, 3))

    def begin(self, motion: ToolMotion) -> None:
        """Write the start pose; the speed is zero."""
        super().begin(motion)
        motion.heading[:] = 0.0
        motion.speed_m_s = 0.0

    def aim(
        self,
        motion: ToolMotion,
        tip_m: Array,
        rotation: Array,
        *,
        velocity: Array | None,
        ticks: int,
    ) -> None:
        """Set the pose that the tool reaches after a number of ticks.

        Parameters
        ----------
        motion
            Present pose of the tool.
        tip_m, rotation
            Pose after the given number of ticks.
        velocity
            Velocity of the tip [m/s] and angular velocity [rad/s], shape (2, 3), until the pose is
            reached. If None, they are computed from the change of the pose and the duration of the
            ticks.
        ticks
            Number of ticks.

        Raises
        ------
        InputError
            If the tool would move faster than 10 m/s, or turn by more than 90 degrees.
        """
        step_s = ticks * TICK_S
        moved = tip_m - motion.tip_m
        length = sqrt(moved.dot(moved))
        if length > FASTEST_M_S * step_s:
            raise InputError(
                "pose",
                f"change by at most {1e3 * FASTEST_M_S * step_s:g} mm in {1e3 * step_s:g} ms",
                f"{1e3 * length:.4g} mm",
                "give positions in millimetres, or move the tool there by reset(pose)",
            )
        self._turn = np.zeros(3)
        if rotation is not motion.rotation:
            between = rotation @ motion.rotation.T
            if np.trace(between) < 1.0:
                raise InputError(
                    "pose",
                    "turn by at most 90 degrees in a step",
                    f"{np.degrees(np.arccos(0.5 * (np.trace(between) - 1.0))):.0f} degrees",
                    "turn the tool in more steps",
                )
            self._turn = np.array(logarithm(of_matrix(between.tolist())))
        self._tip = tip_m
        self._rotation = np.array(rotation)
        self._left = ticks
        if velocity is None:
            velocity = np.array([moved, self._turn]) / step_s
        self._velocity = velocity

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Move the tool for one tick, or let it rest after it has reached the pose set by `aim`."""
        if self._left == 0:
            motion.speed_m_s = 0.0
            return
        if self._left == 1:
            motion.tip_m[:] = self._tip
            motion.rotation[:] = self._rotation
        else:
            motion.tip_m += (self._tip - motion.tip_m) / self._left
            if self._turn.any():
                done = self._turn / self._left
                x, y, z = done.tolist()
                motion.rotation[:] = matrix_of(np.array(exponential((x, y, z)))) @ motion.rotation
                self._turn = self._turn - done
        self._left -= 1
        moved, turned = self._velocity
        speed = sqrt(moved.dot(moved))
        # For a tool that only turns, the speed is set to 1 m/s. The second row of `heading` then is
        # the angular velocity.
        if speed <= RESTS:
            speed = 1.0 if sqrt(turned.dot(turned)) > RESTS else 0.0
        motion.speed_m_s = speed
        if speed > 0.0:
            np.divide(self._velocity, speed, out=motion.heading)
