"""A hand that leans with a device on a rigid wall, with faults by schedule: what several pages run."""

from collections.abc import Callable, Sequence

import numpy as np

from tissue.haptics.device.device import Device, Sample, device_parameters
from tissue.haptics.device.faulty import Fault, FaultyDevice
from tissue.haptics.device.sample_guard import SampleGuard
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters
from tissue.haptics.hand.minimum_jerk import waypoints
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import WallRun, press_wall

__all__ = ["DEVICE", "FAULT_S", "STIFFNESS_N_M", "TICK_S", "pressed"]

DEVICE = device_parameters("omni")
TICK_S, STIFFNESS_N_M, DEPTH_M = 1e-3, 1500.0, 5e-3
FAULT_S = 0.15
"""When faults begin [s]: the hand has come to rest in the wall."""


def pressed(
    faults: Sequence[Fault] = (), *, seconds: float, guarded: bool, change: Callable[[Sample], Sample] | None = None
) -> tuple[WallRun, SampleGuard | None]:
    """Run the press, with ``guarded`` through the sample guard as the engine does; ``change`` alters one sample."""
    path = waypoints(np.array([0.0, 1e-3]), np.full((2, 3), (0.0, 0.0, -DEPTH_M)))
    hand = Hand(hand_parameters("expert"), path, rng=np.random.default_rng(7))
    simulated = SimulatedDevice(DEVICE, hand, position_m=(0.0, 0.0, 0.0))
    guard = SampleGuard(force_limit_N=DEVICE.force_limit_N) if guarded else None
    device: Device = FaultyDevice(simulated, faults) if change is None else _Changed(simulated, change)
    return press_wall(device, renderer("penalty", DEVICE.loop(STIFFNESS_N_M)), duration_s=seconds, guard=guard), guard


class _Changed:
    """A device one of whose samples is altered."""

    in_process = True

    def __init__(self, device: Device, change: Callable[[Sample], Sample]) -> None:
        self._device, self._change, self.command = device, change, device.command

    def read(self, time_s: float) -> Sample | None:
        """The sample, altered if it is that of the fault."""
        sample = self._device.read(time_s)
        return self._change(sample) if sample is not None and abs(time_s - FAULT_S) < 0.5 * TICK_S else sample
