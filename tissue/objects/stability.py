"""Stability of a haptic device at a virtual wall, predicted or simulated: `tissue.stability`."""

from dataclasses import dataclass

import numpy as np

from meshes.base.hints import suggests_arguments
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


@suggests_arguments
def wall_loop(
    device: str | DeviceParameters, stiffness_N_m: float, *, hand: str | None = None
) -> WallLoop:
    """Return the control loop of a haptic device, held by a hand, at a virtual wall.

    To change its fields, such as the tick and the delay, use ``dataclasses.replace``.

    Parameters
    ----------
    device
        Name of a known device, or the parameters of a device.
    stiffness_N_m
        Stiffness of the wall [N/m].
    hand
        Hand that holds the device: ``novice``, ``intermediate``, ``expert`` or a registered hand;
        None for no hand. The hand has no reflex; to add a reflex, set `reflex_N_m` and `reflex_s`
        of the `WallLoop`.

    Raises
    ------
    InputError
        If the device or the hand is unknown, or the stiffness is out of range.
    """
    loop = _numbers(device).loop(stiffness_N_m)
    return loop if hand is None else in_hands(loop, [hand_parameters(hand).grip[:3]])[0]


@suggests_arguments
def growth(loop: WallLoop, *, seconds: float = 4.0) -> float:
    """Compute the factor by which a perturbation grows from 45 % to 85 % of the simulated duration.

    If the factor is above 1, the perturbation grows; if it is below 1, the perturbation decays.

    Parameters
    ----------
    loop
        Loop from `wall_loop`. It is simulated in discrete time, as on a device.
    seconds
        Simulated duration [s].
    """
    ticks = round(seconds / loop.tick_s / loop.model_ticks) * loop.model_ticks
    return float(growth_while_running([loop], np.array([loop.stiffness_N_m]), ticks=ticks)[0])


@dataclass(frozen=True)
class Knock(WallRun):
    """Simulated motion, tick by tick, of a hand that holds a device on a wall at z = 0.

    Attributes
    ----------
    given_J
        Total work that the motors did on the device's moving mass [J]. It is negative if the motors
        absorbed energy.
    """

    given_J: float


@suggests_arguments
def knock(
    device: str | DeviceParameters, stiffness_N_m: float, *, hand: str = "expert", renderer: str
) -> Knock:
    """Simulate a hand that presses a device against a wall, and disturb the device with a force.

    The target position of the hand is 5 mm inside the wall. After 0.8 s, a force of 2 N pulls the
    device outward for 20 ms. The hand has neither noise nor tremor. Sustained motion after the pull
    therefore shows that the control loop is unstable.

    Parameters
    ----------
    device, stiffness_N_m, hand
        As for `wall_loop`.
    renderer
        Law that computes the force of the wall at the device: ``penalty``, ``passivity``, ``proxy``
        or a registered law.

    Raises
    ------
    InputError
        If a name is unknown.
    """
    run, simulated = knocked(_numbers(device), hand_parameters(hand), renderer, stiffness_N_m)
    return Knock(**vars(run), given_J=float(simulated.translation.motor_work_J))


def _numbers(device: str | DeviceParameters) -> DeviceParameters:
    return device_parameters(device) if isinstance(device, str) else device
