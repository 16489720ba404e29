"""Whether a wall is stable on a haptic device: known before it runs, shown by running it:
`tissue.stability`.
"""

from dataclasses import dataclass

import numpy as np

from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.loop.critical_stiffness import Verdict, critical_stiffness_N_m, in_hands, judge
from tissue.haptics.loop.sampled_loop import WallLoop
from tissue.haptics.loop.stability_map import growth_while_running
from tissue.haptics.rigid_wall import WallRun
from tissue.haptics.rigid_wall import knock as knocked

__all__ = [
    "Knock",
    "Verdict",
    "WallLoop",
    "critical_stiffness_N_m",
    "growth",
    "judge",
    "knock",
    "wall_loop",
]


def wall_loop(
    device: str | DeviceParameters, stiffness_N_m: float, *, hand: str | None = None
) -> WallLoop:
    """The loop that holds a device against a rigid wall; ``dataclasses.replace`` changes its tick,
    delay and so on.

    Parameters
    ----------
    device
        A known device by its name, or the numbers of one.
    stiffness_N_m
        Stiffness of the wall [N/m].
    hand
        Whose hand holds it: novice, intermediate, expert or one that was registered; None for
        nobody's.

    Raises
    ------
    InputError
        If device or hand is unknown, or the stiffness is out of range.
    """
    loop = _numbers(device).loop(stiffness_N_m)
    return loop if hand is None else in_hands(loop, [hand_parameters(hand).grip[:3]])[0]


def growth(loop: WallLoop, *, seconds: float = 4.0) -> float:
    """How much larger a push has become, between 45 and 85 % of a run of the loop: above 1 it
    grows, below it fades.

    Parameters
    ----------
    loop
        As `wall_loop` gives it; it runs as on a device, sample by sample.
    seconds
        Length of the run [s].
    """
    ticks = round(seconds / loop.tick_s / loop.model_ticks) * loop.model_ticks
    return float(growth_while_running([loop], np.array([loop.stiffness_N_m]), ticks=ticks)[0])


@dataclass(frozen=True)
class Knock(WallRun):
    """What a hand met on the wall z = 0, tick by tick.

    Attributes
    ----------
    given_J
        Energy that the motors gave to the hand in all, lag included [J]; negative where they took
        some.
    """

    given_J: float


def knock(
    device: str | DeviceParameters, stiffness_N_m: float, *, hand: str = "expert", renderer: str
) -> Knock:
    """A hand moves a device onto a wall, holds it 5 mm deep and is jerked off it after 0.8 s, by 2
    N for 20 ms.

    The hand has neither noise nor tremor, so that what moves after the jerk is the loop's own.

    Parameters
    ----------
    device, stiffness_N_m, hand
        As of `wall_loop`.
    renderer
        Law by which the wall is played: penalty, passivity, proxy or one that was registered.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    run, simulated = knocked(_numbers(device), hand_parameters(hand), renderer, stiffness_N_m)
    return Knock(**vars(run), given_J=float(simulated.translation.motor_work_J))


def _numbers(device: str | DeviceParameters) -> DeviceParameters:
    return device_parameters(device) if isinstance(device, str) else device
