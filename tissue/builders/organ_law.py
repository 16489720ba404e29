"""The hyperelastic law that a scene asks for, with the small strains of the linear one."""

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.scene.organ import Organ

__all__ = ["law_of"]

NOT_WITH = ("capsule", "gravity", "viscous")
"""Keys of an organ that a hyperelastic law cannot have yet."""
SHAPE = {"mooney-rivlin": "second_share", "yeoh": "power_ratios", "ogden": "exponent"}
"""What each law needs beside the modulus and Poisson's ratio; none is cited for an organ."""


def law_of(organ: Organ, lame_Pa: Array) -> tuple[Hyperelastic, Array] | None:
    """The law of the first cell, and what its moduli are multiplied by in each, shape (m,); None for the linear one.

    Parameters
    ----------
    organ
        What the scene states.
    lame_Pa
        Lame constants of small strains [Pa], shape (m, 2), in one proportion, as `elasticity_of` gives them.

    Raises
    ------
    InputError
        If the scene asks for what the law cannot have, or does not state what the law needs.
    """
    if organ.law == "linear":
        return None
    for name in NOT_WITH:
        if getattr(organ, name):
            raise InputError(
                f"organ.{name} must be false with organ.law = {organ.law}, got true: leave it out, or the law"
            )
    if organ.fibre_direction is not None:
        raise InputError(
            f"organ.fibre_direction must be left out with organ.law = {organ.law}, which is isotropic, got "
            f"{organ.fibre_direction}: leave it out, or the law"
        )
    if organ.path != "condensed":
        raise InputError(f"organ.path must be condensed with organ.law = {organ.law}, got {organ.path}: remove it")
    first, shear = lame_Pa[0].tolist()
    bulk = first + 2.0 / 3.0 * shear
    return _law(organ, shear, bulk), np.asarray(lame_Pa[:, 1] / shear)


def _law(organ: Organ, shear_Pa: float, bulk_Pa: float) -> Hyperelastic:
    if organ.law == "neo-hookean":
        return Hyperelastic.neo_hookean(shear_Pa, bulk_Pa=bulk_Pa)
    if organ.law == "mooney-rivlin" and (share := organ.second_share) is not None:
        return Hyperelastic.mooney_rivlin(0.5 * (1.0 - share) * shear_Pa, 0.5 * share * shear_Pa, bulk_Pa=bulk_Pa)
    if organ.law == "yeoh" and organ.power_ratios is not None:
        second, third = (0.5 * shear_Pa * ratio for ratio in organ.power_ratios)
        return Hyperelastic.yeoh(0.5 * shear_Pa, second, third, bulk_Pa=bulk_Pa)
    if organ.law == "ogden" and organ.exponent is not None:
        return Hyperelastic(bulk_Pa, ((shear_Pa, organ.exponent),))
    raise InputError(f"organ.{SHAPE[organ.law]} must be given with organ.law = {organ.law}, got none: state it")
