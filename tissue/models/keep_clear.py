"""How far the tool is from structures that it must not touch: a distance of each at every tick, breaches as events."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import inf

import numpy as np
import warp as wp
from numpy.typing import NDArray

from kernels.clearance import clearance
from kernels.elements import CHUNK, Elements
from kernels.launcher import SplitLaunch
from kernels.mirror import Mirror
from meshes.base.arrays import Array
from tissue.models.tissue_model import TICK_S, ToolMotion

__all__ = ["Distance", "DistanceField", "KeepClear"]

Distance = Callable[[NDArray[np.float64]], NDArray[np.floating]]
"""Points [m], shape (n, 3), to their signed distance [m], shape (n,), negative inside."""


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance from a structure on a lattice, interpolated between its points.

    Attributes
    ----------
    origin_m
        First point of the lattice [m], shape (3,).
    spacing_m
        Distance between its points [m].
    values_m
        Distance, negative inside the structure [m], shape (nx, ny, nz), float32.
    """

    origin_m: Array
    spacing_m: float
    values_m: NDArray[np.float32]


@dataclass
class _Breach:
    """A structure and what the tool has done to it."""

    name: str
    least_m: float = inf
    deepest_m: float = 0.0
    began_tick: int = -1
    deepest_now_m: float = 0.0
    ticks: int = 0
    first_tick: int = -1


class KeepClear:
    """Distance of a tool's whole body from each of some structures.

    The body is that of the cutter as it is simulated, peg, flank and back included; a shaft behind it is not.

    Parameters
    ----------
    points_m
        Points of the tool's body in its own frame [m], shape (n, 3).
    fields
        Structures by name.
    distances
        Their signed distances anywhere, for pictures.
    device
        Warp device name.

    Attributes
    ----------
    points_m, distances
        As given.
    names
        Columns of a trace: ``distance_NAME_mm``, negative inside.
    measures
        Their values of the last tick, shape (structures,).
    notices
        What has happened, a sentence each; the loop takes them out as it logs them.
    """

    def __init__(
        self,
        points_m: Array,
        fields: Mapping[str, DistanceField],
        distances: Mapping[str, Distance] | None = None,
        *,
        device: str,
    ) -> None:
        self.points_m, self.distances = points_m, dict(distances or {})
        self.names = tuple(f"distance_{name}_mm" for name in fields)
        self.measures, self.notices = np.zeros(len(fields)), list[str]()
        self._breaches = [_Breach(name) for name in fields]
        self._tick = 0
        elements = Elements()
        elements.point = wp.array(points_m, dtype=wp.vec3, device=device)
        chunks = -(-len(points_m) // CHUNK)
        self._structures = []
        for field in fields.values():
            motion = Mirror((4, 3), dtype=wp.float64, device=device)
            least = Mirror(chunks, dtype=wp.float32, device=device)
            launch = SplitLaunch(
                clearance,
                dim=chunks,
                inputs=[
                    elements,
                    motion.device,
                    field.spacing_m,
                    0,
                    wp.array(field.values_m, dtype=wp.float32, device=device),
                ],
                outputs=[least.device],
                offset_index=3,
                device=device,
                cores=1,
            )
            # The kernel's voxel has its value at the centre.
            first = field.origin_m - 0.5 * field.spacing_m
            self._structures.append((first, field.spacing_m, motion, motion.host[0], motion.host[1:4], launch, least))

    def measure(self, tool: ToolMotion, *, placed: bool = False) -> None:
        """Measure at a tool's pose; `placed` before the first tick."""
        for number, (first, spacing, motion, tip, axes, launch, least) in enumerate(self._structures):
            np.subtract(tool.tip_m, first, out=tip)
            tip /= spacing
            axes[:] = tool.rotation.T
            motion.push()
            launch()
            least.pull()
            distance_m = float(np.minimum.reduce(least.host))
            self.measures[number] = 1e3 * distance_m
            if not placed:
                self._follow(self._breaches[number], distance_m)
        self._tick += 0 if placed else 1

    def _follow(self, breach: _Breach, distance_m: float) -> None:
        """Note where a structure is entered and left."""
        breach.least_m = min(breach.least_m, distance_m)
        if distance_m < 0.0:
            breach.ticks += 1
            if breach.began_tick < 0:
                breach.began_tick, breach.deepest_now_m = self._tick, 0.0
                breach.first_tick = self._tick if breach.first_tick < 0 else breach.first_tick
                self.notices.append(f"breached {breach.name}, which is to be kept clear of")
            breach.deepest_now_m = max(breach.deepest_now_m, -distance_m)
            breach.deepest_m = max(breach.deepest_m, -distance_m)
        elif breach.began_tick >= 0:
            self._leave(breach, "left")

    def _leave(self, breach: _Breach, how: str) -> None:
        lasted = (self._tick - breach.began_tick) * TICK_S
        self.notices.append(f"{how} {breach.name}: {1e3 * breach.deepest_now_m:.2f} mm deep, {lasted:.3g} s long")
        breach.began_tick = -1

    def finish(self) -> None:
        """End breaches that last to the end."""
        for breach in self._breaches:
            if breach.began_tick >= 0:
                self._leave(breach, "still in")

    def summary(self) -> dict[str, dict[str, float | None]]:
        """Least distance [mm], depth [mm], duration [s] and first time [s] of a breach, by structure."""
        return {
            breach.name: {
                "least_distance_mm": 1e3 * breach.least_m,
                "breach_depth_mm": 1e3 * breach.deepest_m,
                "breach_s": breach.ticks * TICK_S,
                "first_breach_s": breach.first_tick * TICK_S if breach.first_tick >= 0 else None,
            }
            for breach in self._breaches
            if breach.least_m < inf
        }
