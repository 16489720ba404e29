"""The tissue in a live window: bone as it is carved, an organ's surface as it moves."""

import numpy as np
from numpy.typing import NDArray

from tissue.figures.style import layer_colours
from tissue.simulation.bone_surface import smooth_normals, with_layers
from tissue.simulation.live.shared import SharedArrays
from tissue.simulation.live.surfaces import BoneSurface, OrganSurface, Start, tissue_surface
from tissue.viewer.bone import layer_look
from tissue.viewer.plotter import Plotter

__all__ = ["LiveBone", "LiveOrgan", "live_tissue"]

Array = NDArray[np.float64]
PASSES = 4
"""Smoothing of normals: fewer than in a picture, for it is done again at every change."""
AROUND = 0.7
"""How much of what lies around the touchable surface is seen, in shares of its size."""
ORGAN = "#CC8E7D"


def live_tissue(plotter: Plotter, start: Start, arrays: SharedArrays) -> "LiveBone | LiveOrgan | None":
    """What is drawn of a tissue that `tissue.simulation.live` shares; None for one that its scene describes."""
    match tissue_surface(start, arrays):
        case BoneSurface() as bone:
            return LiveBone(plotter, bone)
        case OrganSurface() as organ:
            return LiveOrgan(plotter, organ)
    return None


class LiveBone:
    """A bone by layer as it is carved.

    Parameters
    ----------
    plotter
        Where it is shown.
    bone
        Its surface.

    Attributes
    ----------
    points_mm
        Points that have to be seen [mm], shape (n, 3).
    colours
        Of the layers that there are by name, red, green and blue, 0 to 1.
    """

    def __init__(self, plotter: Plotter, bone: BoneSurface) -> None:
        self._plotter, self._bone = plotter, bone
        names = bone.volume.layer_names
        colours, self._look = layer_colours(names), layer_look(names)
        there = [names[i] for i in np.unique(bone.volume.layer[bone.volume.fraction > 0])]
        self.colours = {name: colours[name] for name in there}
        self._draw()
        self.points_mm: Array = np.asarray(bone.surface.points, dtype=np.float64)

    def update(self) -> bool:
        """Draw the bone again if a brick has lost something."""
        changed = self._bone.update()
        if changed:
            self._draw()
        return changed

    def _draw(self) -> None:
        surface = self._bone.surface
        if not surface.n_cells:
            self._plotter.remove_actor("bone", render=False)
            return
        with_layers(surface, self._bone.volume)
        surface.point_data["Normals"] = smooth_normals(surface, passes=PASSES)
        self._plotter.add_mesh(surface, name="bone", **self._look)


class LiveOrgan:
    """The surface of a soft organ as it moves.

    Parameters
    ----------
    plotter
        Where it is shown.
    organ
        The surface.

    Attributes
    ----------
    points_mm
        Points that have to be seen [mm], shape (n, 3).
    colours
        None: it has but one.
    """

    def __init__(self, plotter: Plotter, organ: OrganSurface) -> None:
        self.colours: dict[str, tuple[float, float, float]] = {}
        self._organ = organ
        self._actor = plotter.add_mesh(
            organ.surface, color=ORGAN, smooth_shading=True, show_edges=True, edge_color="#B07365", line_width=0.5,
            specular=0.2, reset_camera=False,
        )  # fmt: skip
        patch = organ.touchable_mm
        self.points_mm: Array = patch + AROUND * (patch - patch.mean(axis=0))

    def update(self) -> bool:
        """Draw the surface where it has moved to."""
        return self._organ.update()
