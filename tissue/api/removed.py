"""What tools have taken away from a bone."""

from typing import TYPE_CHECKING, Any

from tissue.builders.bone import VoxelBone

if TYPE_CHECKING:
    import pyvista

__all__ = ["Removed"]


class Removed:
    """What tools have taken away from a bone, as it is when it is asked."""

    def __init__(self, bone: VoxelBone) -> None:
        self._bone = bone

    @property
    def by_layer_mm3(self) -> dict[str, float]:
        """Volume taken from each layer [mm3]."""
        volumes = 1e9 * self._bone.removed_m3
        return dict(zip(self._bone.store.grid.layer_names, volumes.tolist(), strict=True))

    @property
    def volume_mm3(self) -> float:
        """Volume taken from all layers [mm3]."""
        return sum(self.by_layer_mm3.values())

    def surface(self) -> "pyvista.PolyData":
        """Surface of what was taken away [mm], with the cell array ``layer``; empty before the first cut."""
        from tissue.api.bone_surface import removed_surface

        return removed_surface(self._bone)

    def plot(self, **options: Any) -> Any:
        """Show what was taken away, by layer; `options` are those of ``pyvista.PolyData.plot``."""
        from tissue.api.bone_surface import plot_surface

        return plot_surface(self.surface(), self._bone.store.grid.layer_names, **options)

    def __repr__(self) -> str:
        parts = ", ".join(f"{volume:.4g} mm3 of {name}" for name, volume in self.by_layer_mm3.items())
        return f"Removed({parts})"
