"""The tissue in a live window: bone as it is carved, an organ's surface as it moves."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from kernels.bricks import BRICK
from meshes.voxels.volume import VoxelVolume
from tissue.figures.style import layer_colours
from tissue.simulation.bone_surface import bone_surface, smooth_normals, with_layers
from tissue.simulation.live.shared import SharedArrays
from tissue.viewer.bone import layer_look
from tissue.viewer.plotter import Plotter

__all__ = ["LiveBone", "LiveOrgan", "live_tissue"]

Array = NDArray[np.float64]
Start = Mapping[str, NDArray[np.generic]]
PASSES = 4
"""Smoothing of normals: fewer than in a picture, for it is done again at every change."""
FADES_MM = 20.0
"""Distance over which the drawn displacement fades beyond the nodes whose displacement is known."""
AROUND = 0.7
"""How much of what lies around the touchable surface is seen, in shares of its size."""
ORGAN = "#CC8E7D"


def live_tissue(plotter: Plotter, start: Start, arrays: SharedArrays) -> "LiveBone | LiveOrgan | None":
    """What is drawn of a tissue that `tissue.simulation.live` shares; None for one that its scene describes."""
    kind = LiveBone if "remaining" in arrays else LiveOrgan if "moved" in arrays else None
    return None if kind is None else kind(plotter, start, arrays)


class LiveBone:
    """A bone by layer, in blocks of some voxels, from the bricks that the ticks carve.

    Parameters
    ----------
    plotter
        Where it is shown.
    start, arrays
        As `tissue.simulation.live.tissues.BoneShared` shares them.

    Attributes
    ----------
    points_mm
        Points that have to be seen [mm], shape (n, 3).
    colours
        Of the layers that there are by name, red, green and blue, 0 to 1.
    """

    def __init__(self, plotter: Plotter, start: Start, arrays: SharedArrays) -> None:
        self._plotter, self._remaining = plotter, arrays["remaining"]
        self._places, self._block = start["places"].astype(np.intp), int(start["block"])
        self._seen = self._remaining.copy()
        layer, names = start["layer"].astype(np.uint8), tuple(str(name) for name in start["layer_names"])
        spacing = self._block * float(start["spacing_m"])
        self._fraction = np.zeros(layer.shape, dtype=np.uint8)
        density = np.zeros(layer.shape, dtype=np.uint16)
        self._volume = VoxelVolume(start["origin_m"].astype(np.float64), spacing, self._fraction, layer, density, names)
        colours, self._look = layer_colours(names), layer_look(names)
        self._fill(np.arange(len(self._places)))
        there = [names[i] for i in np.unique(layer[self._fraction > 0])]
        self.colours = {name: colours[name] for name in there}
        self._draw()
        self.points_mm: Array = np.asarray(self._surface.points, dtype=np.float64)

    def update(self) -> bool:
        """Draw the bone again if a brick has lost something."""
        now = self._remaining.copy()
        rows = np.flatnonzero((now != self._seen).any(axis=1))
        if not rows.size:
            return False
        self._seen[rows] = now[rows]
        self._fill(rows)
        self._draw()
        return True

    def _fill(self, rows: NDArray[np.intp]) -> None:
        """Bring the blocks of some bricks up to date."""
        block, count = self._block, BRICK // self._block
        bricks = self._seen[rows].reshape(-1, 4, 4, 4, 2, 2, 2).transpose(0, 1, 4, 2, 5, 3, 6)
        parts = bricks.reshape(-1, count, block, count, block, count, block)
        means = np.rint(parts.mean(axis=(2, 4, 6)) / 257.0).astype(np.uint8)
        offsets = np.arange(count)
        x, y, z = count * self._places[rows].T[:, :, None] + offsets
        self._fraction[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]] = means

    def _draw(self) -> None:
        self._surface = bone_surface(self._volume, self._fraction)
        if not self._surface.n_cells:
            self._plotter.remove_actor("bone", render=False)
            return
        with_layers(self._surface, self._volume)
        self._surface.point_data["Normals"] = smooth_normals(self._surface, passes=PASSES)
        self._plotter.add_mesh(self._surface, name="bone", **self._look)


class LiveOrgan:
    """The surface of a soft organ, displaced where it is known to be, and less and less beyond.

    Parameters
    ----------
    plotter
        Where it is shown.
    start, arrays
        As `tissue.simulation.live.tissues.OrganShared` shares them.

    Attributes
    ----------
    points_mm
        Points that have to be seen [mm], shape (n, 3).
    colours
        None: it has but one.
    """

    def __init__(self, plotter: Plotter, start: Start, arrays: SharedArrays) -> None:
        import pyvista

        self.colours: dict[str, tuple[float, float, float]] = {}
        self._arrays, self._turn = arrays, 0
        cells, nodes = start["cells"], 1e3 * start["nodes_m"].astype(np.float64)
        grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells[:, :4]}, nodes)
        surface = grid.extract_surface(algorithm="dataset_surface")
        ids = np.asarray(surface.point_data["vtkOriginalPointIds"])
        place = np.full(len(nodes), -1)
        place[start["touchable"]] = np.arange(len(start["touchable"]))
        self._row = place[ids]  # of each shown point among the touchable nodes, -1 for none
        self._rest = np.array(surface.points, dtype=np.float64)
        self._surface = surface
        self._known: NDArray[np.bool_] | None = None
        self._nearest, self._share = np.zeros(0, dtype=np.intp), np.zeros(0)
        surface.clear_data()
        self._actor = plotter.add_mesh(
            surface, color=ORGAN, smooth_shading=True, show_edges=True, edge_color="#B07365", line_width=0.5,
            specular=0.2, reset_camera=False,
        )  # fmt: skip
        patch = self._rest[self._row >= 0]
        self.points_mm: Array = patch + AROUND * (patch - patch.mean(axis=0))

    def update(self) -> bool:
        """Draw the surface where it has moved to."""
        message = self._arrays.read("moved")
        if message is None or message[0] == self._turn:
            return False
        self._turn, moved = message
        known = (self._row >= 0) & np.isfinite(moved).all(axis=1)[self._row]
        if self._known is None or (known != self._known).any():
            self._spread(known)
        if not known.any():
            return False
        of_known = 1e3 * moved[self._row[known]].astype(np.float64)
        self._surface.points = self._rest + self._share[:, None] * of_known[self._nearest]
        return True

    def _spread(self, known: NDArray[np.bool_]) -> None:
        """Of every point the nearest one that is known, and what share of its displacement is drawn."""
        from scipy.spatial import cKDTree

        self._known = known
        if known.any():
            away, self._nearest = cKDTree(self._rest[known]).query(self._rest)
            self._share = np.exp(-away / FADES_MM)
