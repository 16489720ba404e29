"""Heat conduction in a tooth whose material is removed while it warms."""

from math import ceil
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.conduction import OPEN, conduct
from kernels.launcher import SplitLaunch
from meshes.base.arrays import Array
from tissue.models.tooth.heat_grid import HeatGrid

__all__ = ["Conduction"]

SAFETY = 0.9
"""Share of the longest stable step that is used."""
LEAST_FILLED = 0.02
"""A cell that is left with less material is emptied: its heat capacity no longer matters."""


class Conduction:
    """Heat conduction over partly filled cells, explicit in time. All surfaces are insulated.

    Parameters
    ----------
    grid
        The cells and their material.
    device
        Warp device name.

    Attributes
    ----------
    filled
        Fraction of each cell that still holds material, shape of the grid.
    removed_J
        Heat that left with removed material so far, relative to the temperature at the start [J].
    """

    def __init__(self, grid: HeatGrid, *, device: str = "cpu") -> None:
        shape = grid.filled.shape
        self.grid, self._device = grid, device
        self.filled = grid.filled.copy()
        self.removed_J = 0.0
        self._capacity_J_K = grid.heat_capacity_J_m3K * grid.volumes_m3
        along = grid.conductances_W_K()
        self.longest_step_s = SAFETY * self._stable_step_s(along)

        def on_device(values: Array) -> Any:
            return wp.array(values.astype(np.float32), dtype=wp.float32, device=device)

        self._along, self._capacity = [on_device(each) for each in along], on_device(self._capacity_J_K)
        self._filled, self._power = on_device(self.filled), on_device(np.zeros(shape))
        self._temperature = [on_device(np.zeros(shape)) for _ in range(2)]
        self._launches: list[SplitLaunch] = []
        self._step_s = 0.0

    def _stable_step_s(self, along: tuple[Array, ...]) -> float:
        """Longest stable step of any filling: a face of a cell conducts at most `OPEN` times its filled fraction."""
        total = np.zeros(self.grid.filled.shape)
        for axis, each in enumerate(along):
            total += each
            np.moveaxis(total, axis, 0)[1:] += np.moveaxis(each, axis, 0)[:-1]
        held = self.grid.filled > 0.0
        return float((self._capacity_J_K[held] / np.maximum(total[held], 1e-30)).min()) / float(OPEN)

    @property
    def rise_K(self) -> NDArray[np.float32]:
        """Temperature rise of every cell [K], shape of the grid, 0 in an empty one."""
        return np.asarray(self._temperature[0].numpy())

    @property
    def stored_J(self) -> float:
        """Heat in the material that is left, relative to the temperature at the start [J]."""
        return float((self.rise_K * self.filled * self._capacity_J_K).sum())

    def heat(self, power_W: Array) -> None:
        """Set the heat that goes into the cells from now on [W], shape of the grid or flat."""
        self._power.assign(power_W.reshape(self.filled.shape).astype(np.float32))

    def plan(self, duration_s: float) -> int:
        """Divide a duration into stable steps of one length, and return how many they are."""
        steps = max(ceil(duration_s / self.longest_step_s - 1e-9), 1)
        self._record(duration_s / steps)
        return steps

    def step(self) -> None:
        """Run one of the planned steps."""
        self._launches[0]()
        self._temperature.reverse()
        self._launches.reverse()

    def advance(self, power_W: Array, duration_s: float) -> None:
        """Put heat into the cells, shape of the grid [W], for a while."""
        self.heat(power_W)
        for _ in range(self.plan(duration_s)):
            self.step()

    def remove(self, cells: NDArray[np.intp], lost: Array, warmer_K: Array) -> None:
        """Take material out of cells with the heat that it holds.

        Parameters
        ----------
        cells
            Flat indices of the cells, each once, shape (n,).
        lost
            Fraction of each cell that is removed, shape (n,).
        warmer_K
            How much warmer than the mean of its cell the removed material is [K], shape (n,); no more heat leaves than
            the cell holds.
        """
        rise = self.rise_K.reshape(-1)
        filled, capacity = self.filled.reshape(-1), self._capacity_J_K.reshape(-1)[cells]
        before, warm = filled[cells], rise[cells].astype(np.float64)
        left = np.maximum(before - lost, 0.0)
        left[left < LEAST_FILLED] = 0.0
        held_J = before * capacity * warm
        gone_J = np.where(left > 0.0, (before - left) * capacity * (warm + warmer_K), held_J)
        gone_J = np.minimum(gone_J, np.maximum(held_J, 0.0))
        self.removed_J += float(gone_J.sum())
        rise[cells] = np.where(left > 0.0, (held_J - gone_J) / np.maximum(left * capacity, 1e-30), 0.0)
        filled[cells] = left
        self._temperature[0].assign(rise.reshape(self.filled.shape))
        self._filled.assign(self.filled.astype(np.float32))

    def _record(self, step_s: float) -> None:
        """Record the two launches, there and back, for a step length."""
        if step_s == self._step_s:
            return
        self._step_s = step_s
        self._launches = [
            SplitLaunch(
                conduct,
                dim=self.filled.shape,
                inputs=[source, self._filled, *self._along, self._capacity, self._power, step_s, 0],
                outputs=[target],
                offset_index=8,
                device=self._device,
                cores=min(self.filled.shape[0], 4),
            )
            for source, target in (self._temperature, self._temperature[::-1])
        ]
