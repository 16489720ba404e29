"""Temperature in a tooth that a bur warms."""

from math import ceil
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.conduction import conduct
from kernels.launcher import SplitLaunch

__all__ = ["Conduction"]

SAFETY = 0.9
"""Share of the longest stable step that is used."""


class Conduction:
    """Heat conduction over a grid of cubic cells, explicit in time. Outer faces and empty cells are insulated.

    Parameters
    ----------
    conductivity_W_mK
        Thermal conductivity of every cell [W/(m K)], 0 where there is no material, shape (nx, ny, nz).
    heat_capacity_J_m3K
        Volumetric heat capacity [J/(m3 K)], positive, same shape.
    spacing_m
        Edge of a cell [m].
    device
        Warp device name.

    Attributes
    ----------
    peak_K
        Highest temperature rise that every cell has had [K], same shape.
    """

    def __init__(
        self,
        conductivity_W_mK: NDArray[np.float64],
        heat_capacity_J_m3K: NDArray[np.float64],
        *,
        spacing_m: float,
        device: str = "cpu",
    ) -> None:
        diffusivity = float((conductivity_W_mK / heat_capacity_J_m3K).max())
        self.longest_step_s = SAFETY * spacing_m**2 / (6.0 * diffusivity)
        self._shape = conductivity_W_mK.shape
        self._step_s = 0.0
        self._spacing, self._device = spacing_m, device
        self._conductivity: Any = wp.array(conductivity_W_mK, dtype=wp.float32, device=device)
        self._capacity: Any = wp.array(heat_capacity_J_m3K, dtype=wp.float32, device=device)
        self._power = wp.zeros(self._shape, dtype=wp.float32, device=device)
        self._temperature = [wp.zeros(self._shape, dtype=wp.float32, device=device) for _ in range(2)]
        self._launches: list[SplitLaunch] = []
        self.peak_K = np.zeros(self._shape, dtype=np.float32)

    @property
    def rise_K(self) -> NDArray[np.float32]:
        """Temperature rise of every cell [K], shape (nx, ny, nz)."""
        return np.asarray(self._temperature[0].numpy())

    def advance(self, power_W: NDArray[np.float64], duration_s: float) -> None:
        """Put heat into the cells, shape (nx, ny, nz) [W], for a while, in as many stable steps as that takes."""
        steps = max(ceil(duration_s / self.longest_step_s - 1e-9), 1)
        self._record(duration_s / steps)
        self._power.assign(power_W.astype(np.float32))
        for _ in range(steps):
            self._launches[0]()
            self._temperature.reverse()
            self._launches.reverse()
        np.maximum(self.peak_K, self.rise_K, out=self.peak_K)

    def _record(self, step_s: float) -> None:
        """Record the two launches, there and back, for a step length."""
        if step_s == self._step_s:
            return
        self._step_s = step_s
        planes = self._shape[0]
        self._launches = [
            SplitLaunch(
                conduct,
                dim=self._shape,
                inputs=[source, self._conductivity, self._capacity, self._power, step_s, self._spacing, 0],
                outputs=[target],
                offset_index=6,
                device=self._device,
                cores=min(planes, 4),
            )
            for source, target in (self._temperature, self._temperature[::-1])
        ]
