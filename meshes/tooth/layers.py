"""What the layers of a tooth are called, how dense they are, and how softened dentin differs from sound in density.

M = from memory of the literature, with confidence H, M or L.

=========  =================  ==========================================================================
enamel     2900 kg/m3         M, H: 2.8 to 3.0 (Weidmann 1967)
dentin     2100 kg/m3         M, H: 2.05 to 2.30 (Manly 1939)
pulp       1000 kg/m3         M, M: soft tissue, nearly water
caries     2100 to 1300       M, L: infected dentin keeps about a third of its mineral (after Angker 2004)
ligament   1100 kg/m3         M, M: fibrous soft tissue
bone       1800 kg/m3         M, H: alveolar bone taken as cortical throughout
=========  =================  ==========================================================================
"""

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Floats

__all__ = [
    "BONE",
    "CARIES",
    "DENTIN",
    "ENAMEL",
    "LAYER_DENSITY_KG_M3",
    "LIGAMENT",
    "PRIORITY",
    "PULP",
    "TOOTH_LAYERS",
    "caries_density",
    "caries_softness",
    "in_chunks",
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
"""Density of each layer [kg/m3]; that of `caries` stands for a lesion of unknown softness (one half)."""

PRIORITY = ("caries", "pulp", "enamel", "dentin", "ligament", "bone")
"""Of two layers that claim a place, the one named first has it."""

_SOUND_KG_M3, _INFECTED_KG_M3 = 2100.0, 1300.0
_POINTS_AT_ONCE = 1 << 17


def caries_density(softness: Floats) -> Floats:
    """Density [kg/m3] of a lesion's voxels of the given softness, 0 (sound dentin) to 1 (fully softened), linear."""
    return _SOUND_KG_M3 - (_SOUND_KG_M3 - _INFECTED_KG_M3) * softness


def caries_softness(density_kg_m3: Floats) -> Floats:
    """Softness of voxels of the layer `caries` from their density [kg/m3]: (2100 - density)/800, held within 0 to 1.

    0 is sound dentin, 1 fully softened, infected dentin. Only for voxels of that layer: sound tissues have densities of
    their own.
    """
    density = np.asarray(density_kg_m3)
    return np.clip((_SOUND_KG_M3 - density) / (_SOUND_KG_M3 - _INFECTED_KG_M3), 0.0, 1.0)


def in_chunks(function: Callable[[Floats], NDArray[Kind]], points: Floats) -> NDArray[Kind]:
    """Apply a function of points, shape (n, 3), to parts that fit the processor's cache."""
    if len(points) <= _POINTS_AT_ONCE:
        return function(points)
    starts = range(0, len(points), _POINTS_AT_ONCE)
    return np.concatenate([function(np.asfortranarray(points[k : k + _POINTS_AT_ONCE])) for k in starts])
