"""The bone in the window of `tissue view`: by layer or by removed depth, its layers switched on
and off.
"""

from typing import TYPE_CHECKING

import numpy as np

from tissue.show.figures.figure import BONE, layer_colours
from tissue.show.viewer.plotter import Plotter, add_colour_scale
from tissue.show.viewer.saved_surfaces import BoneOverTime

if TYPE_CHECKING:
    import pyvista

__all__ = ["BoneShown", "layer_look"]

DEPTH = "removed_depth_mm"
DEPTH_TITLE = "removed depth / mm"
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
    """Return the options with which a plotter shows a surface by layer."""
    from matplotlib.colors import ListedColormap

    colours = ListedColormap(list(layer_colours(names).values()))
    limits = (-0.5, len(names) - 0.5)
    return {"scalars": "layer", "preference": "cell", "cmap": colours, "clim": limits, **SHADING}


class BoneShown:
    """Bone in a plotter.

    Parameters
    ----------
    plotter
        Plotter of the bone. The key c is bound in it.
    bone
        The bone over time.
    legend
        If true, a legend of the layers and their colours is shown.

    Attributes
    ----------
    layers
        Layers that can be switched, by name.
    help
        Description of its key. Empty without a key.
    points_mm
        Points of its surface when it was made [mm], shape (n, 3).
    colours
        Colours of all layers by name, red, green and blue, 0 to 1.
    by_depth
        True if the bone is coloured by removed depth, not by layer.
    is_cut
        True if any bone was removed.
    """

    def __init__(self, plotter: Plotter, bone: BoneOverTime, *, legend: bool = True) -> None:
        self._plotter = plotter
        self._bone = bone
        self._legend = legend
        names = bone.layer_names
        self._names = names
        self.colours = layer_colours(names)
        self._index = {names[i]: i for i in bone.layers}
        self.layers = list(self._index)
        self._hidden: frozenset[str] = frozenset()
        self._limit = max(bone.deepest_mm, 1e-3)
        self.is_cut = bone.deepest_mm > 0.0
        self.by_depth = self.is_cut
        self._visible = True
        self.help = "c: removed depth or layer" if self.is_cut else ""
        if self.is_cut:
            plotter.add_key_event("c", self.change)
        self._parts: dict[str, pyvista.PolyData] = {}
        self._take()
        self.points_mm = np.vstack([np.asarray(part.points) for part in self._parts.values()])
        self._draw()

    def at(self, tick: int) -> None:
        """Show the bone at the end of a tick."""
        if self._bone.at(tick):
            self._take(rest=False)
            if self._visible:
                self._draw_part("bone")

    def _take(self, *, rest: bool = True) -> None:
        """Update the surfaces of the shown layers, and the remaining surface if requested."""
        shown = [index for name, index in self._index.items() if name not in self._hidden]
        self._parts["bone"] = self._bone.cut(shown)
        if rest:
            self._parts["bone beyond the cut"] = self._bone.rest(shown)

    def change(self) -> None:
        """Change between removed depth and layer."""
        self.by_depth = not self.by_depth
        self._draw()
        self._plotter.render()

    def hide(self, hidden: frozenset[str]) -> None:
        """Leave out some layers, and colour the bone by layer."""
        self._hidden = hidden
        self.by_depth = False
        self._take()
        self._draw()

    def show(self, visible: bool) -> None:
        """Show the bone or hide it."""
        self._visible = visible
        self._draw()

    def _draw(self) -> None:
        """Bring all that is shown up to date."""
        plotter = self._plotter
        plotter.remove_legend(render=False)
        if DEPTH_TITLE in plotter.scalar_bars:
            plotter.remove_scalar_bar(DEPTH_TITLE, render=False)
        actors = [self._draw_part(name) for name in self._parts]
        shown = [actor for actor in actors if actor is not None]
        if self.by_depth and shown:
            add_colour_scale(
                plotter, DEPTH_TITLE, shown[0].mapper, bottom=0.45, fmt="%.2f", below_label=""
            )
        elif self._visible and self._legend and not self.by_depth:
            # Layers and their colours; one that is off is pale.
            entries = [
                [name, "lightgray" if name in self._hidden else self.colours[name]]
                for name in self.layers
            ]
            plotter.add_legend(
                entries,
                bcolor=None,
                face="rectangle",
                size=(0.14, 0.03 * len(entries) + 0.01),
                loc="upper right",
            )

    def _draw_part(self, name: str) -> "pyvista.Actor | None":
        """Draw one of the surfaces again; return its actor, or None if there is nothing to show."""
        self._plotter.remove_actor(name, reset_camera=False, render=False)
        part = self._parts[name].copy(deep=False)
        if not self._visible or not part.n_cells:
            return None
        if not self.by_depth:
            return self._plotter.add_mesh(part, name=name, **layer_look(self._names))
        limits = (0.02 * self._limit, self._limit)
        return self._plotter.add_mesh(
            part, name=name, scalars=DEPTH, cmap="viridis", clim=limits, below_color=BONE, **SHADING
        )
