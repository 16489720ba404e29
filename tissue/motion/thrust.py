"""Motion of a tool along its axis, from the balance of a thrust and the tissue force."""

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.models.tissue_model import Response, ToolMotion
from tissue.motion.motion import Events, Motion, frame_along

TOLERANCE = 0.01
"""Largest difference between the speed that led to a pose and the balanced speed at this pose.

The difference is relative to the larger of the two speeds. At the final pose, the force balance is
solved exactly. The tolerance limits the error of the pose to a hundredth of the travel in a tick.
The tolerance also applies to the difference between the balanced speed and the speed at which the
tissue linearises its force law. For a difference of a hundredth and a size exponent of 0.3, the
relative error of the linearised force is 1e-5.
"""
MOST_POSES = 10
"""Largest number of poses tried in a tick.

Seven halvings reduce the interval of possible speeds to a hundredth.
"""
MOST_TANGENTS = 10
"""Largest number of linearisations at the last pose of a tick.

Newton's method for a concave force needs 2 to 4 linearisations.
"""


def implicit_speed(
    speed: float, *, thrust: float, drag: float, mass: float, step_s: float
) -> float:
    """Return the speed [m/s] of a mass after one implicit Euler step.

    The forces on the mass are ``thrust`` [N] and a viscous drag with the coefficient ``drag`` [N
    s/m].
    """
    return (mass * speed / step_s + thrust) / (mass / step_s + drag)


class SpeedSearch:
    """Search for the speed in a tick at which the forces balance at the resulting pose.

    Each speed v that is tried gives a pose. Let S(v) be the speed that balances the forces at this
    pose. S(v) is limited to the allowed speeds. S(v) - v therefore changes its sign between the
    lowest and the highest allowed speed. After a try with v, the speed S(v) is tried next. If S(v)
    and v still differ after two tries, the search continues by bisection of the interval in which
    S(v) - v changes its sign. If the force jumps at a speed, for example at the first contact of a
    flat reamer, the search ends just behind the jump, where the force is larger.

    At each pose, the force law is replaced by its tangent as a function of the speed. The tangent
    is computed at the tried speed. The sign of S(v) - v is therefore the same as for the exact
    force law. If the balanced speed at the end is not close to the tried speed, new tangents are
    computed at the last pose until their speed and the balanced speed agree.

    Attributes
    ----------
    tried
        Speed of the next pose to evaluate [m/s].
    tangent
        Speed at which the tangent of the force is computed, for the pose of `tried` [m/s].
    """

    def __init__(self) -> None:
        self.begin(0.0, highest=0.0)

    def begin(self, speed: float, *, highest: float) -> None:
        """Start a tick with a first guess of the speed in the range from 0 to ``highest`` [m/s]."""
        self.tried = self.tangent = speed
        self._low = 0.0
        self._high = highest
        self._poses = 0
        self._tangents = 0
        self._is_last_pose = False

    def accepts(self, balanced: float) -> bool:
        """Return True if `tried` and `tangent` balance the forces, and update them otherwise.

        ``balanced`` is the speed at which the forces at the pose of `tried` balance.
        """
        if not self._is_last_pose:
            if _are_close(balanced, self.tried):
                return True
            self._narrow(balanced)
            if not self._is_last_pose:
                self.tangent = self.tried
                return False
        self._tangents += 1
        if _are_close(balanced, self.tangent) or self._tangents > MOST_TANGENTS:
            return True
        self.tangent = balanced
        return False

    def _narrow(self, balanced: float) -> None:
        """Narrow the interval, and choose the next pose or accept the present pose as the last."""
        self._poses += 1
        tried = self.tried
        if balanced < tried:
            self._high = tried
        else:
            self._low = tried
        if self._high - self._low <= TOLERANCE * self._high or self._poses >= MOST_POSES:
            # At a jump of the force no pose balances the forces. The side of the larger force is
            # accepted. It is tried once more if it was not the last pose.
            if tried == self._high:
                self._is_last_pose = True
                return
            self._low = self.tried = self._high
            return
        # Two steps to the balanced speed are enough if the drag varies smoothly. Halving always
        # ends.
        is_inside = self._low < balanced < self._high
        self.tried = balanced if self._poses <= 2 and is_inside else 0.5 * (self._low + self._high)


def _are_close(a: float, b: float) -> bool:
    """Return True if two speeds agree within `TOLERANCE`."""
    return abs(a - b) <= TOLERANCE * max(a, b)


class PushAlongAxis(Motion):
    """Force-driven motion: a thrust force pushes the tool along its axis.

    The feed is computed from the balance of thrust and cutting force. The cutting force increases
    steeply with the feed: the drag c is up to 1e5 N s/m. For a mass m, explicit integration is
    unstable with steps longer than 2 m / c. The balance is therefore solved for the new speed v',
    where drag and edge force are taken at the new pose::

        m (v' - v) / dt = thrust - c(x + v' dt) v' - edge(x + v' dt),    v' in [0, largest feed]

    Drag and edge force are computed from the tangent of the force law. As a result, the cutting
    force never exceeds thrust + m v / dt. `advance` starts with the drag of the previous tick, and
    `correct` tries poses until speed and forces agree. If the force law is linear in the speed and
    the thrust is below the edge force, the tool rests and the bone carries the thrust.

    Parameters
    ----------
    start_m
        Start position of the tip [m].
    axis
        Direction from tip to shank; the tool moves in the opposite direction.
    thrust_N, mass_kg, max_feed_m_s
        Thrust [N], moving mass [kg] and largest feed [m/s].
    depth_m
        Depth at which the feed stops [m]. It is measured along ``-axis`` from the origin of the
        frame in which `start_m` is given.
    """

    balances = True

    def __init__(
        self,
        start_m: Array,
        *,
        axis: tuple[float, float, float],
        thrust_N: float,
        mass_kg: float,
        max_feed_m_s: float,
        depth_m: float,
    ) -> None:
        self._rotation = frame_along(axis)
        self._heading = -self._rotation[:, 2]
        self._thrust = thrust_N
        self._mass = mass_kg
        self._max_feed = max_feed_m_s
        self._start = np.asarray(start_m, dtype=float)
        self._longest = depth_m - float(self._start @ self._heading)
        if self._longest <= 0.0:
            raise InputError(
                "motion.depth_mm",
                (
                    "be greater than the depth of motion.start_mm along the feed "
                    f"({1000.0 * float(self._start @ self._heading):g})"
                ),
                f"{1000.0 * depth_m:g}",
                "start higher or go deeper",
            )
        self._travel = self._speed = 0.0
        self._travel_before = self._speed_before = self._step = 0.0
        self._search = SpeedSearch()
        self._settled = True
        self._touching = self._is_limited = False
        self._limited_s = 0.0
        self._first_limited_s = -1.0
        # The feed is known only during the run. This duration is enough for a mean feed of a
        # quarter of the limit.
        self.duration_s = 4.0 * self._longest / max_feed_m_s

    def sweep_m(self) -> Array:
        """Return start and deepest position [m]."""
        return np.stack([self._start, self._start + self._longest * self._heading])

    def rotations(self) -> Array:
        """Return the fixed orientation at both positions."""
        return np.broadcast_to(self._rotation, (2, 3, 3))

    def begin(self, motion: ToolMotion) -> None:
        """Begin at the start position."""
        super().begin(motion)
        motion.heading[0] = self._heading

    def advance(self, time_s: float, step_s: float, response: Response, motion: ToolMotion) -> None:
        """Move at the speed that balances the forces if the drag is that of the previous tick."""
        drag, edge = self._resisting(response)
        was_touching = self._touching
        self._touching = drag > 0.0 or edge > 0.0
        if self._is_limited and was_touching and self._touching:
            self._first_limited_s = (
                time_s - step_s if self._limited_s == 0.0 else self._first_limited_s
            )
            self._limited_s += step_s
        self._travel_before = self._travel
        self._speed_before = self._speed
        self._step = step_s
        self._speed = self._balanced(drag, edge)
        self._search.begin(self._speed, highest=self._highest())
        self._settled = False
        motion.rotation[:] = self._rotation
        motion.heading[0] = self._heading
        self._place(motion, self._speed)
        motion.tangent_m_s = self._search.tangent
        self._set_speed(motion, edge)

    def correct(self, response: Response, motion: ToolMotion) -> bool:
        """Try another pose, or set the balanced speed if the forces balance at the present pose."""
        if self._settled:
            return False
        drag, edge = self._resisting(response)
        self._speed = self._balanced(drag, edge)
        self._settled = self._search.accepts(self._speed)
        if not self._settled:
            self._place(motion, self._search.tried)
            motion.tangent_m_s = self._search.tangent
        self._set_speed(motion, edge)
        return True

    def happened(self) -> Events:
        """Return an event if the feed limit was active in contact.

        The event reports when the limit first became active, and for how long it was active in
        total.
        """
        if self._limited_s == 0.0:
            return []
        what = (
            f"motion.max_feed_mm_s = {1e3 * self._max_feed:g} limits the feed, for "
            f"{self._limited_s:.3f} s in all: the "
            f"force then stays below the thrust of {self._thrust:g} N"
        )
        return [(self._first_limited_s, what)]

    @property
    def feed_limit(self) -> dict[str, float | None]:
        """Record of the time in contact with an active feed limit, up to the previous tick."""
        first_s = self._first_limited_s if self._limited_s > 0.0 else None
        return {
            "max_feed_mm_s": 1e3 * self._max_feed,
            "active_s": round(self._limited_s, 6),
            "first_s": first_s,
        }

    def _resisting(self, response: Response) -> tuple[float, float]:
        """Return drag [N s/m] and edge force [N], both against the direction of motion."""
        drag = max(-float(response.resistance[:3].dot(self._heading)), 0.0)
        edge = max(-float(response.edge[:3].dot(self._heading)), 0.0)
        return drag, edge

    def _highest(self) -> float:
        """Return the highest speed of this tick [m/s], from feed limit and remaining depth."""
        return max(min(self._max_feed, (self._longest - self._travel_before) / self._step), 0.0)

    def _balanced(self, drag: float, edge: float) -> float:
        """Return the balanced speed at the end of the tick, within the limits [m/s].

        This speed balances thrust, inertia, drag and edge force.
        """
        thrust = self._thrust - edge
        free = implicit_speed(
            self._speed_before, thrust=thrust, drag=drag, mass=self._mass, step_s=self._step
        )
        self._is_limited = free > self._max_feed
        return max(min(free, self._highest()), 0.0)

    def _place(self, motion: ToolMotion, speed: float) -> None:
        """Move the tool to the pose that results from a speed in this tick."""
        self._travel = self._travel_before + speed * self._step
        motion.tip_m[:] = self._start + self._travel * self._heading

    def _set_speed(self, motion: ToolMotion, edge: float) -> None:
        """Write the speed and, at rest, the share of the edge force that balances the thrust."""
        motion.speed_m_s = self._speed
        stuck = self._speed == 0.0 and self._travel < self._longest and edge > 0.0
        motion.pressed = min(self._thrust / edge, 1.0) if stuck else 0.0
