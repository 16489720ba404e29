"""Voxels that a cutter cuts in many episodes: made once, restored by copying."""

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array, Flags, Ints, Singles
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.materials.scene_constants import Materials
from tissue.models.bone.bricks import voxels_of
from tissue.scene.used_constants import used_of_cutting
from tissue.simulation.builders.bone import VoxelBone
from tissue.simulation.builders.own_constants import given_note

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
        self.volume = volume
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

    def voxels(self, layer: str) -> tuple[Ints, Array]:
        """Return full voxels of a layer before any cut.

        They are indices into the flat array of stored voxels, and centres [m].
        """
        store = self.model.store
        full = self._uncut.bricks["remaining"].numpy() == np.iinfo(np.uint16).max
        chosen = full & (self._layer == store.grid.layer_names.index(layer))
        places, _ = voxels_of(store.places, np.arange(len(chosen)), chosen.astype(np.int64))
        return np.flatnonzero(chosen), store.grid.origin_m + store.grid.spacing_m * (places + 0.5)

    def left(self, at: Ints) -> Flags:
        """Return whether voxels are at least half full, by their indices in the flat array."""
        stored = self.model.store.remaining.numpy().reshape(-1)
        return np.asarray(stored[at] > np.iinfo(np.uint16).max // 2)

    def patch(self, centre_m: Array, spacing_m: float) -> Singles:
        """Return the share of bone at points around a centre, shape (9, 9, 9), from 0 to 1.

        The axes are along x, y and z.
        """
        side = spacing_m * (np.arange(PATCH_POINTS) - PATCH_POINTS // 2)
        points = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
        found = self.model.store.sample(centre_m + points).reshape((PATCH_POINTS,) * 3)
        return np.clip(found, 0.0, 1.0, dtype=np.float32)

    def draw_section(
        self, panel: "Axes", across: int, at_m: float, colours: tuple[str, ...]
    ) -> None:
        """Draw the layers of the remaining bone in the plane across an axis [m]."""
        from matplotlib.colors import ListedColormap

        volume = self.volume
        place = int((at_m - volume.origin_m[across]) / volume.spacing_m)
        place = min(max(place, 0), volume.shape[across] - 1)
        left = np.take(self.model.remaining(), place, axis=across) > 127
        shown = np.where(left, np.take(volume.layer, place, axis=across).astype(np.int64), -1)
        first, second = (axis for axis in range(3) if axis != across)
        low = 1e3 * volume.origin_m
        high = low + 1e3 * volume.spacing_m * np.array(volume.shape)
        panel.imshow(
            shown.T,
            origin="lower",
            extent=(low[first], high[first], low[second], high[second]),
            cmap=ListedColormap(["#FFFFFF", *colours]),
            vmin=-1.5,
            vmax=len(colours) - 0.5,
        )
        panel.set_xlabel(f"{'xyz'[first]} / mm")
        panel.set_ylabel(f"{'xyz'[second]} / mm")

    def draw_under_tool(self, panel: "Axes", tip_m: Array, colours: tuple[str, ...]) -> None:
        """Draw a section along x under the tool, and the outline of its ball."""
        from matplotlib.patches import Circle

        self.draw_section(panel, 1, tip_m[1], colours)
        x, _, z = 1e3 * tip_m
        radius = 1e3 * self.model.cutter.profile.radius_m
        panel.add_patch(Circle((x, z + radius), radius, fill=False, color="0.2"))
