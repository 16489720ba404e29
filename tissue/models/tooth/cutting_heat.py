"""Temperature of a tooth and its pulp under a bur."""

from math import ceil

import numpy as np
from numpy.typing import NDArray

from kernels.bricks import FULL
from meshes.base.arrays import Array, Ints
from meshes.voxels.volume import VoxelVolume
from tissue.materials.scene_constants import Materials
from tissue.models.bone.bricks import voxels_of
from tissue.models.bone.engagement import EngagedElements
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion
from tissue.models.tooth.heat import Conduction, HeatGrid

__all__ = ["PULP_LIMIT_K", "CuttingHeat"]

PULP_LIMIT_K = 5.5
"""Temperature rise that the pulp may not survive [K] (Zach and Cohen 1965)."""
RECEIVES = 0.5
"""Smallest fill of a surface cell that receives heat; an emptier cell would not conduct well.

The peak of the pulp in the molar scene is 0.52, 0.61 and 0.76 K for 0.1, 0.5 and 0.9 with cells of
0.25 mm. With finer cells it is 0.73 and 0.75 K for 0.5 (docs/models.md).
"""
DEPTHS = 4
"""Number of half cells inward from the surface in the search for the cell that receives the heat.

The peak of the pulp in the molar scene is 0.50, 0.60, 0.61 and 0.61 K for 1, 2, 4 and 8.
"""


class CuttingHeat:
    """Heat of cutting in a tooth whose material the bur removes.

    A share of the cutting power flows into the tooth through the surface that the bur cuts, in
    proportion to the power of its elements there. The rest leaves with chips, spray and bur.
    Material that is removed later takes along the heat that has reached it by then. The share is a
    prior of low confidence; the temperature rise is proportional to it.

    The heat is computed in intervals. `begin` takes energy and cuts of the last interval. `go_to`
    spreads the time steps over the next interval, so that no tick runs them all. The temperature
    lags by one interval.

    Parameters
    ----------
    tooth
        The whole tooth in voxels, which are the cells in the reach of the bur.
    milling
        The finer voxels and the bur.
    reach_m
        Lowest and highest corner of the box that the bur can reach [m], shape (3,) each.
    constants
        Thermal constants of the layers.
    device
        Warp device name.

    Attributes
    ----------
    field
        Temperature and material of the cells.
    cutting_J
        Energy of cutting so far [J].
    """

    def __init__(
        self,
        tooth: VoxelVolume,
        milling: BoneModel,
        *,
        reach_m: tuple[Array, Array],
        constants: Materials = Materials.cited,
        device: str = "cpu",
    ) -> None:
        self.grid = HeatGrid.of_tooth(tooth, reach_m=reach_m, constants=constants)
        self.field = Conduction(self.grid, device=device)
        self.cutting_J = 0.0
        self._share = constants.constants("tooth", "bur")["heat_share"].value
        self._cell_m = tooth.spacing_m
        self._volume_m3 = self.grid.volumes_m3.reshape(-1)
        self._conductivity = self.grid.conductivity_W_mK.reshape(-1)
        self._pulp = np.flatnonzero(self.grid.pulp & (self.grid.filled > 0.0))
        self._wall = self.grid.pulp_wall()
        self._milling = milling
        self._before = milling.store.remaining.numpy().copy()
        self._engaged = EngagedElements(milling, device=device)
        self._power = np.zeros(self.grid.filled.size)
        self._warmer_K = np.zeros(self.grid.filled.size)
        self._lost = np.zeros(self.grid.filled.size)
        self._power_W = 0.0
        self._tip_m = np.zeros(3)
        self._earlier = self._later = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        self._steps = self._done = 0

    @property
    def pulp_rise_K(self) -> float:
        """Highest temperature rise of the remaining pulp, at its wall or inside [K]."""
        rise = self.field.rise_K.reshape(-1)
        filled = self.field.filled.reshape(-1)
        inner, outer, weights = self._wall
        there = (filled[inner] > 0.0) & (filled[outer] > 0.0)
        wall = weights * rise[inner] + (1.0 - weights) * rise[outer]
        return max(float(wall[there].max(initial=0.0)), float(rise[self._pulp].max(initial=0.0)))

    @property
    def balance_J(self) -> dict[str, float]:
        """Energy of cutting and its distribution [J].

        It is divided into chips and spray, removed material, and the remaining tooth.
        """
        return {
            "cutting": self.cutting_J,
            "with_chips_and_spray": (1.0 - self._share) * self.cutting_J,
            "with_removed_tooth": self.field.removed_J,
            "left_in_tooth": self.field.stored_J,
        }

    def begin(
        self,
        cutting_J: float,
        duration_s: float,
        motion: ToolMotion,
        cut: tuple[Ints, NDArray[np.uint16]],
    ) -> None:
        """Begin an interval with the energy and cuts of the last interval.

        Parameters
        ----------
        cutting_J
            Energy of cutting in the last interval [J].
        duration_s
            Its length [s].
        motion
            Pose and motion of the bur at its end.
        cut
            Bricks of the finer voxels that lost material, and their remaining fraction in steps.
        """
        self.finish()
        self.cutting_J += cutting_J
        self._lost[:] = self._lost_fraction(*cut)
        self._power_W = self._share * cutting_J / duration_s
        self._earlier = self._later
        self._later = self._engaged.cutting(motion)
        self._tip_m = motion.tip_m.copy()
        self._deposit(*(self._earlier if len(self._earlier[0]) else self._later), self._tip_m)
        self._steps = self.field.plan(duration_s)
        self._done = 0

    def go_to(self, share: float) -> None:
        """Run the steps up to a share of the interval; cut material is removed at its middle."""
        until = ceil(share * self._steps)
        while self._done < until:
            # The middle: cuts happen all through the interval.
            if self._done == self._steps // 2:
                self._remove()
            self.field.step()
            self._done += 1

    def finish(self) -> None:
        """Complete the interval."""
        self.go_to(1.0)

    def _lost_fraction(self, rows: Ints, left: NDArray[np.uint16]) -> Array:
        """Return the fraction of each cell that was cut since the last interval, flat."""
        store = self._milling.store
        steps = self._before[rows].astype(np.int64) - left
        self._before[rows] = left
        voxels, lost = voxels_of(store.places, rows, steps)
        size = store.grid.spacing_m
        corners = store.grid.origin_m + size * voxels
        volumes_m3 = lost.astype(np.float64) * (size**3 / FULL)
        return self.grid.share_out(corners, size, volumes_m3) / self._volume_m3

    def _deposit(self, points_m: Array, normals: Array, weights: Array, tip_m: Array) -> None:
        """Add the power to the cells at the surface, and store the surface's excess temperature.

        The excess is the temperature of the surface minus the temperature of its cell.

        Parameters
        ----------
        points_m, normals, weights
            Points where the bur cuts [m], its normals out of the bur, and the relative powers
            there.
        tip_m
            Tip of a bur that has left the tooth since the last cut: the heat goes into the cell
            next to it [m].
        """
        power = self._power
        warmer = self._warmer_K
        filled = self.field.filled.reshape(-1)
        power[:] = 0.0
        warmer[:] = 0.0
        # The bur has no engaged element at this pose, but had power in the interval.
        if self._power_W > 0.0 and len(points_m) == 0:
            power[self._nearest(tip_m)] = self._power_W
        elif self._power_W > 0.0:
            depths = 0.5 * self._cell_m * np.arange(DEPTHS)
            candidates = np.stack(
                [self.grid.cells_at(points_m + depth * normals) for depth in depths]
            )
            fills = filled[candidates]
            is_full = fills >= RECEIVES
            first = np.where(is_full.any(axis=0), is_full.argmax(axis=0), fills.argmax(axis=0))
            cells = candidates[first, np.arange(len(points_m))]
            for at in np.flatnonzero(filled[cells] <= 0.0):
                cells[at] = self._nearest(points_m[at])
            total = float(weights.sum())
            # A bur that stands at the end of an interval has no power there: its heat enters along
            # its whole contact area.
            shares = weights / total if total > 0.0 else np.full(len(weights), 1.0 / len(weights))
            power += np.bincount(cells, self._power_W * shares, minlength=len(power))
            # Half the temperature difference across the material of the cell, for a flux that
            # passes all of it.
            warmer[cells] = (
                0.5 * power[cells] * filled[cells] / (self._conductivity[cells] * self._cell_m)
            )
            np.maximum.at(warmer, candidates[0], warmer[cells])
        self.field.heat(power)

    def _remove(self) -> None:
        """Remove the cut material from the cells.

        From then on the heat enters at the final position of the bur.
        """
        cells = np.flatnonzero(self._lost)
        if len(cells):
            self.field.remove(cells, self._lost[cells], self._warmer_K[cells])
        self._deposit(*(self._later if len(self._later[0]) else self._earlier), self._tip_m)

    def _nearest(self, point_m: Array) -> int:
        """Return the filled cell nearest to a point, flat index."""
        cells = np.argwhere(self.field.filled > 0.0)
        centres = np.column_stack(
            [
                0.5 * (edges[at] + edges[at + 1])
                for edges, at in zip(self.grid.edges_m, cells.T, strict=True)
            ]
        )
        nearest = cells[np.linalg.norm(centres - point_m, axis=1).argmin()]
        return int(np.ravel_multi_index(tuple(nearest), self.field.filled.shape))
