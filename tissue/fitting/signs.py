"""Detection of load channels whose sign is reversed.

Constants of a fit have a known sign, so they cannot explain a channel of opposite sign. The fit
would treat it as a bias with noise and return wrong constants without a message. Each channel, all
forces, all torques and all loads are therefore fitted with their signs reversed as well.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fitting.forward import Forward
from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.posterior import climbed, starts
from tissue.fitting.target import Target

__all__ = ["require_signs", "reversed_channels"]

GAIN = 10.0
"""Log density that reversed signs must add: odds of 2e4, where chance between two signs is one."""
SCREENED = 50.0
"""Deficit of the log density up to which reversed signs are searched further.

The search moves the noise too.
"""
EXPLAINED = 0.5
"""Share of a channel's variance that the loads must explain once it is reversed: a channel of
noise has no sign.
"""


def require_signs(forward: Forward, log: MeasuredLoads) -> None:
    """Refuse a log with channels that are explained better with their signs reversed.

    Raises
    ------
    InputError
        With the names of these channels.
    """
    if wrong := reversed_channels(forward, log):
        names = ", ".join(wrong)
        is_one = len(wrong) == 1
        raise InputError(
            f"measured has {names} with {'its sign' if is_one else 'their signs'} reversed. "
            "With the opposite sign the "
            f"scene explains {'it' if is_one else 'them'} better. Loads must act on the "
            "tool, in the scene's frame: "
            "reverse the sign with --column "
            f"{wrong[0]}=-COLUMN{'' if is_one else ' and so on'}, or drop the column"
        )


def reversed_channels(forward: Forward, log: MeasuredLoads) -> tuple[str, ...]:
    """Return the channels that the model explains better with reversed signs.

    Parameters
    ----------
    forward
        Loads by the constants.
    log
        Measured loads.
    """
    signs = np.ones(len(log.channels))
    best, _ = _search(forward, log, signs, -np.inf)
    for _ in log.channels:
        found = signs
        for places in _groups(log.channels):
            tried = signs.copy()
            tried[places] *= -1.0
            density, explained = _search(forward, log, tried, best + GAIN)
            if density > best + GAIN and (explained[places] > EXPLAINED).any():
                best = density
                found = tried
        if found is signs:
            break
        signs = found
    return tuple(
        name for name, sign in zip(log.channels, signs.tolist(), strict=True) if sign < 0.0
    )


def _groups(channels: Sequence[str]) -> list[list[int]]:
    """Return indices of single channels, of all forces, of all torques, and of all loads."""
    kinds = [
        [at for at, name in enumerate(channels) if name.startswith(kind)]
        for kind in ("force_", "torque_", "")
    ]
    several = [places for places in kinds if len(places) > 1]
    return [[at] for at in range(len(channels))] + [
        each for at, each in enumerate(several) if each not in several[:at]
    ]


def _search(
    forward: Forward, log: MeasuredLoads, signs: Array, wanted: float
) -> tuple[float, Array]:
    """Return the largest log density of a log with these signs, and the explained variance.

    The explained share of the variance is computed for each channel. If the first guess is far from
    the wanted density, the results of the guess are returned.
    """
    target = Target(forward, replace(log, values=log.values * signs))
    density, u = starts(target)[0]
    if density > wanted - SCREENED:
        density, u = climbed(target, u)
    left = np.nanvar(target.log.values - target.simulated(u), axis=0)
    whole = np.nanvar(target.log.values, axis=0)
    return density, 1.0 - np.divide(left, whole, out=np.ones_like(whole), where=whole > 0.0)
