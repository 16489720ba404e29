"""Aim of a hand: superposed minimum-jerk submovements, each of which corrects visible errors."""

from collections.abc import Callable
from math import sqrt
from typing import Protocol, runtime_checkable

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive, require_range
from tissue.motion.quaternion import Triple

__all__ = ["Aim", "Aiming", "Path", "minimum_jerk", "waypoints"]

Path = Callable[[float], Array]
"""Function from time [s] to position [m], shape (3,)."""


def minimum_jerk(share: float) -> tuple[float, float]:
    """Return position and speed of a minimum-jerk movement (Flash and Hogan, 1985).

    The position at a share s of the duration, from 0 to 1, is 10 s^3 - 15 s^4 + 6 s^5. The speed is
    its derivative with respect to s. The movement is at rest before 0 and after 1.
    """
    if share <= 0.0:
        return 0.0, 0.0
    if share >= 1.0:
        return 1.0, 0.0
    square = share * share
    return square * share * (10.0 + share * (6.0 * share - 15.0)), 30.0 * square * (
        1.0 - share
    ) ** 2


def waypoints(times_s: Array, points_m: Array) -> Path:
    """Return a path through points [m], shape (n, 3), at increasing times [s].

    It is straight between the points and at rest outside.

    Raises
    ------
    InputError
        If the times do not increase or the points do not match them.
    """
    times = np.array(times_s, dtype=float)
    points = np.array(points_m, dtype=float)
    if times.ndim != 1 or points.shape != (len(times), 3) or not np.isfinite(points).all():
        raise InputError(
            "points_m", f"be finite with shape ({times.size}, 3)", points.shape, "give one per time"
        )
    if not (np.diff(times) > 0.0).all():
        raise InputError("times_s", "increase", times_s, "sort them")
    return lambda time_s: np.array([np.interp(time_s, times, points[:, axis]) for axis in range(3)])


@runtime_checkable
class Aiming(Protocol):
    """Interface of a model that moves the aim of a hand."""

    def at(self, time_s: float) -> tuple[Triple, Triple]:
        """Return position [m] and velocity [m/s] of the aim; times must not decrease."""
        ...


class Aim:
    """Movement of the aim along a path that is known in advance.

    Every ``correction_s``, a submovement of ``submovement_s`` begins. Its target is the path
    position half a correction before it ends. The next one has begun by then, so that a steady
    movement neither leads nor lags. Submovements add up (Flash and Henis, 1991), so that the
    acceleration of the aim is continuous. The muscles miss the target by a share of the distance
    (signal-dependent noise, Harris and Wolpert, 1998). An error is seen and corrected after a
    reaction time. The first submovement begins a reaction time after the start.

    Parameters
    ----------
    path
        Target position over time.
    reaction_s, submovement_s, correction_s
        Times [s].
    endpoint_noise
        Standard deviation of the error per distance, for each axis.
    rng
        Random generator of this hand.
    """

    def __init__(
        self,
        path: Path,
        *,
        reaction_s: float,
        submovement_s: float,
        correction_s: float,
        endpoint_noise: float,
        rng: np.random.Generator,
    ) -> None:
        self._path = path
        self._rng = rng
        self._reaction = require_range("reaction_s", reaction_s, 0.0, 10.0, "use 0.2")
        self._duration = require_positive("submovement_s", submovement_s, "use 0.4")
        self._interval = require_positive("correction_s", correction_s, "use 0.2")
        self._noise = require_range("endpoint_noise", endpoint_noise, 0.0, 1.0, "use 0.05")
        self._rest = [float(value) for value in path(0.0)]
        self._moves: list[tuple[float, list[float], list[float]]] = []
        self._next = self._reaction

    def at(self, time_s: float) -> tuple[Triple, Triple]:
        """Return position [m] and velocity [m/s] of the aim; times must not decrease."""
        if time_s >= self._next:
            self._begin(time_s)
        (x, y, z) = self._rest
        u = 0.0
        v = 0.0
        w = 0.0
        for start, (a, b, c), _ in self._moves:
            share, speed = minimum_jerk((time_s - start) / self._duration)
            speed /= self._duration
            x = x + share * a
            y = y + share * b
            z = z + share * c
            u = u + speed * a
            v = v + speed * b
            w = w + speed * c
        return (x, y, z), (u, v, w)

    def _begin(self, time_s: float) -> None:
        """Begin the next submovement, and remove submovements that have ended and been seen."""
        self._next += self._interval
        memory = time_s - max(self._duration, self._reaction)
        while self._moves and self._moves[0][0] <= memory:
            self._rest = [a + b for a, b in zip(self._rest, self._moves.pop(0)[1], strict=True)]
        seen = list(self._rest)
        for start, move, missed in self._moves:
            unseen = start > time_s - self._reaction
            seen = [
                a + b - (c if unseen else 0.0) for a, b, c in zip(seen, move, missed, strict=True)
            ]
        arrival = time_s + self._duration - 0.5 * self._interval
        wanted = [float(a) - b for a, b in zip(self._path(arrival), seen, strict=True)]
        size = sqrt(sum(a * a for a in wanted))
        missed = [self._noise * size * float(each) for each in self._rng.standard_normal(3)]
        self._moves.append((time_s, [a + b for a, b in zip(wanted, missed, strict=True)], missed))
