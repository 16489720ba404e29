"""Surfaces of a tissue simulated in another process, from the arrays that its ticks share."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kernels.bricks import BRICK
from meshes.voxels.volume import VoxelVolume
from tissue.simulation.bone_surface import bone_surface
from tissue.simulation.live.shared import SharedArrays

if TYPE_CHECKING:
    import pyvista

__all__ = ["FADES_MM", "BoneSurface", "OrganSurface", "Start", "tissue_surface"]

Array = NDArray[np.float64]
Start = Mapping[str, NDArray[np.generic]]
FADES_MM = 20.0
"""Distance over which the displacement fades beyond the nodes whose displacement is known."""


def tissue_surface(start: Start, arrays: SharedArrays) -> "BoneSurface | OrganSurface | None":
    """Return the surface of a shared tissue; None for a tissue that its scene describes."""
    kind = BoneSurface if "remaining" in arrays else OrganSurface if "moved" in arrays else None
    return None if kind is None else kind(start, arrays)


class BoneSurface:
    """Surface of a bone in blocks of voxels, from the bricks that the ticks carve.

    Parameters
    ----------
    start, arrays
        Values shared by `tissue.simulation.live.shared.BoneShared`.

    Attributes
    ----------
    surface
        The surface [mm], with normals; it has no cells if no bone is left.
    volume
        The blocks; their filling follows the bone.
    """

    def __init__(self, start: Start, arrays: SharedArrays) -> None:
        self._remaining = arrays["remaining"]
        self._places = start["places"].astype(np.intp)
        self._block = int(start["block"])
        self._seen = self._remaining.copy()
        layer = start["layer"].astype(np.uint8)
        names = tuple(str(name) for name in start["layer_names"])
        spacing = self._block * float(start["spacing_m"])
        self._fraction = np.zeros(layer.shape, dtype=np.uint8)
        density = np.zeros(layer.shape, dtype=np.uint16)
        self.volume = VoxelVolume(
            start["origin_m"].astype(np.float64), spacing, self._fraction, layer, density, names
        )
        self._fill(np.arange(len(self._places)))
        self.surface: pyvista.PolyData = bone_surface(self.volume, self._fraction)

    def update(self) -> bool:
        """Update the surface; return whether any brick has changed."""
        now = self._remaining.copy()
        rows = np.flatnonzero((now != self._seen).any(axis=1))
        if not rows.size:
            return False
        self._seen[rows] = now[rows]
        self._fill(rows)
        self.surface = bone_surface(self.volume, self._fraction)
        return True

    def _fill(self, rows: NDArray[np.intp]) -> None:
        """Update the blocks of some bricks."""
        block = self._block
        count = BRICK // self._block
        bricks = self._seen[rows].reshape(-1, 4, 4, 4, 2, 2, 2).transpose(0, 1, 4, 2, 5, 3, 6)
        parts = bricks.reshape(-1, count, block, count, block, count, block)
        means = np.rint(parts.mean(axis=(2, 4, 6)) / 257.0).astype(np.uint8)
        offsets = np.arange(count)
        x, y, z = count * self._places[rows].T[:, :, None] + offsets
        self._fraction[x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]] = means


class OrganSurface:
    """Surface of a soft organ, displaced where its displacement is known.

    The displacement fades with the distance from there.

    Parameters
    ----------
    start, arrays
        Values shared by `tissue.simulation.live.shared.OrganShared`.

    Attributes
    ----------
    surface
        The surface [mm]; its points move.
    touchable_mm
        Touchable points of the surface, at rest [mm], shape (n, 3).
    """

    def __init__(self, start: Start, arrays: SharedArrays) -> None:
        import pyvista

        self._arrays = arrays
        self._turn = 0
        cells = start["cells"]
        nodes = 1e3 * start["nodes_m"].astype(np.float64)
        grid = pyvista.UnstructuredGrid({pyvista.CellType.TETRA: cells[:, :4]}, nodes)
        self.surface = grid.extract_surface(algorithm="dataset_surface")
        ids = np.asarray(self.surface.point_data["vtkOriginalPointIds"])
        place = np.full(len(nodes), -1)
        place[start["touchable"]] = np.arange(len(start["touchable"]))
        self._row = place[ids]  # index of each shown point among the touchable nodes, -1 for others
        self._rest = np.array(self.surface.points, dtype=np.float64)
        self.surface.clear_data()
        self._known: NDArray[np.bool_] | None = None
        self._nearest = np.zeros(0, dtype=np.intp)
        self._share = np.zeros(0)
        self.touchable_mm: Array = self._rest[self._row >= 0]

    def update(self) -> bool:
        """Update the surface; return whether it has moved."""
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
        self.surface.points = self._rest + self._share[:, None] * of_known[self._nearest]
        return True

    def _spread(self, known: NDArray[np.bool_]) -> None:
        """Find each point's nearest known point and its share of that point's displacement."""
        from scipy.spatial import cKDTree

        self._known = known
        if known.any():
            away, self._nearest = cKDTree(self._rest[known]).query(self._rest)
            self._share = np.exp(-away / FADES_MM)
