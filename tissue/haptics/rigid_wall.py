"""Simulation of a hand that presses a haptic device onto a rigid virtual wall.

The simulation has its own loop, with neither a tool nor a tissue. A tick of this loop is one
sampling period of the device. The loop of `tissue.simulation` is not used, because it always moves
a tool through a tissue in ticks of 1 ms.
"""

from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array
from meshes.base.hints import suggests_arguments
from tissue.haptics.device.device import Device, DeviceParameters
from tissue.haptics.device.safe_device import SafeDevice, run_held
from tissue.haptics.device.sample_guard import SampleGuard
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, HandParameters, waypoints
from tissue.haptics.renderer import Renderer, renderer
from tissue.models.tissue_model import TICK_S

DEPTH_M = 5e-3
"""Height of the start position above the wall, and depth of the hand's target in the wall [m]."""
JERK_N = 2.0
"""Force with which the hand is jerked away from the wall [N].

On a Touch with a wall of 400 N/m, the jerk moves the hand by 2 mm, from inside the wall to its
surface.
"""
JERK_S = (0.8, 0.82)
LASTS_S = 1.3
"""End of the simulation [s]; `JERK_S` contains the start and the end of the jerk [s].

At 0.7 s, simulated hands of all groups rest on the wall. A stable loop is at rest again 0.2 s after
the jerk. Motion in the last 0.3 s therefore shows an oscillation of the loop.
"""


@suggests_arguments
@dataclass(frozen=True)
class WallRun:
    """Record of n ticks of a device on the wall z = 0, with free space at z > 0.

    Attributes
    ----------
    time_s
        Start of every tick [s], shape (n,).
    position_m, velocity_m_s
        Position [m] and velocity [m/s] as sampled by the device, shape (n, 3). Without a valid
        sample, the last position is kept and the velocity is zero.
    force_N
        Force commanded to the device in each tick [N], shape (n, 3).
    taken_J
        Energy that the loop has taken from the device up to each tick [J], shape (n,), computed
        from the sampled positions.
    """

    time_s: Array
    position_m: Array
    velocity_m_s: Array
    force_N: Array
    taken_J: Array

    def ripple_N(self, last_s: float) -> float:
        """Return the RMS deviation [N] of the force from its mean over the last ``last_s`` [s]."""
        last = self.time_s > self.time_s[-1] - last_s
        return float(np.linalg.norm(self.force_N[last].std(axis=0)))


def press_wall(
    device: Device,
    law: Renderer,
    *,
    duration_s: float,
    tick_s: float = TICK_S,
    guard: SampleGuard | None = None,
) -> WallRun:
    """Run a device on a rigid virtual wall, with a given renderer.

    Outside the wall, the proxy is at the position of the device. Inside the wall, the proxy is the
    projection of the device onto the plane, and its velocity is the component of the device's
    velocity along the plane. Without `guard`, every sample is treated as valid, and the force is
    zero if a sample is missing. The last commanded force is always zero.
    """
    ticks = round(duration_s / tick_s)
    position, velocity, force = np.zeros((3, ticks, 3))
    nothing = np.zeros(3)
    held = SafeDevice(device, tick_s=tick_s)

    def press() -> None:
        """Run every tick: read the device, render the law at the wall, play the force."""
        for tick in range(ticks):
            time = tick * tick_s
            sample = held.read(time)
            if guard is not None:
                sample = guard.validate_sample(sample, time)
            wanted: Array | None = None
            if sample is not None:
                position[tick] = sample.position_m
                velocity[tick] = sample.velocity_m_s
                foot = position[tick].copy()
                slide = velocity[tick].copy()
                if foot[2] < 0.0:
                    foot[2] = slide[2] = 0.0
                wanted = law.render(position[tick], velocity[tick], foot, slide, tick_s)
            else:
                law.pause()
                position[tick] = position[tick - 1]
            played = nothing if wanted is None else wanted
            force[tick] = played if guard is None else guard.limit_force(wanted)[0]
            held.play(force[tick], nothing)

    # An unstable loop may grow without bound. Its run is a result, not a fault.
    with np.errstate(invalid="ignore", over="ignore"):
        run_held(press, held)
    moved = np.diff(position, axis=0)
    taken = np.zeros(ticks)
    taken[1:] = -np.cumsum(np.einsum("ij,ij->i", force[:-1], moved))
    return WallRun(np.arange(ticks, dtype=np.float64) * tick_s, position, velocity, force, taken)


def knock(
    device: DeviceParameters,
    hand: HandParameters,
    kind: str,
    stiffness_N_m: float,
) -> tuple[WallRun, SimulatedDevice]:
    """Simulate a hand that presses a device against a wall and is jerked away from the wall.

    The target position of the hand is 5 mm inside the wall. The jerk is a force of 2 N for 20 ms,
    after 0.8 s. The hand has no noise and no tremor, so that motion after the jerk is caused by the
    loop.
    """
    quiet = replace(hand, endpoint_noise=0.0, force_noise=0.0, tremor_m=0.0)
    # The target jumps within one tick. The hand follows it with a smooth movement.
    path = waypoints(np.array([0.0, 1e-3]), np.array([[0.0, 0.0, DEPTH_M], [0.0, 0.0, -DEPTH_M]]))
    jerk = np.array([0.0, 0.0, JERK_N])
    holding = Hand(
        quiet,
        path,
        rng=np.random.default_rng(0),
        step_s=1.0 / device.rate_Hz,
        push=lambda time_s: jerk if JERK_S[0] <= time_s < JERK_S[1] else 0.0 * jerk,
    )
    simulated = SimulatedDevice(device, holding, position_m=(0.0, 0.0, DEPTH_M))
    law = renderer(kind, device.loop(stiffness_N_m))
    return press_wall(simulated, law, duration_s=LASTS_S, tick_s=1.0 / device.rate_Hz), simulated
