"""Lift and contrast for one observer: what lets this person discriminate most forces, within a safe slope."""

from itertools import product

import numpy as np

from meshes.base.arrays import Array
from tissue.perception.enhancement import Contrast, Lift, steepest
from tissue.perception.observer import Observer

__all__ = ["SLOPE_MOST", "separation", "tuned_enhancement"]

SLOPE_MOST = 2.0
"""Greatest slope that is chosen. That the judge then lowers the coupling's stiffness (in the study from 310 to 200 N/m)
is not weighed."""
LIFTS = np.linspace(1.0, SLOPE_MOST, 21)
EXPONENTS = np.linspace(1.0, 1.5, 21)
BAND = (0.03, 0.7)
"""Shares of the device's greatest force between which forces are met, all alike in their logarithm."""
LEVELS = 25
STEP = 0.1
"""Difference that shall be discriminated, as a share of the level: a contrast is an exponent of the mean, so that it is
that share, less what the mean itself follows."""


def separation(forces_N: Array, kappa: float, offset_N: float, lift: Lift, contrast: Contrast) -> Array:
    """Distances of neighbouring forces in thresholds, each pair about its own mean [1], shape (n,).

    Parameters
    ----------
    forces_N
        Pairs of forces at the device [N], shape (n, 2).
    kappa, offset_N
        The threshold kappa (F + offset) of the weaker one; friction that a hand works against is part of the offset.
    lift, contrast
        What is done to the forces.
    """
    lifted = np.array([[lift.size_N(force) for force in pair] for pair in forces_N.tolist()])
    means = lifted.mean(axis=1)
    felt = np.array(
        [[contrast.size_N(f, m) for f in pair] for pair, m in zip(lifted.tolist(), means.tolist(), strict=True)]
    )
    return np.asarray((felt[:, 1] - felt[:, 0]) / (kappa * (felt[:, 0] + offset_N)))


def tuned_enhancement(
    observer: Observer, *, force_limit_N: float, friction_N: float, adaptation_s: float
) -> tuple[Lift, Contrast]:
    """Lift and contrast with the greatest mean separation of forces that differ by a tenth, for one observer.

    Parameters
    ----------
    observer
        Gives the threshold: its medians are taken.
    force_limit_N, friction_N
        Greatest force and Coulomb friction of the device [N]. Friction is felt beside every force that is played to a
        moving hand, so that it counts to the observer's term for low forces.
    adaptation_s
        Time constant of the contrast's mean [s].
    """
    levels = force_limit_N * np.geomspace(*BAND, LEVELS)
    pairs = np.column_stack([levels, (1.0 + STEP) * levels])
    below_N = 0.3 * force_limit_N
    best, most = (Lift(below_N=below_N), Contrast(adaptation_s=adaptation_s)), 0.0
    for gain, exponent in product(LIFTS.tolist(), EXPONENTS.tolist()):
        lift = Lift(gain=gain, below_N=below_N)
        contrast = Contrast(exponent=exponent, adaptation_s=adaptation_s)
        if steepest(lift, contrast) > SLOPE_MOST:
            continue
        offset_N = observer.offset_N + friction_N
        found = float(separation(pairs, observer.kappa, offset_N, lift, contrast).mean())
        if found > most:
            best, most = (lift, contrast), found
    return best
