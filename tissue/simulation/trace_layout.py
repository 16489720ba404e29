"""Columns of the trace: their names, and where each quantity lies in a row."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["TraceLayout", "load_columns"]


@dataclass(frozen=True)
class TraceLayout:
    """Where each quantity lies in a row of the trace; the fields are in the order of the columns.

    Attributes
    ----------
    columns
        Names of all columns; each carries its unit.
    time, removal_rate, removed, contact, layer
        Place of one column.
    tip, quaternion, velocity, spin
        Pose of the tool and its rates.
    commanded, wrench
        Force, then torque, as played and as the model gave them.
    removed_by_layer, measures
        One column a layer, and what the tissue and the motion measure.
    """

    columns: tuple[str, ...]
    time: int
    tip: slice
    quaternion: slice
    velocity: slice
    spin: slice
    commanded: slice
    wrench: slice
    removal_rate: int
    removed: int
    removed_by_layer: slice
    contact: int
    measures: slice
    layer: int

    @classmethod
    def of(cls, layer_names: tuple[str, ...], measure_names: tuple[str, ...] = ()) -> "TraceLayout":
        """Layout for these layers and measures."""
        groups: dict[str, str | tuple[str, ...]] = {
            "time": "time_s",
            "tip": tuple(f"tool_{c}_mm" for c in "xyz"),
            "quaternion": tuple(f"tool_q{c}" for c in "xyzw"),
            "velocity": tuple(f"velocity_{c}_mm_s" for c in "xyz"),
            "spin": tuple(f"angular_velocity_{c}_rad_s" for c in "xyz"),
            "commanded": (*(f"force_{c}_N" for c in "xyz"), *(f"torque_{c}_Nm" for c in "xyz")),
            "wrench": (*(f"model_force_{c}_N" for c in "xyz"), *(f"model_torque_{c}_Nm" for c in "xyz")),
            "removal_rate": "removal_rate_mm3_s",
            "removed": "removed_mm3",
            "removed_by_layer": tuple(f"removed_{name}_mm3" for name in layer_names),
            "contact": "contact_mm2",
            "measures": measure_names,
            "layer": "layer",
        }
        columns: list[str] = []
        places: dict[str, Any] = {}
        for field, names in groups.items():
            start = len(columns)
            columns += [names] if isinstance(names, str) else names
            places[field] = start if isinstance(names, str) else slice(start, len(columns))
        return cls(tuple(columns), **places)


def load_columns(columns: tuple[str, ...]) -> NDArray[np.intp]:
    """Places of the forces and torques among the columns of a trace."""
    return np.array([place for place, name in enumerate(columns) if name.endswith(("_N", "_Nm"))], dtype=np.intp)
