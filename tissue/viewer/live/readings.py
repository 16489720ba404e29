"""What a person reads off the newest row that a live window was sent: the load, what is removed, how late it is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Readings"]

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Readings:
    """One row of the trace and of the clock.

    Attributes
    ----------
    time_s
        Simulated time [s].
    tip_mm, turn
        Tip of the tool [mm] and its orientation (x, y, z, w).
    force_N, torque_Nm
        What the tissue does to the tool [N], [N m], shape (3,) each.
    device_N
        Size of the force that the device plays [N], None without one.
    removed_mm3
        Volume that was removed [mm³].
    tick_us, late_us
        How long the tick took and how late it began [µs].
    missed
        How many ticks were not done within 1 ms of when they were due.
    skipped_ms
        What the clock on the wall has skipped [ms].
    """

    time_s: float
    tip_mm: Array
    turn: Array
    force_N: Array
    torque_Nm: Array
    device_N: float | None
    removed_mm3: float
    tick_us: float
    late_us: float
    missed: float
    skipped_ms: float

    @classmethod
    def of(cls, row: Array, places: dict[str, int]) -> "Readings":
        """Read a row with columns at ``places``: those of the trace, then `tissue.simulation.live.window.CLOCK`."""

        def vector(name: str, unit: str) -> Array:
            return row[[places[f"{name}_{c}_{unit}"] for c in "xyz"]]

        one = lambda name: float(row[places[name]])  # noqa: E731
        plays = "device_force_x_N" in places
        return cls(
            time_s=one("time_s"),
            tip_mm=vector("tool", "mm"),
            turn=row[[places[f"tool_q{c}"] for c in "xyzw"]],
            force_N=vector("model_force", "N"),
            torque_Nm=vector("model_torque", "Nm"),
            device_N=float(np.linalg.norm(vector("device_force", "N"))) if plays else None,
            removed_mm3=one("removed_mm3"),
            tick_us=one("tick_us"),
            late_us=one("late_us"),
            missed=one("missed"),
            skipped_ms=one("skipped_ms"),
        )
