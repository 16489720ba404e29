"""A hand presses a device onto a rigid wall, tick by tick: what a loop does where nothing but the wall is simulated."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import require_positive
from tissue.haptics.device.device import Device
from tissue.haptics.device.safe_device import SafeDevice
from tissue.haptics.device.sample_guard import SampleGuard
from tissue.haptics.device.supervision import run_held
from tissue.haptics.loop.filters import LowPass
from tissue.haptics.renderer import Renderer

__all__ = ["WallRun", "press_wall"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WallRun:
    """What happened on the wall z = 0, whose free side is z > 0; n ticks.

    Attributes
    ----------
    time_s
        Start of every tick [s], shape (n,).
    position_m, velocity_m_s
        As the device sampled them, shape (n, 3); of the last good sample where there was none.
    force_N
        Commanded from the tick on, on the device, shape (n, 3).
    taken_J
        Energy that the loop has taken from the device up to the tick [J], shape (n,), by the positions it sampled.
    """

    time_s: Array
    position_m: Array
    velocity_m_s: Array
    force_N: Array
    taken_J: Array

    def ripple_N(self, last_s: float) -> float:
        """Root mean square of the force about its mean in the last seconds of the run [N]."""
        last = self.time_s > self.time_s[-1] - last_s
        return float(np.linalg.norm(self.force_N[last].std(axis=0)))


def press_wall(
    device: Device,
    renderer: Renderer,
    *,
    duration_s: float,
    tick_s: float = 1e-3,
    filter_s: float = 0.0,
    guard: SampleGuard | None = None,
) -> WallRun:
    """Run device, proxy on the plane, renderer, low-pass and guard for a time [s].

    The proxy of a plane is the device's point where it is free and its foot on the plane elsewhere; its velocity is the
    part along the plane. Without a guard every sample is valid and no sample means no force. Whatever ends the run,
    the device is left without force.
    """
    require_positive("duration_s", duration_s, "use 1")
    require_positive("tick_s", tick_s, "use 1e-3 for 1 kHz")
    ticks = round(duration_s / tick_s)
    position, velocity, force = np.zeros((ticks, 3)), np.zeros((ticks, 3)), np.zeros((ticks, 3))
    low_pass = LowPass(filter_s, step_s=tick_s)
    nothing = np.zeros(3)
    held = SafeDevice(device, tick_s=tick_s)

    def press() -> None:
        for tick in range(ticks):
            time = tick * tick_s
            sample = held.read(time)
            if guard is not None:
                sample = guard.validate_sample(sample, time)
            wanted: Array | None = None
            if sample is not None:
                position[tick], velocity[tick] = sample.position_m, sample.velocity_m_s
                foot, slide = position[tick].copy(), velocity[tick].copy()
                if foot[2] < 0.0:
                    foot[2] = slide[2] = 0.0
                raw = renderer.render(position[tick], velocity[tick], foot, slide, tick_s)
                wanted = low_pass.step(raw)
            else:
                renderer.pause()
                position[tick] = position[tick - 1]
            played = nothing if wanted is None else wanted
            if guard is not None:
                played, _ = guard.limit_force(wanted)
            force[tick] = played
            held.play(played, nothing)

    with np.errstate(invalid="ignore", over="ignore"):
        run_held(press, held)
    moved = np.diff(position, axis=0)
    taken = np.zeros(ticks)
    taken[1:] = -np.cumsum(np.einsum("ij,ij->i", force[:-1], moved))
    return WallRun(np.arange(ticks, dtype=np.float64) * tick_s, position, velocity, force, taken)
