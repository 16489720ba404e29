"""Perception that a scene names."""

from math import inf
from pathlib import Path

import numpy as np

from tissue.haptics.loop.filters import ForceRange
from tissue.materials.constants import constants
from tissue.perception.laws import ForceMap, intensity_of, weber_of
from tissue.perception.observer import (
    Observer,
    population_observer,
    read_observer,
    reference_observer,
)
from tissue.perception.perceived import Deadband, PerceivedForce, Perception, Sense
from tissue.scene.registry import PERCEPTIONS

__all__ = ["CAUTION", "of_observer", "of_population", "perception", "perception_for"]

CAUTION = 0.1
"""Quantile of the threshold's distribution that bounds the deadband.

Nine in ten observers have a larger threshold.
"""


def perception(
    choice: str,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float = inf,
) -> Perception | None:
    """Return a perception by its name in `PERCEPTIONS`; None for ``none``.

    Parameters
    ----------
    choice
        The name.
    rng
        Random generator of the observer's sensory noise.
    force_limit_N
        Largest force of the device [N].
    tick_s
        Time between two steps [s].
    friction_N
        Coulomb friction of the device [N]. The deadband is no wider than this, so at every instant
        friction dissipates the energy that the held force supplies. Use infinity to bound the
        deadband by the threshold alone.

    Raises
    ------
    InputError
        If the name is unknown or the file cannot be used.
    """
    if choice == "none":
        return None
    name, argument = PERCEPTIONS.split(choice, "none")
    make = PERCEPTIONS[name] or {"population": of_population, "observer:FILE": of_observer}[name]
    return make(
        argument, rng=rng, force_limit_N=force_limit_N, tick_s=tick_s, friction_N=friction_N
    )


def of_population(
    argument: str,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float,
) -> PerceivedForce:
    """Return the perception of an unknown observer from the population."""
    return perception_for(
        population_observer(),
        rng=rng,
        force_limit_N=force_limit_N,
        tick_s=tick_s,
        friction_N=friction_N,
    )


def of_observer(
    argument: str,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float,
) -> PerceivedForce:
    """Return the perception of the observer in a file written by `tissue calibrate`."""
    return perception_for(
        read_observer(Path(argument)),
        rng=rng,
        force_limit_N=force_limit_N,
        tick_s=tick_s,
        friction_N=friction_N,
    )


def perception_for(
    observer: Observer,
    *,
    rng: np.random.Generator,
    force_limit_N: float,
    tick_s: float,
    friction_N: float = inf,
) -> PerceivedForce:
    """Return the perception of an observer on a device; see `perception`."""
    device = ForceRange(limit_N=force_limit_N)
    knee_N = device.knee_share * device.limit_N
    reference = reference_observer()
    lowest_N = min(observer.offset_N, 0.5 * knee_N)
    law = ForceMap(
        intensity_of(reference), intensity_of(observer), lowest_N=lowest_N, knee_N=knee_N
    )
    held = weber_of(observer, quantile=CAUTION)
    sentence = (
        f"felt by {observer.name}: changes below {held.kappa:.3g} of (F + {held.offset:.3g} N) "
        "are held back"
    )
    if law.gain < 1.0:
        sentence += (
            f", and all intensities are {law.gain**reference.beta:.3g} of the reference "
            "observer's, so that the "
            "device can play them in their ratios"
        )
    return PerceivedForce(
        law,
        Deadband(held, widest=friction_N),
        Sense(
            weber_of(observer),
            integration_s=constants("perception", "force")["integration_s"].value,
            tick_s=tick_s,
            rng=rng,
        ),
        sentence=sentence,
    )
