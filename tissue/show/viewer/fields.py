"""Tissue in the window of `tissue view`: deformed mesh with fields, and bone."""

from typing import TYPE_CHECKING

import numpy as np

from tissue.show.figures.figure import (
    BONE,
    DEPTH_COLOURS,
    field_colours,
    field_words,
    layer_colours,
)
from tissue.show.figures.organ_surface import SHOWN as DRAWN
from tissue.show.figures.organ_surface import at_nodes, drawn_surface
from tissue.show.viewer.plotter import Plotter, add_colour_scale, add_text
from tissue.show.viewer.saved_surfaces import BoneOverTime, Plane
from tissue.simulation.saved_fields import SavedFields, field_values

if TYPE_CHECKING:
    import pyvista

TETRAHEDRON = 10
"""VTK's number of the cell type tetrahedron."""
AMBIENT = 0.78
DIFFUSE = 0.25
"""Diffuse light on a mesh that is coloured by a field.

The light is weak. It shows the shape, but the colours still match the colour scale.
"""
SHOWN = "shown"
"""Name of the array that is drawn."""


class FieldsShown:
    """Mesh with time-dependent fields, drawn in a plotter once `show` has been called.

    Parameters
    ----------
    plotter
        Plotter of the fields.
    fields
        Fields to show.
    scale
        Factor by which the displacement is multiplied.
    clip
        Plane at which the mesh is cut open, or None.
    fine
        If true, an uncut tetrahedral mesh is drawn with smooth shading, as needed for a still
        picture.

    Attributes
    ----------
    name
        Name of the shown field, or None.
    actor
        Actor of the drawn mesh in the plotter, or None.
    """

    def __init__(
        self,
        plotter: Plotter,
        fields: SavedFields,
        *,
        scale: float = 1.0,
        clip: Plane | None = None,
        fine: bool = False,
    ) -> None:
        self._plotter = plotter
        self._fields = fields
        self._fine = fine
        self.scale = scale
        self.clip = clip
        self._time_s = 0.0
        self._hidden: frozenset[str] = frozenset()
        self.name: str | None = None
        self.actor: pyvista.Actor | None = None
        self._title = ""
        self._last: tuple[object, ...] | None = None

    def show(self, name: str | None) -> None:
        """Show a field; hide the fields if the name is None."""
        self.name = name
        self._draw()

    def at(self, time_s: float) -> None:
        """Show the fields at a time."""
        self._time_s = time_s
        self._draw()

    def enlarge(self, scale: float) -> None:
        """Set the factor of the drawn displacement."""
        self.scale = scale
        self._draw()

    def cut(self, clip: Plane | None) -> None:
        """Cut the mesh open at a plane; show it whole if the plane is None."""
        self.clip = clip
        self._draw()

    def hide(self, hidden: frozenset[str]) -> None:
        """Hide the cells of some layers."""
        self._hidden = hidden
        self._draw()

    def _draw(self) -> None:
        mesh, shown_s = self._fields.at(self._time_s)
        key = (self.name, self.scale, self.clip, self._hidden, shown_s)
        # the same picture: many moments of playback lie between two frames
        if key == self._last:
            return
        self._last = key
        self._plotter.remove_actor("field", reset_camera=False, render=False)
        if self._title in self._plotter.scalar_bars:
            self._plotter.remove_scalar_bar(self._title, render=False)
        self.actor = None
        if self.name is not None:
            self._add(mesh, shown_s, self.name)

    def _part(self, mesh: "pyvista.DataSet") -> "pyvista.DataSet":
        """Return the deformed mesh without hidden layers, cut at the clip plane."""
        import pyvista

        names = self._fields.layer_names
        keep = [index for index, name in enumerate(names) if name not in self._hidden]
        if len(keep) < len(names):
            mesh = mesh.extract_cells(
                np.flatnonzero(np.isin(mesh.cell_data["layer"], keep)).tolist()
            )
        if not mesh.n_cells:
            return mesh
        moved = mesh.copy(deep=False)
        place = np.asarray(mesh.points) + np.float32(self.scale) * self._fields.moved_mm(mesh)
        # to set them through .points would move the frame too
        moved.SetPoints(pyvista.vtk_points(place, deep=True))
        if self.clip is not None:
            normal, origin = self.clip
            moved = moved.clip(normal=normal, origin=origin)
        return moved

    def _add(self, mesh: "pyvista.DataSet", shown_s: float, name: str) -> None:
        # a frame may not have the field
        if field_values(mesh, name) is None:
            return
        part = self._part(mesh)
        if not part.n_cells:
            return
        in_cells = name in part.cell_data
        # only the whole boundary of tetrahedra can be drawn without facets, see `drawn_surface`
        smooth = (
            self._fine and self.clip is None and set(np.unique(part.celltypes)) == {TETRAHEDRON}
        )
        if smooth:
            part = drawn_surface(part, at_nodes(part, name))
            in_cells = False
            part.rename_array(DRAWN, name)
        (part.cell_data if in_cells else part.point_data)[SHOWN] = np.asarray(
            field_values(part, name)
        )
        low, high = self._fields.limits(name)
        self.actor = self._plotter.add_mesh(
            part,
            scalars=SHOWN,
            preference="cell" if in_cells else "point",
            cmap=field_colours(low, high),
            clim=(low, high),
            log_scale=low > 0.0,
            name="field",
            ambient=AMBIENT,
            diffuse=DIFFUSE,
            interpolation="Phong" if smooth else "Flat",
            show_scalar_bar=False,
            reset_camera=False,
            render=False,
        )
        self._title = f"{field_words(name)}\nat {shown_s:.3f} s"
        # the reader must know that a displacement is enlarged
        if self.scale != 1.0 and self._fields.displacement is not None:
            self._title += f"\ndrawn × {self.scale:.3g}"
        add_colour_scale(self._plotter, self._title, self.actor.mapper, bottom=0.42, fmt="%.2g")


DEPTH = "removed_depth_mm"
DEPTH_TITLE = "removed depth / mm"
UNCUT = "not cut"
SHADING = {
    "smooth_shading": False,
    "interpolation": "Phong",
    "ambient": 0.15,
    "specular": 0.1,
    "show_scalar_bar": False,
    "reset_camera": False,
    "render": False,
}


def layer_look(names: tuple[str, ...]) -> dict[str, object]:
    """Return the options with which a plotter colours a surface by layer."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap(list(layer_colours(names).values()))
    # each layer's index lies in the middle of its colour
    limits = (-0.5, len(names) - 0.5)
    return {"scalars": "layer", "preference": "cell", "cmap": colours, "clim": limits, **SHADING}


class BoneShown:
    """Bone in a plotter.

    Parameters
    ----------
    plotter
        Plotter that draws the bone. If bone was removed, the keyboard key c switches between
        colours by layer and colours by removed depth.
    bone
        Bone over time.
    legend
        If true, a legend shows the layers and their colours.

    Attributes
    ----------
    layers
        Names of the layers that can be hidden.
    help
        Help text for the keyboard key c; empty if the key does nothing.
    points_mm
        Points of the initial surface [mm], shape (n, 3).
    colours
        Colours of all layers (red, green and blue, 0 to 1), keyed by name.
    by_depth
        True if the bone is coloured by removed depth, not by layer.
    is_cut
        True if any bone was removed.
    """

    def __init__(self, plotter: Plotter, bone: BoneOverTime, *, legend: bool = True) -> None:
        self._plotter = plotter
        self._bone = bone
        self._legend = legend
        names = self._names = bone.layer_names
        self.colours = layer_colours(names)
        self._index = {names[i]: i for i in bone.layers}
        self.layers = list(self._index)
        self._hidden: frozenset[str] = frozenset()
        # a colour scale needs a range
        self._limit = max(bone.deepest_mm, 1e-3)
        self.is_cut = bone.deepest_mm > 0.0
        self.by_depth = self.is_cut
        self._visible = True
        self.help = "c: removed depth or layer" if self.is_cut else ""
        if self.is_cut:
            plotter.add_key_event("c", self.change)
        parts = bone.cut(bone.layers), bone.rest(bone.layers)
        self.points_mm = np.vstack([np.asarray(part.points) for part in parts])
        self._draw()

    def at(self, tick: int) -> None:
        """Show the bone as it is at the end of a tick."""
        # the bone beyond the cut is the same at all ticks
        if self._bone.at(tick):
            self._draw_part("bone")

    def change(self) -> None:
        """Switch between colours for removed depth and for layers."""
        self.by_depth = not self.by_depth
        self._draw()
        self._plotter.render()

    def hide(self, hidden: frozenset[str]) -> None:
        """Hide the given layers, and colour the visible bone by layer."""
        self._hidden = hidden
        self.by_depth = False
        self._draw()

    def show(self, visible: bool) -> None:
        """Show or hide the bone."""
        self._visible = visible
        self._draw()

    def _draw(self) -> None:
        """Draw all surfaces, the legend and the scale again."""
        plotter = self._plotter
        plotter.remove_legend(render=False)
        plotter.remove_actor(UNCUT, render=False)
        if DEPTH_TITLE in plotter.scalar_bars:
            plotter.remove_scalar_bar(DEPTH_TITLE, render=False)
        actors = [self._draw_part(name) for name in ("bone", "bone beyond the cut")]
        shown = [actor for actor in actors if actor is not None]
        if self.by_depth and shown:
            # above the chart and the sliders; the legend takes its place if layers are shown
            add_colour_scale(
                plotter, DEPTH_TITLE, shown[0].mapper, bottom=0.45, fmt="%.2f", below_label=""
            )
            # VTK would write the label of the lowest field over this field
            add_text(plotter, UNCUT, (0.9, 0.456), size=11, name=UNCUT)
        elif self._visible and self._legend and not self.by_depth:
            # The legend shows the layers and their colours; a hidden layer is pale.
            entries = [
                [name, "lightgray" if name in self._hidden else self.colours[name]]
                for name in self.layers
            ]
            plotter.add_legend(
                entries,
                bcolor=None,
                face="rectangle",
                # shares of the window: 0.03 a line
                size=(0.14, 0.03 * len(entries) + 0.01),
                loc="upper right",
            )

    def _draw_part(self, name: str) -> "pyvista.Actor | None":
        """Draw one of the surfaces again; return its actor, or None if the surface is empty."""
        self._plotter.remove_actor(name, reset_camera=False, render=False)
        if not self._visible:
            return None
        shown = [index for each, index in self._index.items() if each not in self._hidden]
        part = self._bone.cut(shown) if name == "bone" else self._bone.rest(shown)
        if not part.n_cells:
            return None
        look = layer_look(self._names)
        if self.by_depth:
            # bone that lost less than 2 % of the deepest cut has the colour of bone
            limits = (0.02 * self._limit, self._limit)
            look = {"scalars": DEPTH, "cmap": DEPTH_COLOURS, "clim": limits, **SHADING}
            look["below_color"] = BONE
        return self._plotter.add_mesh(part, name=name, **look)
