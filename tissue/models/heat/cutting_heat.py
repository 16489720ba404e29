"""Temperature of bone or a tooth that a cutter mills."""

from collections.abc import Callable
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
from tissue.models.heat.conduction import Conduction, HeatGrid
from tissue.models.tissue_model import TICK_S, ToolMotion

TakeCuts = Callable[[], tuple[Ints, NDArray[np.uint16]]]
"""Function that returns the bricks (blocks of voxels) that lost material since its last call.

The function returns the row numbers of these bricks and the remaining fractions of their voxels,
65535 = full.
"""
INTERVAL_TICKS = 20
"""Number of ticks in an interval of the heat computation.

The peak temperature rise of the pulp in the molar scene is 0.695, 0.685 and 0.684 K for 5, 20 and
40 ticks. The cutting elements in contact are determined once in each interval.
"""
RECEIVES = 0.5
"""Smallest filled fraction at which a cell at the cut surface receives heat.

A cell with less material would not conduct well. With cells of 0.25 mm, the peak temperature rise
of the pulp in the molar scene is 0.59, 0.69 and 0.84 K for fractions of 0.1, 0.5 and 0.9. With
finer cells and a fraction of 0.5, the rise is larger (docs/models.md).
"""
DEPTHS = 4
"""Number of positions, half a cell apart, in the search for a cell that receives heat.

The positions lie on the surface normal, from the surface inwards. The peak temperature rise of the
pulp in the molar scene is 0.57, 0.67, 0.69 and 0.69 K for 1, 2, 4 and 8 positions.
"""


class CuttingHeat:
    """Heat of cutting in bone or a tooth.

    A share of the cutting power flows into the tissue through the surface that the tool cuts. This
    share is distributed over the surface in proportion to the power of the cutting elements. The
    rest of the power leaves with chips, spray and tool. Material that is removed later carries away
    the heat that it has received until its removal. The value of the share is uncertain, and the
    temperature rise is proportional to the share.

    Heat is computed in intervals of several ticks. `begin` receives the energy and the cuts of the
    last interval. During the next interval, `go_to` computes step by step how this energy heats the
    tissue. The temperature therefore lags by one interval. `add_tick` is called in every tick of a
    run and calls `begin` and `go_to`. `end` completes an interval.

    Parameters
    ----------
    tissue
        The whole tooth, or the bone around the tool, in voxels. Within the reach of the tool, every
        voxel is a cell of the grid.
    milling
        Model with the finer voxels that are milled, and the tool.
    reach_m
        Lowest and highest corner of the box that the tool can reach [m], shape (3,) each.
    constants
        Thermal constants of the layers.
    name
        Name of the tissue in the energy balance.
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
        tissue: VoxelVolume,
        milling: BoneModel,
        *,
        reach_m: tuple[Array, Array],
        constants: Materials = Materials.cited,
        name: str = "tooth",
        device: str = "cpu",
    ) -> None:
        self.grid = HeatGrid.of_volume(tissue, reach_m=reach_m, constants=constants)
        self.field = Conduction(self.grid, device=device)
        self.cutting_J = 0.0
        self._name = name
        self._share = constants.values("tooth", "bur")["heat_share"]
        self._cell_m = tissue.spacing_m
        self._volume_m3 = self.grid.volumes_m3.reshape(-1)
        self._conductivity = self.grid.conductivity_W_mK.reshape(-1)
        self._pulp = np.flatnonzero(self.grid.pulp & (self.grid.filled > 0.0))
        self._wall = self.grid.interpolation(self.grid.pulp_wall_m)
        self._milling = milling
        self._before = milling.store.remaining.numpy().copy()
        self._engaged = EngagedElements(milling)
        self._power = np.zeros(self.grid.filled.size)
        self._warmer_K = np.zeros(self.grid.filled.size)
        self._lost = np.zeros(self.grid.filled.size)
        self._power_W = 0.0
        self._tip_m = np.zeros(3)
        self._earlier = self._later = np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
        self._steps = self._done = 0
        self._energy_J = 0.0
        self._ticks = 0
        self._motion: ToolMotion | None = None

    @property
    def pulp_rise_K(self) -> float:
        """Highest temperature rise of the remaining pulp, inside it or at the pulp wall [K]."""
        rise = self.field.rise_K.reshape(-1)
        is_held = self.field.filled.reshape(-1) > 0.0
        # Empty cells have zero rise, and their weight is missing at the cut surface.
        weight = self._wall @ is_held
        is_wall = weight > 0.5
        wall = (self._wall @ rise)[is_wall] / weight[is_wall]
        return max(float(wall.max(initial=0.0)), float(rise[self._pulp].max(initial=0.0)))

    @property
    def cut_points_m(self) -> Array:
        """Points where the tool cut at the end of the last interval [m], shape (n, 3)."""
        points, _, powers = self._later
        return points[powers > 0.0]

    @property
    def balance_J(self) -> dict[str, float]:
        """Energy of cutting, and the three energies into which it is divided [J].

        The three energies are in chips and spray, in removed material, and in the remaining tissue.
        """
        return {
            "cutting": self.cutting_J,
            "with_chips_and_spray": (1.0 - self._share) * self.cutting_J,
            f"with_removed_{self._name}": self.field.removed_J,
            f"left_in_{self._name}": self.field.stored_J,
        }

    def add_tick(self, wrench: Array, motion: ToolMotion, take_cuts: TakeCuts) -> bool:
        """Add the cutting energy of a tick, and continue the heat computation of the interval.

        Parameters
        ----------
        wrench
            Force [N] and torque about the tip [N m] on the tool in the tick, shape (6,).
        motion
            Pose and motion of the tool, the same object in every tick.
        take_cuts
            Function that returns the bricks that lost material since its last call. It is called
            when the interval ends.

        Returns
        -------
        True if the interval ended. `field` then has the temperature at the end of the interval.
        """
        self._motion = motion
        force = wrench[:3]
        torque = wrench[3:]
        spun = abs(float(torque.dot(motion.rotation[:, 2])) * self._milling.cutter.spin_rad_s)
        moved, turned = motion.heading
        fed = -motion.speed_m_s * float(force.dot(moved) + torque.dot(turned))
        # If the tissue pulls the tool in its feed direction, no heat flows back.
        self._energy_J += (spun + max(fed, 0.0)) * TICK_S
        self._ticks += 1
        if self._ticks < INTERVAL_TICKS:
            self.go_to(self._ticks / INTERVAL_TICKS)
            return False
        return self.end(take_cuts)

    def end(self, take_cuts: TakeCuts) -> bool:
        """Complete the present interval, and begin the next interval with the new energy and cuts.

        If no tick was added since the last interval, do nothing and return False. Otherwise return
        True.
        """
        if self._motion is None or self._ticks == 0:
            return False
        self.finish()
        self.begin(self._energy_J, self._ticks * TICK_S, self._motion, take_cuts())
        self._energy_J = 0.0
        self._ticks = 0
        return True

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
            Length of the last interval [s].
        motion
            Pose and motion of the tool at the end of the last interval.
        cut
            Rows, in the brick store, of the bricks (blocks of voxels) that lost material, and the
            remaining fractions of the voxels in these bricks, 65535 = full.
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
        """Run the time steps up to a share (0 to 1) of the interval.

        The cut material is removed in the middle of the interval.
        """
        until = ceil(share * self._steps)
        while self._done < until:
            # In the middle, because the tool cuts during the whole interval.
            if self._done == self._steps // 2:
                self._remove()
            self.field.step()
            self._done += 1

    def finish(self) -> None:
        """Complete the interval."""
        self.go_to(1.0)

    def _lost_fraction(self, rows: Ints, left: NDArray[np.uint16]) -> Array:
        """Return the fraction of each cell that was cut since the last call, as a flat array."""
        store = self._milling.store
        steps = self._before[rows].astype(np.int64) - left
        self._before[rows] = left
        voxels, lost = voxels_of(store.places, rows, steps)
        size = store.grid.spacing_m
        corners = store.grid.origin_m + size * voxels
        volumes_m3 = lost.astype(np.float64) * (size**3 / FULL)
        return self.grid.distribute(corners, size, volumes_m3) / self._volume_m3

    def _deposit(self, points_m: Array, normals: Array, weights: Array, tip_m: Array) -> None:
        """Set the heat power of the cells at the cut surface, and store the excess temperature.

        The excess temperature is the temperature of the cut surface minus the temperature of the
        heated cell.

        Parameters
        ----------
        points_m, normals, weights
            Points where the tool cuts [m], normals out of the tool at these points, and relative
            powers of the points.
        tip_m
            Tip of the tool [m]. If there are no points, the heat goes into the filled cell nearest
            to the tip.
        """
        power = self._power
        warmer = self._warmer_K
        filled = self.field.filled.reshape(-1)
        power[:] = 0.0
        warmer[:] = 0.0
        # No element is engaged at this pose, but the tool had power in the interval.
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
            # A tool that is at rest at the end of an interval has no power there. Its heat is
            # spread over the whole contact area.
            shares = weights / total if total > 0.0 else np.full(len(weights), 1.0 / len(weights))
            power += np.bincount(cells, self._power_W * shares, minlength=len(power))
            # Half the temperature difference across the material of the cell, for a flux through
            # all of this material.
            warmer[cells] = (
                0.5 * power[cells] * filled[cells] / (self._conductivity[cells] * self._cell_m)
            )
            np.maximum.at(warmer, candidates[0], warmer[cells])
        self.field.heat(power)

    def _remove(self) -> None:
        """Remove the cut material from the cells.

        For the rest of the interval, the heat enters at the last position of the tool.
        """
        cells = np.flatnonzero(self._lost)
        if len(cells):
            self.field.remove(cells, self._lost[cells], self._warmer_K[cells])
        self._deposit(*(self._later if len(self._later[0]) else self._earlier), self._tip_m)

    def _nearest(self, point_m: Array) -> int:
        """Return the flat index of the filled cell nearest to a point."""
        cells = np.argwhere(self.field.filled > 0.0)
        centres = np.column_stack(
            [
                0.5 * (edges[at] + edges[at + 1])
                for edges, at in zip(self.grid.edges_m, cells.T, strict=True)
            ]
        )
        nearest = cells[np.linalg.norm(centres - point_m, axis=1).argmin()]
        return int(np.ravel_multi_index(tuple(nearest), self.field.filled.shape))
