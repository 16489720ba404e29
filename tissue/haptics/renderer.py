"""Force laws between a haptic device and its proxy, which share one interface."""

from collections import deque
from collections.abc import Callable
from math import copysign, inf, pi, sqrt
from typing import Protocol, Self

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.motion.quaternion import Quaternion, turn_between
from tissue.scene.registry import RENDERERS

SPEED_TICKS = 3
"""Number of ticks over which `PassivityControl` averages the speed.

The value was chosen from runs of `tissue.haptics.rigid_wall.knock` on a Touch and on a six-DOF
device, with latencies up to 8 ms. No other value from 1 to 8 is better in all of these runs.
"""
RELEASE_M_S = (0.03, 0.1)
RELEASE_RAD_S = (1.2, 4.0)
"""Outward speeds [rad/s] between which the removable share of a torque rises from 0 to 1.

`PassivityControl` may remove this share of a torque in addition to its damper. `RELEASE_M_S` has
the corresponding speeds for a force [m/s].

The values are far above the apparent speed caused by an encoder step, and above the speed of a hand
that rests on a virtual wall. The rotational values correspond to the speeds of `RELEASE_M_S` at a
radius of 25 mm.
"""
LEAST_N = 1e-6
"""Force below which a force is treated as zero [N].

The output of a low-pass never reaches zero exactly.
"""
STILL = 1e-6
"""Speed below which `PassivityControl` dissipates no energy [m/s], to avoid a division by zero."""


class PassivityObserver:
    """Observer of the energy that a sampled force takes from a device.

    If a force F on the device is constant while the device moves by dx, the force takes the energy
    -F . dx from the device. In every tick, the observer adds this energy for the force of the last
    tick and the displacement since that tick. The sum has no approximation error, and includes the
    energy that the zero-order hold creates. For example, a device enters a spring of stiffness K
    and leaves it, both at speed v. For each tick of length T during entry, the spring then returns
    K (v T)^2 more energy than it took. Half of this energy arises on entry, and half on exit. A
    delayed force acts during a later displacement. If its delay is known, the sum is also correct.

    Parameters
    ----------
    delay_ticks
        Delay from the sample to the force at the motor, in addition to the zero-order hold [ticks].
        The delay need not be a whole number.

    Attributes
    ----------
    energy_J
        Energy taken from the device so far [J]. A negative value means that the virtual environment
        has created energy.
    """

    def __init__(self, *, delay_ticks: float = 0.0) -> None:
        # 1e-9: a delay of whole ticks must not be rounded down to one tick less.
        whole = int(delay_ticks + 1e-9)
        self._delay = max(delay_ticks - whole, 0.0)
        self.energy_J = 0.0
        self._position: Array | None = None
        # For a fraction of a tick, the older and the newer force are needed.
        self._forces: deque[Array] = deque([np.zeros(3)] * (whole + 2), maxlen=whole + 2)

    def observe(self, position_m: Array) -> float:
        """Add the work of the forces that acted up to this position [m]; return the energy [J]."""
        if self._position is not None:
            moved = position_m - self._position
            self.energy_J -= (1.0 - self._delay) * float(self._forces[1].dot(moved))
            self.energy_J -= self._delay * float(self._forces[0].dot(moved))
        self._position = position_m.copy()
        return self.energy_J

    def hold(self, force_N: Array) -> None:
        """Record the force [N] that is sent to the device now."""
        self._forces.append(np.array(force_N))

    def pause(self) -> None:
        """Ignore the motion up to the next sample, and clear the pending forces.

        Call this method after missing samples.
        """
        self._position = None
        self._forces.extend([np.zeros(3)] * len(self._forces))

    def waiting_N(self) -> Array:
        """Return the pending forces (sent, but not yet acting), oldest first, shape (n, 3).

        Each force is multiplied by the share of a tick for which it will act.
        """
        waiting = np.array(self._forces)[1:]
        waiting[0] *= self._delay
        return waiting


class PassivityControl:
    """Controller that dissipates the energy that a virtual environment creates.

    A new force acts after the pending forces, which were sent earlier. Until then, the pending
    forces F push the device. The speed of the device along the force is therefore predicted as v +
    sum F T / m, with the tick T and the device's own mass m. Here v is the mean speed over the last
    ticks, because encoder positions change in steps. For a device in a hand, the predicted speed is
    too large. At the predicted speeds, the outward work of the pending forces and of the new force
    must not exceed the observed energy E. A damper dissipates an excess: it adds a force -d v to
    the new force. While the device moves inward, the damper also dissipates an energy debt (a
    negative E). The damping d has an upper bound, because a sampled damper is unstable above m / T.
    If the device moves outward fast, a larger part of the new force may be removed, up to the whole
    force. Near zero speed, no energy can be dissipated, and the debt remains.

    If there is neither a new force nor a pending force, the environment stores no energy. The
    observed energy is then set to zero, so that a later contact cannot use this energy. An energy
    debt is kept.

    Parameters
    ----------
    damping_limit_N_s_m
        Upper bound of d [N s/m]; half of m / (T + t_d) is safe.
    delay_ticks
        See `PassivityObserver`.
    mass_kg
        Apparent mass m of the device [kg]; infinite if the forces do not change the motion.

    Attributes
    ----------
    observer
        Observer of the energy of the force that is sent to the device.
    dissipated_J
        Energy that the controller has dissipated so far [J], computed with the predicted speeds.
    damping_N_s_m
        Force removed in the last step, divided by the predicted speed [N s/m].
    release_speeds
        Two outward speeds. The share of the new force that may be removed rises from 0 at the first
        speed to 1 at the second; see `RELEASE_RAD_S`.
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
        """Return the force [N] that replaces ``force_N`` in a step of ``step_s`` [s]."""
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
        # Half of the change of speed gives the mean speed within the tick.
        gained = (step_s / self._mass) * pushes
        speeds = float(velocity_m_s.dot(direction)) + np.cumsum(gained) - 0.5 * gained
        speeds[-1] -= 0.5 * gained[-1]  # at rest a spring balances the new force
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
        """Reset after missing samples, because the motion up to the next sample is unknown.

        While samples are missing, the force fades, and afterwards it returns slowly. On entry into
        a wall during this time, the device therefore loses less energy than the observer counts. A
        positive observed energy is set to zero, so that it cannot be released on exit from the
        wall.
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

        The arguments are positions [m] and velocities [m/s] of device and proxy, and the time step
        ``dt`` [s]. If both positions are equal, the device is free and the force is zero. For a
        rotation, the positions are rotation vectors [rad] and the force is a torque [N m].
        """

    def pause(self) -> None:
        """Reset after a missing sample, because the motion up to the next sample is unknown."""


class SpringDamper:
    """Base class of force laws with a stiffness and a damping, without internal state."""

    def __init__(self, stiffness_N_m: float, damping_N_s_m: float = 0.0) -> None:
        self.stiffness_N_m = stiffness_N_m
        self.damping_N_s_m = damping_N_s_m

    @classmethod
    def of(cls, loop: WallLoop) -> Self:
        """Return the law with the stiffness and the damping of the wall in a loop."""
        return cls(loop.stiffness_N_m, loop.wall_damping_N_s_m)

    def pause(self) -> None:
        """Do nothing, because the law has no internal state."""


class PenaltyRenderer(SpringDamper):
    """Spring and damper between the device and the nearest point of the surface (its proxy).

    The law is F = k d - b (v . n) n, with stiffness k, damping b and device velocity v. d is the
    vector from the device to the surface, and n = d / |d|. The damper acts on the velocity of the
    device along d. A device that moves together with the surface is therefore also damped. The
    force never pulls into the surface.
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

    The law is F = k (p_proxy - p) + b (v_proxy - v). The damper acts on the relative velocity and
    can therefore only dissipate energy. In a published form of the law, the damper is ``+ b
    v_device``, which creates the power b v^2. There is no damping while the device is free.
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
    """Renderer that applies `PassivityControl` to the force of another renderer.

    On virtual walls of up to 1.5 kN/m with latencies of up to 8 ms, the net energy given to the
    device at its motors never exceeded 0.3 mJ. Energy taken before missing samples, or during the
    fading of the force while samples are missing, is not counted.
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
        """Ignore the energy of the motion up to the next sample.

        The reason is that the device received another force during this motion.
        """
        self.control.pause()


class TurningRenderer:
    """Renderer that applies a force law to rotations and returns a torque.

    The distance in the law is the shortest rotation vector from the device to its proxy. The
    position in the law is the sum of the rotation vectors by which the device turned in each tick.
    With this sum, a passivity observer can compute the work of the torque.
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

        The arguments are unit quaternions (x, y, z, w) and spins [rad/s] of device and proxy, and
        the time step ``dt`` [s].
        """
        if self._before is not None:
            self._turned = self._turned + turn_between(self._before, device)
        self._before = device
        gap = np.array(turn_between(device, proxy))
        return self._inner.render(self._turned, device_spin, self._turned + gap, proxy_spin, dt)

    def pause(self) -> None:
        """Reset the force law."""
        self._inner.pause()


def passivity(loop: WallLoop) -> PassivityRenderer:
    """Return a renderer with a penalty law and a passivity controller for the wall of a loop.

    The damping limit of the controller is half of m / (T + lag). The mass m, the tick T, and the
    lag (delay, filter and amplifier) are those of the loop.
    """
    lag = loop.delay_s + loop.filter_s + 1.0 / (2.0 * pi * loop.amplifier_Hz)
    limit = 0.5 * loop.mass_kg / (loop.tick_s + lag)
    return PassivityRenderer(
        PenaltyRenderer.of(loop),
        damping_limit_N_s_m=limit,
        delay_ticks=lag / loop.tick_s,
        mass_kg=loop.mass_kg,
    )


def renderer(kind: str, loop: WallLoop) -> Renderer:
    """Return a renderer by its name in `RENDERERS`, for the wall of a loop.

    Raises
    ------
    InputError
        If the name is unknown.
    """
    built_in: dict[str, Callable[[WallLoop], Renderer]] = {
        "penalty": PenaltyRenderer.of,
        "passivity": passivity,
        "proxy": ProxyRenderer.of,
    }
    make: Callable[[WallLoop], Renderer] = RENDERERS[kind] or built_in[kind]
    return make(loop)
