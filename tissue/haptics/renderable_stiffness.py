"""The stiffest wall that a device plays without ringing, for each renderer, and what its physics allows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tissue.haptics.device.device import DeviceParameters
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, HandParameters
from tissue.haptics.hand.minimum_jerk import waypoints
from tissue.haptics.loop.critical_stiffness import critical_stiffness_N_m, in_hands
from tissue.haptics.loop.stability_bounds import passive_bound_N_m
from tissue.haptics.renderer import renderer
from tissue.haptics.rigid_wall import WallRun, press_wall
from tissue.scene.registry import RENDERERS

__all__ = ["WallLimit", "knock", "wall_limits"]

Array = NDArray[np.float64]
RUNG = 10.0 ** (1.0 / 16.0)
"""Step of the ladder of stiffnesses: 15 %."""
LOWEST_N_M, HIGHEST_N_M = 50.0, 4e4
RINGING_N = 0.05
"""Ripple that counts as ringing [N]: below the 7 % of about 1 N that a person discriminates (Pang et al., 1991)."""
DEPTH_M, JERK_N, JERK_S, LASTS_S = 5e-3, 2.0, (0.8, 0.82), 1.3


@dataclass(frozen=True)
class WallLimit:
    """How stiff a wall was played.

    Attributes
    ----------
    renderer, rate_Hz, delay_s
        With what.
    reached_N_m
        Last stiffness of the ladder before the first that rings [N/m]; 0 if the lowest does.
    held_N_m, free_N_m
        Critical stiffness of the linear loop in this hand and in none [N/m].
    passive_N_m
        Bound of a wall that is passive by itself [N/m].
    """

    renderer: str
    rate_Hz: float
    delay_s: float
    reached_N_m: float
    held_N_m: float
    free_N_m: float
    passive_N_m: float

    @property
    def ratio(self) -> float:
        """What was reached over what the linear loop in this hand allows.

        Not 1, because a wall is left and met again (each bounce is a new impact, and the hold leaks in and out) and
        encoders step, which lowers it; because friction takes energy that the linear loop does not have; and because a
        controller adds damping of its own, which raises it.
        """
        return self.reached_N_m / self.held_N_m


def knock(
    device: DeviceParameters, hand: HandParameters, kind: str, stiffness_N_m: float, *, damping_N_s_m: float = 0.0
) -> tuple[WallRun, SimulatedDevice]:
    """Move onto a wall, hold 5 mm into it, and be jerked off it after 0.8 s (2 N for 20 ms).

    The hand is without noise and tremor, so that what moves after the jerk is the loop's own.
    """
    quiet = replace(hand, endpoint_noise=0.0, force_noise=0.0, tremor_m=0.0)
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
    law = renderer(kind, device.loop(stiffness_N_m, wall_damping_N_s_m=damping_N_s_m))
    return press_wall(simulated, law, duration_s=LASTS_S, tick_s=1.0 / device.rate_Hz), simulated


def wall_limits(
    device: DeviceParameters,
    hand: HandParameters,
    *,
    rates_Hz: Sequence[float] = (500.0, 1000.0, 2000.0, 4000.0),
    delays_s: Sequence[float] = (0.0, 1e-3, 2e-3, 4e-3),
    renderers: Sequence[str] | None = None,
) -> list[WallLimit]:
    """The stiffest quiet wall for every renderer (without them all that are known), rate and delay.

    Stiffness climbs in steps of 15 % until the force ripples by more than 0.05 N, 0.3 to 0.5 s after the jerk.
    """
    found = []
    for rate in rates_Hz:
        for delay in delays_s:
            at = replace(device, rate_Hz=rate, transport_delay_s=delay)
            loop = at.loop(1.0)
            held = critical_stiffness_N_m(in_hands(loop, [hand.grip[:3]])[0])
            free, passive = critical_stiffness_N_m(loop), passive_bound_N_m(loop)
            for kind in renderers or RENDERERS:
                found.append(WallLimit(kind, rate, delay, _reached(at, hand, kind), held, free, passive))
    return found


def _reached(device: DeviceParameters, hand: HandParameters, kind: str) -> float:
    """Last stiffness before the first that rings [N/m]."""
    reached, stiffness = 0.0, LOWEST_N_M
    while stiffness < HIGHEST_N_M:
        run, _ = knock(device, hand, kind, stiffness)
        if not run.ripple_N(0.2) < RINGING_N:
            break
        reached, stiffness = stiffness, stiffness * RUNG
    return reached
