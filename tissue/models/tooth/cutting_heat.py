"""Temperature of a tooth and its pulp under a bur."""

import numpy as np
from numpy.typing import NDArray

from meshes.voxels.volume import VoxelVolume
from tissue.materials.scene_constants import Materials
from tissue.models.tooth.heat import Conduction

__all__ = ["PULP_LIMIT_K", "CuttingHeat"]

PULP_LIMIT_K = 5.5
"""Rise of the pulp's temperature that it may not survive (Zach and Cohen 1965)."""


class CuttingHeat:
    """Heat of cutting in a tooth's voxels.

    A share of the cutting power goes into the tooth where the bur meets it; chips and spray carry off the rest. The
    share is a prior of low confidence, and the rise is proportional to it.

    Parameters
    ----------
    tooth
        The whole tooth in coarse voxels.
    reach_m
        Radius around the tip within which the heat is spread over the solid voxels [m].
    constants
        Thermal constants of the layers.
    device
        Warp device name.
    """

    def __init__(
        self, tooth: VoxelVolume, *, reach_m: float, constants: Materials = Materials.cited, device: str = "cpu"
    ) -> None:
        conductivity, capacity = np.zeros(tooth.shape), np.ones(tooth.shape)
        for index, name in enumerate(tooth.layer_names):
            table = constants.constants("tooth", name)
            here = (tooth.layer == index) & (tooth.fraction > 127)
            conductivity[here] = table["conductivity_W_mK"].value
            capacity[here] = table["heat_capacity_J_kgK"].value * table["density_kg_m3"].value
        self._share = constants.constants("tooth", "bur")["heat_share"].value
        self._pulp = (tooth.layer == tooth.layer_names.index("pulp")) & (conductivity > 0.0)
        self._solid = np.argwhere(conductivity > 0.0)
        self._centres = tooth.origin_m + tooth.spacing_m * (self._solid + 0.5)
        self._reach = max(reach_m, tooth.spacing_m)
        self.field = Conduction(conductivity, capacity, spacing_m=tooth.spacing_m, device=device)
        self._power = np.zeros(tooth.shape)

    def advance(self, cutting_energy_J: float, duration_s: float, tip_m: NDArray[np.float64]) -> float:
        """Put the energy cut since the last call into the tooth; the pulp's highest rise [K] now."""
        self._power[:] = 0.0
        if cutting_energy_J > 0.0:
            distance = np.linalg.norm(self._centres - tip_m, axis=1)
            near = distance <= max(self._reach, float(distance.min()))
            self._power[tuple(self._solid[near].T)] = self._share * cutting_energy_J / duration_s / near.sum()
        self.field.advance(self._power, duration_s)
        return float(self.field.rise_K[self._pulp].max()) if self._pulp.any() else 0.0
