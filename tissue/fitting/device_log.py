"""Logs of a haptic device: where its tip is, what its motors do, and what a hand does to it."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fitting.columns import Quantity, parse_columns
from tissue.fitting.device_windows import DeviceLog
from tissue.fitting.log_files import read_columns

__all__ = ["QUANTITIES", "read_device_log"]

TIMES, TIP, MOTORS, HAND = (
    ("time_s",),
    tuple(f"device_{c}_mm" for c in "xyz"),
    tuple(f"device_force_{c}_N" for c in "xyz"),
    tuple(f"hand_force_{c}_N" for c in "xyz"),
)
MEASURES = {"s": "time", "mm": "length", "N": "force"}
QUANTITIES = {
    name: Quantity(name, MEASURES[name.rpartition("_")[2]], name.rpartition("_")[2])
    for name in (*TIMES, *TIP, *MOTORS, *HAND)
}
"""Columns of a log of a device, as a run's trace has them, and the measured force of the hand on the tip."""


def read_device_log(path: Path, columns: Sequence[str] = (), *, held: bool) -> DeviceLog:
    """Read a log of a device.

    Parameters
    ----------
    path
        CSV, Parquet, HDF5, .mat or .npz.
    columns
        ``NAME=COLUMN[:UNIT]`` for what has another name, see `tissue.fitting.columns.parse_column`.
    held
        Whether something holds the tip, whose force on it is measured; the motors may then be off, without columns. A
        free device is moved by its motors.

    Raises
    ------
    InputError
        If a column is missing or holds what cannot be, or times do not rise at one rate.
    """
    maps, found = parse_columns(columns, QUANTITIES), read_columns(path)

    values, notes = found.taken(maps, QUANTITIES)

    def vectors(names: tuple[str, ...], *, needed: bool) -> Array | None:
        if missing := [name for name in names if name not in values]:
            if needed or len(missing) < len(names):
                raise InputError(
                    f"measured must hold {', '.join(missing)}, got {path.name} with {', '.join(found.names[:40])}: "
                    f"name the log's own columns by --column {missing[0]}=COLUMN[:UNIT]"
                )
            return None
        joined = np.column_stack([values[name] for name in names])
        if not np.isfinite(joined).all():
            raise InputError(f"measured must hold finite numbers, got one of {names[0]} that is not in {path.name}")
        return joined

    times = vectors(TIMES, needed=True)
    tip = vectors(TIP, needed=True)
    motors = vectors(MOTORS, needed=not held)
    hand = vectors(HAND, needed=held)
    assert times is not None and tip is not None
    if not held and hand is not None and hand.any():
        raise InputError(f"measured must be of a free device, got a hand's force in {path.name}: give it as --held")
    return DeviceLog(
        times[:, 0], tip, np.zeros_like(tip) if motors is None else motors, hand if held else None, tuple(notes)
    )
