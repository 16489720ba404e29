"""Force rendering laws between a device and its proxy, behind one interface."""

from collections.abc import Callable
from math import inf, pi
from typing import Protocol

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive, require_range
from tissue.haptics.loop.passivity import RELEASE_RAD_S, PassivityControl
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.motion.quaternion import Quaternion, turn_between
from tissue.scene.registry import RENDERERS

__all__ = [
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
        self.stiffness_N_m = require_positive(
            "stiffness_N_m", stiffness_N_m, "use what the device can hold, about 500"
        )
        self.damping_N_s_m = require_range(
            "damping_N_s_m", damping_N_s_m, 0.0, 1e6, "use 0 for none"
        )

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
