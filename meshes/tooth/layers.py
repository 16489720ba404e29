"""Layers of a tooth: names, densities, softness of decayed dentin, and checks of names and size.

M = from memory of the literature, with confidence H, M or L.

=========  =================  ==========================================================================
enamel     2900 kg/m3         M, H: 2.8 to 3.0 (Weidmann 1967)
dentin     2100 kg/m3         M, H: 2.05 to 2.30 (Manly 1939)
pulp       1000 kg/m3         M, M: soft tissue, nearly water
caries     2100 to 1300       M, L: infected dentin keeps about a third of its mineral (after Angker 2004)
ligament   1100 kg/m3         M, M: fibrous soft tissue
bone       1800 kg/m3         M, H: alveolar bone taken as cortical throughout
=========  =================  ==========================================================================
"""  # noqa: E501 a table

from collections.abc import Callable, Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Floats
from meshes.base.errors import InputError

__all__ = [
    "BONE",
    "CARIES",
    "DENTIN",
    "EMPTY",
    "ENAMEL",
    "LAYER_DENSITY_KG_M3",
    "LIGAMENT",
    "PRIORITY",
    "PULP",
    "TOOTH_LAYERS",
    "caries_density",
    "caries_softness",
    "in_chunks",
    "require_known",
    "require_tooth_size",
]

Kind = TypeVar("Kind", bound=np.generic)

TOOTH_LAYERS = ("enamel", "dentin", "pulp", "caries", "ligament", "bone")
ENAMEL, DENTIN, PULP, CARIES, LIGAMENT, BONE = range(6)
LAYER_DENSITY_KG_M3 = {
    "enamel": 2900.0,
    "dentin": 2100.0,
    "pulp": 1000.0,
    "caries": 1700.0,
    "ligament": 1100.0,
    "bone": 1800.0,
}
"""Density of each layer [kg/m3].

The density of `caries` is for a lesion of unknown softness (one half).
"""

EMPTY = 255
"""Layer index outside the tooth."""
PRIORITY = ("caries", "pulp", "enamel", "dentin", "ligament", "bone")
"""Order of layers that claim the same place: the first one takes it."""

_SOUND_KG_M3 = 2100.0
_INFECTED_KG_M3 = 1300.0
_POINTS_AT_ONCE = 1 << 17
_SMALLEST_MM = 5.0
_LARGEST_MM = 40.0
_TYPICAL_MM = 18.0


def caries_density(softness: Floats) -> Floats:
    """Compute the density [kg/m3] of decayed dentin from its softness.

    It is linear in the softness, 0 (sound) to 1 (fully softened).
    """
    return _SOUND_KG_M3 - (_SOUND_KG_M3 - _INFECTED_KG_M3) * softness


def caries_softness(density_kg_m3: Floats) -> Floats:
    """Compute the softness of the layer `caries` from its density [kg/m3].

    It is (2100 - density)/800, limited to 0 to 1.

    0 is sound dentin, 1 fully softened, infected dentin. Only for voxels of that layer: sound
    tissues have densities of their own.
    """
    density = np.asarray(density_kg_m3)
    return np.clip((_SOUND_KG_M3 - density) / (_SOUND_KG_M3 - _INFECTED_KG_M3), 0.0, 1.0)


def in_chunks(function: Callable[[Floats], NDArray[Kind]], points: Floats) -> NDArray[Kind]:
    """Apply a function of points, shape (n, 3), to parts that fit the processor's cache."""
    if len(points) <= _POINTS_AT_ONCE:
        return function(points)
    starts = range(0, len(points), _POINTS_AT_ONCE)
    return np.concatenate(
        [function(np.asfortranarray(points[k : k + _POINTS_AT_ONCE])) for k in starts]
    )


def require_known(names: Iterable[str], argument: str) -> None:
    """Raise for names that are not layers of a tooth, and for a tooth without enamel or dentin."""
    given = list(names)
    for name in given:
        if name not in TOOTH_LAYERS:
            raise InputError(
                argument, f"name layers of {', '.join(TOOTH_LAYERS)}", name, "rename it"
            )
    for name in ("enamel", "dentin"):
        if name not in given:
            raise InputError(
                argument, "give enamel and dentin", ", ".join(given) or "none", f"add the {name}"
            )


def require_tooth_size(size_mm: float, argument: str, given: str, per_unit: float) -> None:
    """Raise if the longest side [mm] is not a tooth's.

    The message suggests a value of the argument that sets it.

    Parameters
    ----------
    argument, given
        Argument that sets the size, and its value.
    per_unit
        Size relative to that value: voxels along the side, or file units.
    """
    if _SMALLEST_MM <= size_mm <= _LARGEST_MM:
        return
    raise InputError(
        argument,
        f"make the tooth {_SMALLEST_MM:g} to {_LARGEST_MM:g} mm long",
        f"{given}, which makes it {size_mm:.3g} mm",
        f"use the scanner's value, about {_TYPICAL_MM / per_unit:.1g}",
    )
