"""Force rendering laws between a device and its proxy, behind one interface."""

from collections import deque
from collections.abc import Callable
from math import copysign, inf, pi, sqrt
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.motion.quaternion import Quaternion, turn_between
from tissue.scene.registry import RENDERERS

__all__ = [
    "RELEASE_RAD_S",
    "PassivityControl",
    "PassivityObserver",
    "PassivityRenderer",
    "PenaltyRenderer",
    "ProxyRenderer",
    "Renderer",
    "TurningRenderer",
    "passivity",
    "penalty",
    "proxy",
    "renderer",
]

SPEED_TICKS = 3
"""Number of ticks over which the speed is averaged.

Chosen. In `tissue.haptics.rigid_wall.knock` on a Touch and a six-DOF device, with latencies up to
8 ms, no value from 1 to 8 is better throughout.
"""
RELEASE_M_S = (0.03, 0.1)
RELEASE_RAD_S = (1.2, 4.0)
"""Outward speeds at which the removal of an unpaid force begins and is complete [m/s], [rad/s].

They are far above the speeds of encoder steps and of a hand that rests on a wall. The rotational
values correspond to a handle of 25 mm.
"""
LEAST_N = 1e-6
"""Force below which a force counts as zero [N]: the tail of a low-pass never reaches zero."""
STILL = 1e-6
"""Speed below which no energy can be dissipated [m/s]; the force for it would divide by zero."""


class PassivityObserver:
    """Observer of the energy taken from the device, exact for a force that is held.

    A force F on the device that is held while the device moves by dx takes -F . dx from it. With
    the force of the last tick and the displacement since then, the sum is exact. It includes the
    energy that the hold leaks. A spring K that is entered and left at speed v returns K (v T)^2
    more per sample of depth than it took, half on entry and half on exit. A delayed force works on
    a later displacement. A known delay is also booked exactly.

    Parameters
    ----------
    delay_ticks
        Delay from the sample to the force at the motor, in addition to the hold [ticks]; any real
        number.

    Attributes
    ----------
    energy_J
        Energy taken so far [J]. If it is negative, the environment has created energy.
    """

    def __init__(self, *, delay_ticks: float = 0.0) -> None:
        # 1e-9: a delay of whole ticks that is rounded down stays whole.
        whole = int(delay_ticks + 1e-9)
        self._delay = max(delay_ticks - whole, 0.0)
        self.energy_J = 0.0
        self._position: Array | None = None
        # A fraction of a tick needs the older and the newer force.
        self._forces: deque[Array] = deque([np.zeros(3)] * (whole + 2), maxlen=whole + 2)

    def observe(self, position_m: Array) -> float:
        """Book the work of the acting forces up to this position [m]; return the energy [J]."""
        if self._position is not None:
            moved = position_m - self._position
            self.energy_J -= (1.0 - self._delay) * float(self._forces[1].dot(moved))
            self.energy_J -= self._delay * float(self._forces[0].dot(moved))
        self._position = position_m.copy()
        return self.energy_J

    def hold(self, force_N: Array) -> None:
        """Record the force [N] that is sent now."""
        self._forces.append(np.array(force_N))

    def pause(self) -> None:
        """Skip the motion to the next sample after missing samples; clear the pending forces."""
        self._position = None
        self._forces.extend([np.zeros(3)] * len(self._forces))

    def waiting_N(self) -> Array:
        """Return the pending forces, oldest first, shape (n, 3).

        Each force is weighted by its share of a tick.
        """
        waiting = np.array(self._forces)[1:]
        waiting[0] *= self._delay
        return waiting


class PassivityControl:
    """Controller that dissipates energy that an environment would create or has created.

    A force acts after the pending forces have acted. Until then, these forces push the device. Its
    speed along the force is therefore predicted as v + sum F T / m with the device's own mass,
    which overestimates the motion of a held device. The outward work of the pending forces and the
    new force at these speeds must not exceed the observed energy E. The excess is subtracted from
    the new force. If the device will move out fast, up to the whole force is removed. A damper -d v
    is added, which also dissipates a debt during entry. Damping is sampled too and would itself be
    unstable above m / T, so that d has an upper bound. Near rest no energy can be dissipated, and
    the debt remains. v is the mean speed over the last ticks, because encoder positions change in
    steps.

    An environment without force stores no energy. The energy taken until then has been dissipated.
    It is discarded, so that a later contact cannot use it. A debt remains.

    Parameters
    ----------
    damping_limit_N_s_m
        Upper bound of d [N s/m]; half of m / (T + t_d) is safe.
    delay_ticks
        See `PassivityObserver`.
    mass_kg
        Mass moved by the forces [kg]; infinite for a motion that they do not change.

    Attributes
    ----------
    observer
        Energy observer, which books the played force.
    dissipated_J
        Energy that the controller has planned to dissipate so far [J].
    damping_N_s_m
        Force removed in the last step over the predicted speed [N s/m].
    release_speeds
        Outward speeds between which the removable share of the force rises from zero to one.
    """

    def __init__(
        self, damping_limit_N_s_m: float, *, delay_ticks: float = 0.0, mass_kg: float = inf
    ) -> None:
        self._limit = damping_limit_N_s_m
        self._mass = mass_kg
        self.observer = PassivityObserver(delay_ticks=delay_ticks)
        self.damping_N_s_m = self.dissipated_J = 0.0
        self.release_speeds = RELEASE_M_S
        self._places: deque[Array] = deque(maxlen=SPEED_TICKS + 1)

    def step(self, force_N: Array, position_m: Array, velocity_m_s: Array, step_s: float) -> Array:
        """Return the force [N] to play instead of ``force_N`` for a step [s]."""
        observer = self.observer
        places = self._places
        energy = observer.observe(position_m)
        places.append(position_m.copy())
        self.damping_N_s_m = 0.0
        size = sqrt(force_N.dot(force_N))
        if size < LEAST_N:
            if energy > 0.0 and np.abs(observer.waiting_N()).max() < LEAST_N:
                observer.energy_J = 0.0
            observer.hold(force_N)
            return force_N
        if len(places) > 1:
            velocity_m_s = (places[-1] - places[0]) / (step_s * (len(places) - 1))
        direction = force_N / size
        pushes = np.append(observer.waiting_N() @ direction, size)
        # Half of each gain: the mean speed within its tick.
        gained = (step_s / self._mass) * pushes
        speeds = float(velocity_m_s.dot(direction)) + np.cumsum(gained) - 0.5 * gained
        speeds[-1] -= 0.5 * gained[-1]  # a device at rest is subject to its spring
        speed = float(speeds[-1])
        left = energy - step_s * float(pushes.dot(np.maximum(speeds, 0.0)))
        played = force_N
        if left < 0.0 and abs(speed) > STILL:
            slow, fast = self.release_speeds
            released = min(max((speed - slow) / (fast - slow), 0.0), 1.0)
            most = self._limit * abs(speed) + released * size
            taken = min(-left / (step_s * abs(speed)), most)
            self.damping_N_s_m = taken / abs(speed)
            self.dissipated_J += taken * abs(speed) * step_s
            played = force_N - copysign(taken, speed) * direction
        observer.hold(played)
        return played

    def pause(self) -> None:
        """Handle missing samples: the motion until the next sample is unknown.

        The force then fades and returns slowly, so that entry takes less energy than is booked. The
        energy taken until now is discarded so that exit cannot release it.
        """
        self.observer.pause()
        self.observer.energy_J = min(self.observer.energy_J, 0.0)
        self._places.clear()


class Renderer(Protocol):
    """Force law between a device and its proxy."""

    def render(
        self, device: Array, device_velocity: Array, proxy: Array, proxy_velocity: Array, dt: float
    ) -> Array:
        """Return the force on the device [N], shape (3,).

        The arguments are positions [m], velocities [m/s] and the step [s]. Where both positions are
        equal, the device is free and the force is zero. For a rotation, the positions are rotation
        vectors [rad] and the force is a torque [N m].
        """

    def pause(self) -> None:
        """Handle a missing sample: the motion until the next sample is unknown."""


class SpringDamper:
    """Stiffness and damping between a device and its proxy, without internal state."""

    def __init__(self, stiffness_N_m: float, damping_N_s_m: float = 0.0) -> None:
        self.stiffness_N_m = stiffness_N_m
        self.damping_N_s_m = damping_N_s_m

    def pause(self) -> None:
        """Do nothing, because the law has no internal state."""


class PenaltyRenderer(SpringDamper):
    """Spring and damper between the device and the nearest point of the surface.

    The law is F = k d - b (v . n) n, n = d / |d|. The damper acts on the velocity of the device,
    along the penetration only. It therefore also damps a device that moves together with the
    surface. The force never pulls into the surface.
    """

    def render(
        self, device: Array, device_velocity: Array, proxy: Array, proxy_velocity: Array, dt: float
    ) -> Array:
        """Return the force on the device [N]."""
        gap = proxy - device
        square = float(gap.dot(gap))
        if square == 0.0:
            return np.zeros(3)
        along = self.stiffness_N_m - self.damping_N_s_m * float(gap.dot(device_velocity)) / square
        return gap * max(along, 0.0)


class ProxyRenderer(SpringDamper):
    """Spring and damper between device and god-object (Colgate et al. 1995).

    The law is F = k (p_proxy - p) + b (v_proxy - v). The damper acts on the relative velocity, so
    the pair can only lose energy. A published form with ``+ b v_device`` alone creates the energy b
    v^2 every second (E9 of the project's list of errors). The damper is off where the device is
    free.
    """

    def render(
        self, device: Array, device_velocity: Array, proxy: Array, proxy_velocity: Array, dt: float
    ) -> Array:
        """Return the force on the device [N]."""
        if not any((proxy - device).tolist()):
            return np.zeros(3)
        return self.stiffness_N_m * (proxy - device) + self.damping_N_s_m * (
            proxy_velocity - device_velocity
        )


class PassivityRenderer:
    """Renderer with a passivity observer and a controller that dissipates the energy it creates.

    Measured at the motors on walls of up to 1.5 kN/m with latencies of up to 8 ms, the net energy
    given to the device never exceeded 0.3 mJ. The observer does not see a force that fades while
    samples are missing. Energy taken before such a gap is not counted.
    """

    def __init__(
        self,
        inner: Renderer,
        *,
        damping_limit_N_s_m: float,
        delay_ticks: float = 0.0,
        mass_kg: float = inf,
    ) -> None:
        self.inner = inner
        self.control = PassivityControl(
            damping_limit_N_s_m, delay_ticks=delay_ticks, mass_kg=mass_kg
        )

    def render(
        self, device: Array, device_velocity: Array, proxy: Array, proxy_velocity: Array, dt: float
    ) -> Array:
        """Return the force on the device [N]."""
        force = self.inner.render(device, device_velocity, proxy, proxy_velocity, dt)
        return self.control.step(force, device, device_velocity, dt)

    def pause(self) -> None:
        """Skip the energy of the motion to the next sample.

        Another force was played during this motion.
        """
        self.control.pause()


class TurningRenderer:
    """Force laws applied to a rotation.

    The gap is the shortest rotation vector from the device to its proxy. The rotations of the
    device are summed as rotation vectors from tick to tick, so that a passivity observer in the
    inner law can book the work of the torque.
    """

    def __init__(self, inner: Renderer) -> None:
        self._inner = inner
        if isinstance(inner, PassivityRenderer):
            inner.control.release_speeds = RELEASE_RAD_S
        self._turned = np.zeros(3)
        self._before: Quaternion | None = None

    def render(
        self,
        device: Quaternion,
        device_spin: Array,
        proxy: Quaternion,
        proxy_spin: Array,
        dt: float,
    ) -> Array:
        """Return the torque on the device [N m].

        The arguments are unit quaternions (x, y, z, w) and spins [rad/s].
        """
        if self._before is not None:
            self._turned = self._turned + turn_between(self._before, device)
        self._before = device
        gap = np.array(turn_between(device, proxy))
        return self._inner.render(self._turned, device_spin, self._turned + gap, proxy_spin, dt)

    def pause(self) -> None:
        """Pause the inner law."""
        self._inner.pause()


def penalty(loop: WallLoop) -> PenaltyRenderer:
    """Return the penalty law for the wall of a loop, with its stiffness and damping."""
    return PenaltyRenderer(loop.stiffness_N_m, loop.wall_damping_N_s_m)


def passivity(loop: WallLoop) -> PassivityRenderer:
    """Return the penalty law for the wall of a loop, with a passivity controller.

    The loop provides the mass and the lag (delay, filter and amplifier). The damping limit is half
    of m / (T + lag).
    """
    lag = loop.delay_s + loop.filter_s + 1.0 / (2.0 * pi * loop.amplifier_Hz)
    limit = 0.5 * loop.mass_kg / (loop.tick_s + lag)
    return PassivityRenderer(
        penalty(loop),
        damping_limit_N_s_m=limit,
        delay_ticks=lag / loop.tick_s,
        mass_kg=loop.mass_kg,
    )


def proxy(loop: WallLoop) -> ProxyRenderer:
    """Return the god-object law for the wall of a loop, with its stiffness and damping."""
    return ProxyRenderer(loop.stiffness_N_m, loop.wall_damping_N_s_m)


def renderer(kind: str, loop: WallLoop) -> Renderer:
    """Return a renderer by its name in `RENDERERS`, for the wall of a loop.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    built_in: dict[str, Callable[[WallLoop], Renderer]] = {
        "penalty": penalty,
        "passivity": passivity,
        "proxy": proxy,
    }
    make: Callable[[WallLoop], Renderer] = RENDERERS[kind] or built_in[kind]
    return make(loop)
