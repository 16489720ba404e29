"""Voxels that a cutter cuts in many episodes: made once, restored by copying."""

from collections.abc import Mapping
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.materials.scene_constants import Materials
from tissue.models.bone.bricks import voxels_of
from tissue.scene.used_constants import used_of_cutting
from tissue.simulation.builders.arguments import given_note
from tissue.simulation.builders.bone import VoxelBone

__all__ = ["PATCH_POINTS", "RestorableBone"]

PATCH_POINTS = 9
"""Number of points along each side of a patch."""
LAYER_BITS = 255


class RestorableBone:
    """Voxels under one cutter that `restore` resets to the uncut state.

    Parameters
    ----------
    volume
        Voxels with layers.
    cutter
        The tool.
    shell_spacing_m
        Distance between the cutter's elements [m].
    materials
        File of constants in place of the cited ones; None for the cited ones.

    Attributes
    ----------
    model
        The bone under the cutter.
    """

    def __init__(
        self,
        volume: VoxelVolume,
        cutter: Cutter,
        *,
        shell_spacing_m: float,
        materials: str | PathLike[str] | None = None,
    ) -> None:
        given = Materials.of(materials)
        layers = volume.layer_names
        used = used_of_cutting(given, layers, bone="bone", stated={}, has_reference_density=False)
        given_note(given, used, layers=layers, by="environment")
        # The material applies to layers without their own coefficients. Environments run in
        # parallel, so each uses one core.
        bone = VoxelBone(volume, given.coefficients(layers, {}, bone="bone"))
        self.model = bone.model(cutter, shell_spacing_m=shell_spacing_m, cores=1)
        self._uncut = self.model.carver.state()
        self._material = self.model.store.material.numpy()
        self._layer = self._material & LAYER_BITS

    def restore(self, density_kg_m3: Mapping[str, float]) -> None:
        """Restore the uncut bone, and set another density of some layers [kg/m3]."""
        store = self.model.store
        self.model.carver.restore(self._uncut)
        self.model.removed_steps[:] = 0
        store.touched.zero_()
        density = self._material >> 16
        for name, value in density_kg_m3.items():
            density[self._layer == store.grid.layer_names.index(name)] = round(value)
        np.copyto(self._material, density << 16 | self._layer)

    def removed_mm3(self, layer: str) -> float:
        """Return the volume removed from a layer so far [mm3]."""
        return 1e9 * float(self.model.removed_m3[self.model.layer_names.index(layer)])

    def voxels(self, layer: str) -> tuple[NDArray[np.intp], Array]:
        """Return full voxels of a layer before any cut.

        They are indices into the flat array of stored voxels, and centres [m].
        """
        store = self.model.store
        full = self._uncut.remaining.numpy() == np.iinfo(np.uint16).max
        chosen = full & (self._layer == store.grid.layer_names.index(layer))
        places, _ = voxels_of(store.places, np.arange(len(chosen)), chosen.astype(np.int64))
        return np.flatnonzero(chosen), store.grid.origin_m + store.grid.spacing_m * (places + 0.5)

    def left(self, at: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return whether voxels are at least half full, by their indices in the flat array."""
        stored = self.model.store.remaining.numpy().reshape(-1)
        return np.asarray(stored[at] > np.iinfo(np.uint16).max // 2)

    def patch(self, centre_m: Array, spacing_m: float) -> NDArray[np.float32]:
        """Return the share of bone at points around a centre, shape (9, 9, 9), from 0 to 1.

        The axes are along x, y and z.
        """
        side = spacing_m * (np.arange(PATCH_POINTS) - PATCH_POINTS // 2)
        points = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
        found = self.model.store.sample(centre_m + points).reshape((PATCH_POINTS,) * 3)
        return np.clip(found, 0.0, 1.0, dtype=np.float32)
