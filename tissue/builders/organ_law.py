"""The hyperelastic law that a scene asks for, with the small strains of the linear one."""

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.materials.hyperelasticity import Hyperelastic
from tissue.scene.named_parts import shown
from tissue.scene.organ import Organ

__all__ = ["law_of"]

NOT_WITH = ("capsule", "gravity", "viscous", "fibre_direction")
"""Keys of an organ that a hyperelastic law cannot have yet."""
SHAPE = {"mooney-rivlin": "second_share", "yeoh": "square_ratio", "ogden": "exponent"}
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
    others = {name: getattr(organ, name) for name in NOT_WITH}
    others["path"] = organ.path if organ.path != "condensed" else None
    for name, value in others.items():
        if value:
            raise InputError(
                f"organ.law and organ.{name} must be left out together, got {organ.law} and {shown(value)}: "
                "remove one, a law of large strains has an isotropic elastic organ without weight, on its "
                "condensed compliance"
            )
    first, shear = lame_Pa[0].tolist()
    bulk = first + 2.0 / 3.0 * shear
    return _law(organ, shear, bulk), np.asarray(lame_Pa[:, 1] / shear)


def _law(organ: Organ, shear_Pa: float, bulk_Pa: float) -> Hyperelastic:
    if organ.law == "neo-hookean":
        return Hyperelastic.neo_hookean(shear_Pa, bulk_Pa=bulk_Pa)
    if organ.law == "mooney-rivlin" and (share := organ.second_share) is not None:
        return Hyperelastic.mooney_rivlin(0.5 * (1.0 - share) * shear_Pa, 0.5 * share * shear_Pa, bulk_Pa=bulk_Pa)
    if organ.law == "yeoh" and organ.square_ratio is not None:
        first = 0.5 * shear_Pa
        return Hyperelastic.yeoh(first, organ.square_ratio * first, organ.cube_ratio * first, bulk_Pa=bulk_Pa)
    if organ.law == "ogden" and organ.exponent is not None:
        return Hyperelastic(bulk_Pa, ((shear_Pa, organ.exponent),))
    raise InputError(f"organ.{SHAPE[organ.law]} must be given with organ.law = {organ.law}, got none: state it")
