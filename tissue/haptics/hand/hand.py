"""Simulated hand that holds a device, with reflex, tremor, and noise of muscles."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, fields
from math import exp, pi, sqrt
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive, require_range
from tissue.haptics.loop.critical_stiffness import LinearHand
from tissue.materials.scene_constants import Materials
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import NOTHING, UPRIGHT, Quaternion, Triple
from tissue.scene.registry import HANDS

Path = Callable[[float], Array]
"""Function that returns the position, shape (3,), in metres, at a time [s]."""


def minimum_jerk(share: float) -> tuple[float, float]:
    """Return position and speed of a minimum-jerk movement (Flash and Hogan, 1985).

    The argument s = ``share`` is the time divided by the duration of the movement. The position is
    10 s^3 - 15 s^4 + 6 s^5, and the speed is its derivative with respect to s. Before s = 0 and
    after s = 1, the speed is zero.
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
    """Return a path through points, shape (n, 3), in metres, at increasing times [s].

    The path is straight between the points. Before the first time, it stays at the first point, and
    after the last time at the last point.
    """
    points = np.asarray(points_m, dtype=float)
    return lambda time_s: np.array(
        [np.interp(time_s, times_s, points[:, axis]) for axis in range(3)]
    )


@runtime_checkable
class Aiming(Protocol):
    """Interface of a model that moves the aim, which is the target position of a simulated hand."""

    def at(self, time_s: float) -> tuple[Triple, Triple]:
        """Return position [m] and velocity [m/s] of the aim; times must not decrease."""
        ...


class Aim:
    """Movement of the aim (the hand's target position) along a path that is known in advance.

    A submovement of the duration ``submovement_s`` begins after each interval ``correction_s``; see
    `HandParameters`. Its target is the point that the path reaches half a correction interval
    before the submovement ends. With this target, the aim neither leads nor lags a path of constant
    velocity. Overlapping submovements are added (Flash and Henis, 1991), so that the acceleration
    of the aim is continuous. A submovement misses its target by a random error that is proportional
    to its length (signal-dependent noise, Harris and Wolpert, 1998). The error is corrected one
    reaction time later. The first submovement begins one reaction time after the start.

    Parameters
    ----------
    path
        Path that the aim follows: position as a function of time.
    parameters
        Parameters of the hand, with the times and the noise of its movements.
    rng
        Random generator of this hand.
    """

    def __init__(
        self, path: Path, parameters: "HandParameters", *, rng: np.random.Generator
    ) -> None:
        self._path = path
        self._rng = rng
        self._reaction = parameters.reaction_s
        self._duration = parameters.submovement_s
        self._interval = parameters.correction_s
        self._noise = parameters.endpoint_noise
        self._rest = [float(value) for value in path(0.0)]
        self._moves: list[tuple[float, list[float], list[float]]] = []
        self._next = self._reaction

    def at(self, time_s: float) -> tuple[Triple, Triple]:
        """Return position [m] and velocity [m/s] of the aim; times must not decrease."""
        if time_s >= self._next:
            self._begin(time_s)
        place = list(self._rest)
        velocity = [0.0, 0.0, 0.0]
        for start, move, _ in self._moves:
            share, speed = minimum_jerk((time_s - start) / self._duration)
            speed /= self._duration
            for axis, distance in enumerate(move):
                place[axis] += share * distance
                velocity[axis] += speed * distance
        x, y, z = place
        u, v, w = velocity
        return (x, y, z), (u, v, w)

    def _begin(self, time_s: float) -> None:
        """Begin the next submovement, and remove submovements that are no longer needed."""
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
        # Half a correction interval before the end, see the class.
        arrival = time_s + self._duration - 0.5 * self._interval
        wanted = [float(a) - b for a, b in zip(self._path(arrival), seen, strict=True)]
        size = sqrt(sum(a * a for a in wanted))
        missed = [self._noise * size * float(each) for each in self._rng.standard_normal(3)]
        self._moves.append((time_s, [a + b for a, b in zip(wanted, missed, strict=True)], missed))


BLOCK = 500
"""Number of ticks for which random numbers are drawn in one call of the generator."""


class Grip(NamedTuple):
    """Stiffness, damping and mass of a simulated hand at the device.

    The values are given for translation and rotation. All values are zero after the hand has
    released the device.
    """

    stiffness_N_m: float = 0.0
    damping_N_s_m: float = 0.0
    mass_kg: float = 0.0
    stiffness_Nm_rad: float = 0.0
    damping_Nm_s_rad: float = 0.0
    inertia_kg_m2: float = 0.0


class HandAction(NamedTuple):
    """Action of a simulated hand in a tick: target position (aim), intended force, and grip."""

    aim_m: Triple = NOTHING
    aim_velocity_m_s: Triple = NOTHING
    push_N: Triple = NOTHING
    aim_quaternion: Quaternion = UPRIGHT
    grip: Grip = Grip()


class HoldingHand(Protocol):
    """Interface of a simulated hand that holds a device."""

    def act(self, time_s: float, position_m: Triple) -> HandAction:
        """Return the action of the hand from this time to the next call.

        ``position_m`` is the position of the device [m].
        """


@dataclass(frozen=True, kw_only=True)
class HandParameters:
    """Parameters of a simulated hand.

    Attributes
    ----------
    reaction_s, submovement_s, correction_s
        Reaction time, duration of a submovement, and interval between the starts of two
        submovements [s].
    endpoint_noise, force_noise, force_noise_s
        Standard deviation of the end point of a submovement, divided by the length of the
        submovement. Standard deviation of the force noise divided by the force. Correlation time of
        the force noise [s].
    tremor_m, tremor_Hz, tremor_width_Hz
        Amplitude of the tremor in every axis (root mean square) [m], frequency and bandwidth of the
        tremor [Hz].
    stiffness_N_m, damping_N_s_m, mass_kg
        Stiffness, damping and mass of the grip at the device [N/m], [N s/m], [kg].
    turning_stiffness_Nm_rad, turning_damping_Nm_s_rad, inertia_kg_m2
        Stiffness [N m/rad], damping [N m s/rad] and inertia [kg m2] of the grip in rotation.
    reflex_share, reflex_s
        Stiffness of the reflex divided by the stiffness of the grip, and delay of the reflex [s].
    """

    reaction_s: float
    submovement_s: float
    correction_s: float
    endpoint_noise: float
    force_noise: float
    force_noise_s: float
    tremor_m: float
    tremor_Hz: float
    tremor_width_Hz: float
    stiffness_N_m: float
    damping_N_s_m: float
    mass_kg: float
    turning_stiffness_Nm_rad: float
    turning_damping_Nm_s_rad: float
    inertia_kg_m2: float
    reflex_share: float
    reflex_s: float

    def __post_init__(self) -> None:
        # The upper bound only rejects values in a wrong unit.
        for entry in fields(self):
            require_range(
                entry.name, getattr(self, entry.name), 0.0, 1e5, "see hands.toml for usual values"
            )
        for name in ("submovement_s", "correction_s", "force_noise_s", "tremor_width_Hz"):
            require_positive(name, getattr(self, name), "see hands.toml for usual values")

    @property
    def linear_hands(self) -> tuple[LinearHand, ...]:
        """Linear models of the hand in translation, without and with the reflex.

        The reflex may stabilise a loop or make the loop unstable, depending on the frequency at
        which the loop oscillates. The stability of a loop is therefore checked with each of the two
        models.
        """
        still = LinearHand(*self.grip[:3])
        if self.reflex_share == 0.0:
            return (still,)
        reflex_N_m = self.reflex_share * self.stiffness_N_m
        return still, still._replace(reflex_N_m=reflex_N_m, reflex_s=self.reflex_s)

    @property
    def grip(self) -> Grip:
        """Stiffness, damping and mass of the hand, without the reflex."""
        return Grip(
            self.stiffness_N_m,
            self.damping_N_s_m,
            self.mass_kg,
            self.turning_stiffness_Nm_rad,
            self.turning_damping_Nm_s_rad,
            self.inertia_kg_m2,
        )


def hand_parameters(name: str, constants: Materials = Materials.cited) -> HandParameters:
    """Return the parameters of a simulated hand by its name in `HANDS`.

    Constants that a scene defines replace the built-in constants.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    return HandParameters(**constants.numbers("hands", HANDS[name], "any", name))


class Hand:
    """Simulated hand that follows a path.

    The result is reproducible for the same state of the random generator. The grip is a spring, a
    damper and a mass between the aim (the hand's target position) and the device. The simulated
    device integrates the grip together with its own mass. Four further contributions are added:

    - A reflex force, proportional to the distance between aim and device one reflex delay earlier.
    - An intended push.
    - Noise, proportional to the force that the hand exerts.
    - A tremor of the aim: narrow-band Gaussian noise around the tremor frequency.

    Parameters
    ----------
    parameters
        Parameters of the hand.
    path
        Path of the target position [m] as a function of time, or an object that moves the aim.
    rng
        Random generator of this hand.
    step_s
        Time between two calls of `act` [s].
    push
        Function that returns the intended force, shape (3,), in newtons, at a time [s].
    turn
        Function that returns the intended orientation, a unit quaternion (x, y, z, w), at a time
        [s].
    """

    def __init__(
        self,
        parameters: HandParameters,
        path: Path | Aiming,
        *,
        rng: np.random.Generator,
        step_s: float = TICK_S,
        push: Callable[[float], Array] | None = None,
        turn: Callable[[float], Array] | None = None,
    ) -> None:
        self.parameters = parameters
        self._rng = rng
        self._push = push
        self._turn = turn
        self._aim = path if isinstance(path, Aiming) else Aim(path, parameters, rng=rng)
        self._grip = parameters.grip
        self._pending = deque([NOTHING] * round(parameters.reflex_s / step_s))
        self._keep = exp(-step_s / parameters.force_noise_s)
        self._fresh = sqrt(1.0 - self._keep**2)
        # A complex first-order filter with the decay exp(-pi w T) has the half-power bandwidth w.
        decay = exp(-pi * parameters.tremor_width_Hz * step_s)
        self._turning = decay * np.exp(2j * pi * parameters.tremor_Hz * step_s).item()
        self._shaken = parameters.tremor_m * sqrt(1.0 - decay**2)
        self._speed_per_tremor = 2.0 * pi * parameters.tremor_Hz
        start = rng.standard_normal(9).tolist()
        self._noise = start[:3]
        self._tremor = [parameters.tremor_m * complex(start[3 + a], start[6 + a]) for a in range(3)]
        self._drawn: list[list[float]] = []

    def act(self, time_s: float, position_m: Triple) -> HandAction:
        """Return the action of the hand when the device is at ``position_m`` [m]."""
        (x, y, z), (u, v, w) = self._aim.at(time_s)
        if not self._drawn:
            self._drawn = self._rng.standard_normal((BLOCK, 9)).tolist()
        drawn = self._drawn.pop()
        s, t, q = self._tremor = [
            self._turning * value + self._shaken * complex(drawn[3 + a], drawn[6 + a])
            for a, value in enumerate(self._tremor)
        ]
        spin = self._speed_per_tremor
        aim = (x + s.real, y + t.real, z + q.real)
        velocity = (u - spin * s.imag, v - spin * t.imag, w - spin * q.imag)
        off = (aim[0] - position_m[0], aim[1] - position_m[1], aim[2] - position_m[2])
        self._pending.append(off)
        felt = self._pending.popleft()
        stiffness = self.parameters.stiffness_N_m
        reflex = self.parameters.reflex_share * stiffness
        px, py, pz = NOTHING if self._push is None else self._push(time_s)
        fx = float(px) + reflex * felt[0]
        fy = float(py) + reflex * felt[1]
        fz = float(pz) + reflex * felt[2]
        exerted = sqrt(
            (fx + stiffness * off[0]) ** 2
            + (fy + stiffness * off[1]) ** 2
            + (fz + stiffness * off[2]) ** 2
        )
        a, b, c = self._noise = [
            self._keep * n + self._fresh * drawn[k] for k, n in enumerate(self._noise)
        ]
        noise = self.parameters.force_noise * exerted
        turned = UPRIGHT
        if self._turn is not None:
            i, j, k, r = self._turn(time_s)
            turned = float(i), float(j), float(k), float(r)
        return HandAction(
            aim, velocity, (fx + noise * a, fy + noise * b, fz + noise * c), turned, self._grip
        )
