"""The bone in the window of `tissue view`: by layer or by removed depth, its layers switched on and off."""

from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.volume import VoxelVolume
from tissue.pictures import BONE, layer_colours
from tissue.surface import bone_surface, smooth_normals, with_layers

if TYPE_CHECKING:
    import pyvista

__all__ = ["BoneShown", "read_voxels", "surface_of_layers"]

DEPTH, DEPTH_TITLE = "removed_depth_mm", "removed depth / mm"
SHADING: dict[str, Any] = {
    "smooth_shading": False,
    "interpolation": "Phong",
    "ambient": 0.15,
    "specular": 0.1,
    "show_scalar_bar": False,
    "reset_camera": False,
}


def read_voxels(file: Path) -> VoxelVolume | None:
    """Voxels of a run's ``bone.vti``, filled as far as the run left them; None without the file."""
    if not file.is_file():
        return None
    import pyvista

    image: Any = pyvista.read(file)
    shape = tuple(np.array(image.dimensions) - 1)
    left, layer, density = (
        np.ascontiguousarray(image.cell_data[name].reshape(shape, order="F"))
        for name in ("remaining", "layer", "density_kg_m3")
    )
    names = tuple(str(name) for name in image.field_data["layer_names"])
    return VoxelVolume(1e-3 * np.array(image.origin), 1e-3 * float(image.spacing[0]), left, layer, density, names)


def surface_of_layers(
    surface: "pyvista.PolyData", voxels: VoxelVolume | None, shown: Collection[int]
) -> "pyvista.PolyData":
    """Surface of some of the bone's layers: what lay under those left out comes to light.

    Without voxels it is the part of the bone's own surface that belongs to the layers.

    Parameters
    ----------
    surface
        Surface of the whole bone [mm] with the cell array ``layer``.
    voxels
        The bone, as full as it is left.
    shown
        Layers to show.
    """
    import pyvista

    if set(np.unique(surface.cell_data["layer"]).tolist()) <= set(shown) and voxels is None:
        return surface
    if voxels is None:
        keep = np.isin(surface.cell_data["layer"], list(shown))
        part = pyvista.PolyData.from_regular_faces(surface.points, surface.regular_faces[keep])
        for name, values in surface.point_data.items():
            part.point_data[name] = values
        part.cell_data["layer"] = surface.cell_data["layer"][keep]
        return part
    from scipy.spatial import cKDTree

    part = bone_surface(voxels, np.where(np.isin(voxels.layer, list(shown)), voxels.fraction, np.uint8(0)))
    if not part.n_cells:
        return part
    with_layers(part, voxels)
    part.point_data["Normals"] = smooth_normals(part)
    if DEPTH in surface.point_data:
        # What was laid bare is still the same face; all else was inside.
        far, near = cKDTree(surface.points).query(part.points, distance_upper_bound=1e3 * voxels.spacing_m)
        depth = np.append(surface.point_data[DEPTH], 0.0)
        part.point_data[DEPTH] = np.where(np.isfinite(far), depth[near], 0.0).astype(np.float32)
    return part


class BoneShown:
    """The bone in a plotter.

    Parameters
    ----------
    plotter
        Where it is shown; the key c is bound there.
    surface
        Its surface [mm] with cell array ``layer``, field ``layer_names`` and perhaps point array ``removed_depth_mm``.
    voxels
        The bone, as full as it is left, for what lies under a layer; may be None.

    Attributes
    ----------
    layers
        Layers that can be switched, by name.
    help
        Its key, in words; empty where it has none.
    """

    def __init__(self, plotter: Any, surface: "pyvista.PolyData", voxels: VoxelVolume | None) -> None:
        self._plotter, self._whole, self._voxels = plotter, surface, voxels
        surface.point_data["Normals"] = smooth_normals(surface)
        names = tuple(str(name) for name in surface.field_data["layer_names"])
        self._names, self._colours = names, layer_colours(names)
        present = np.unique(surface.cell_data["layer"])
        if voxels is not None:
            present = np.unique(voxels.layer[voxels.fraction > 0])
        self._index = {names[int(i)]: int(i) for i in present}
        self.layers = list(self._index)
        self._hidden: frozenset[str] = frozenset()
        self._deep = DEPTH in surface.point_data
        self._limit = float(max(surface.point_data[DEPTH].max(), 1e-3)) if self._deep else 0.0
        self._by_depth, self._visible = self._deep, True
        self.help = "c: removed depth or layer" if self._deep else ""
        if self._deep:
            plotter.add_key_event("c", self.change)
        self._part = surface
        self._draw()

    def change(self) -> None:
        """Change between removed depth and layer."""
        self._by_depth = not self._by_depth
        self._draw()
        self._plotter.render()

    def hide(self, hidden: frozenset[str]) -> None:
        """Leave out some layers, and colour the bone by layer."""
        self._hidden = hidden
        self._by_depth = False
        shown = [index for name, index in self._index.items() if name not in self._hidden]
        self._part = surface_of_layers(self._whole, self._voxels, shown) if self._hidden else self._whole
        self._draw()

    def show(self, visible: bool) -> None:
        """Show the bone or hide it."""
        self._visible = visible
        self._draw()

    def _draw(self) -> None:
        """Bring what is shown up to date."""
        from matplotlib.colors import ListedColormap

        plotter = self._plotter
        plotter.remove_actor("bone", reset_camera=False, render=False)
        plotter.remove_legend(render=False)
        if DEPTH_TITLE in plotter.scalar_bars:
            plotter.remove_scalar_bar(DEPTH_TITLE, render=False)
        if not self._visible:
            return
        part = self._part.copy(deep=False)
        if self._by_depth and part.n_cells:
            actor = plotter.add_mesh(
                part,
                scalars=DEPTH,
                cmap="viridis",
                clim=(0.02 * self._limit, self._limit),
                below_color=BONE,
                name="bone",
                render=False,
                **SHADING,
            )
            self._add_bar(actor)
        elif part.n_cells:
            plotter.add_mesh(
                part,
                scalars="layer",
                preference="cell",
                cmap=ListedColormap([self._colours[name] for name in self._names]),
                clim=(-0.5, len(self._names) - 0.5),
                name="bone",
                render=False,
                **SHADING,
            )
        if not self._by_depth:
            self._add_legend()

    def _add_bar(self, actor: Any) -> None:
        self._plotter.add_scalar_bar(
            DEPTH_TITLE,
            mapper=actor.mapper,
            vertical=True,
            position_x=0.87,
            position_y=0.45,
            height=0.42,
            width=0.07,
            color="black",
            fmt="%.2f",
            title_font_size=24,
            label_font_size=24,
            below_label="",
            render=False,
        )

    def _add_legend(self) -> None:
        """Layers and their colours; one that is off is pale."""
        entries = [[name, "lightgray" if name in self._hidden else self._colours[name]] for name in self.layers]
        self._plotter.add_legend(
            entries,
            bcolor=None,
            face="rectangle",
            size=(0.14, 0.03 * len(entries) + 0.01),
            loc="upper right",
        )
