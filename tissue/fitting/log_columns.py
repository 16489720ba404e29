"""Quantities of a log from the columns of its file: names, units, signs, constants and rates."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.text_tables import number_or_nan
from meshes.base.units import UNITS, column_of, name_of, plain_unit, unit_of
from tissue.fitting.log_files import CHANNELS, QUATERNION, TIPS, LogColumns

__all__ = [
    "FORCES",
    "QUANTITIES",
    "ROTATION_VECTOR",
    "TIMES",
    "from_first",
    "parsed",
    "quantities",
    "quantity",
    "suggested",
]

ROTATION_VECTOR = tuple(f"tool_r{c}_rad" for c in "xyz")
FORCES = CHANNELS[:3]
TORQUES = CHANNELS[3:]
QUANTITIES: dict[str, str] = {
    **dict.fromkeys(("time_s", "load_time_s"), "time"),
    **dict.fromkeys(TIPS, "length"),
    **dict.fromkeys(QUATERNION, "number"),
    **dict.fromkeys(ROTATION_VECTOR, "angle"),
    **dict.fromkeys(FORCES, "force"),
    **dict.fromkeys(TORQUES, "torque"),
}
"""Kind of each quantity that a fit of a cut can use, as a key of `UNITS`.

Poses are poses of the tool's tip in the scene's frame, as in a replayed motion. ``tool_r*_rad`` is
a rotation vector that replaces a quaternion. Forces and torques act on the tool and are given in
the scene's frame. Torques are about the tip. ``load_time_s`` holds the times of forces and torques
if they differ from the times of the poses.
"""
TIMES = ("t", "time", "timestamp", "time_stamp", "elapsed", "elapsed_time", "zeit")
"""Names of a column of times in lower-case letters, without unit."""
EPOCH_S = 1e8
"""Time above which times are counted from 1970 [s], because no log lasts three years."""
OF_FORCE = ("f", "force", "load", "kraft", "wrench")
"""Words that precede the axis in the header of a force."""
NOT_OF_PLACE = (*OF_FORCE, "torque", "moment", "velocity", "vel", "acc", "orientation", "q")
"""Words in the headers of vector components (with an axis) that are not positions."""


def parsed(texts: Sequence[str], names: Sequence[str] = tuple(QUANTITIES)) -> dict[str, str]:
    """Return the column, with sign and unit, of each quantity that a flag ``NAME=COLUMN`` names."""
    asked: dict[str, str] = {}
    for text in texts:
        name, _, column = (part.strip() for part in text.partition("="))
        if name not in names or name in asked or not column.removeprefix("-"):
            raise InputError(
                "column",
                "be NAME=COLUMN or NAME=COLUMN:UNIT, each name once",
                f"{text!r}",
                f"write for example {names[-1]}=F, where the name is one of {', '.join(names)}",
            )
        asked[name] = column
    return asked


def quantities(found: LogColumns, asked: Mapping[str, str], notes: list[str]) -> dict[str, Array]:
    """Return the available quantities in SI by name, and add a note on the unused columns."""
    values: dict[str, Array] = {}
    constants: dict[str, float] = {}
    used = set[str]()
    for name, measure in QUANTITIES.items():
        fixed = _constant(name, asked.get(name, ""), found)
        if fixed is not None:
            constants[name] = fixed
            continue
        column, numbers = quantity(name, measure, asked.get(name), found, notes)
        if numbers is not None:
            values[name] = numbers
            used.add(column)
    rate_Hz = constants.pop("time_s", found.rate_Hz)
    if "time_s" not in values and rate_Hz and TIPS[2] in values:
        values["time_s"] = np.arange(len(values[TIPS[2]])) / rate_Hz
        notes.append(f"the times follow from the rate of {rate_Hz:g} Hz")
    for name, constant in constants.items():
        values[name] = np.full(len(values.get("time_s", ())), constant)
    # the trace of a run has many columns: the note names the first 12
    if left := [name for name in found.names if name not in used]:
        notes.append(f"not used: {', '.join(left[:12])}{' and others' if len(left) > 12 else ''}")
    return values


def quantity(
    name: str, measure: str, asked: str | None, found: LogColumns, notes: list[str]
) -> tuple[str, Array | None]:
    """Return the column of a quantity and its values in SI; None if the file has no such column.

    Parameters
    ----------
    name, measure
        Name of the quantity with its unit, and the key of `UNITS`.
    asked
        Column, with sign and unit, that the user has given; None to search by the name.
    found
        Columns of the file.
    notes
        List to which a sentence is added if the unit is not the unit of the name.
    """
    if asked is None:
        asked = column_of(name, measure, found.names)
    if asked is None:
        # HDF5 files have columns in groups
        grouped = [each for each in found.names if each.endswith(f"/{name}")]
        asked = grouped[0] if len(grouped) == 1 else None
    if asked is None and name == "time_s":
        times = [each for each in found.names if name_of(each, "time") in TIMES]
        asked = times[0] if len(times) == 1 else None
    if asked is None:
        return "", None
    column, sign, unit = _column(name, asked, found.names)
    values = sign * found.numbers(column)
    if measure == "time" and not unit and not unit_of(column, "time"):
        factor, remark = _clock(column, values)
    else:
        factor, remark = _factor(name, measure, column, unit)
    if remark:
        notes.append(remark)
    return column, factor * values


def _column(name: str, asked: str, known: Sequence[str]) -> tuple[str, float, str]:
    """Return the column that a text names, the sign of the column, and its unit (may be empty)."""
    for sign, text in ((1.0, asked), (-1.0, asked.removeprefix("-"))):
        column, unit = (text, "") if text in known else _split(text)
        if column in known:
            return column, sign, unit
    raise InputError(
        "column",
        f"map {name} to a column of the log",
        _split(asked)[0].removeprefix("-"),
        # a table of a simulator may have hundreds of columns
        f"choose one of {', '.join(sorted(known)[:60])}",
    )


def _factor(name: str, measure: str, column: str, unit: str) -> tuple[float, str]:
    """Return the factor to SI of a column, and a remark, which may be empty.

    The unit is the given unit, or the unit in the header, or the unit of the quantity's name.
    """
    factors = UNITS[measure]
    # components of a quaternion have no unit
    if not factors and not unit:
        return 1.0, ""
    default = name.rpartition("_")[2]
    header = unit_of(column, measure)
    taken = plain_unit(unit) or header or default
    if taken not in factors:
        raise InputError(
            "column", f"give {name} a unit of {measure}", unit, f"use one of {', '.join(factors)}"
        )
    if unit and header not in ("", taken):
        return factors[taken], f"{column} is read in {taken}, as asked; its header has {header}"
    if not unit and header not in ("", default):
        return factors[taken], f"{column} is read in {taken}, the unit of its header"
    return factors[taken], ""


def _clock(column: str, times: Array) -> tuple[float, str]:
    """Return the factor to seconds of times without a unit, and a remark, which may be empty.

    The unit of times since 1970 follows from their size, because every log was made after 1973.
    """
    middle = float(np.nanmedian(times)) if len(times) else 0.0
    for unit in ("ns", "us", "ms"):
        if middle * UNITS["time"][unit] > EPOCH_S:
            return UNITS["time"][unit], f"{column} has no unit and is read in {unit} since 1970"
    return 1.0, "" if middle > EPOCH_S else f"{column} has no unit and is read in s"


def _constant(name: str, asked: str, found: LogColumns) -> float | None:
    """Return the constant in SI that a flag gives instead of a column; None if it names a column.

    For times, the flag gives the rate of the samples, such as 500:Hz.
    """
    text, unit = _split(asked)
    value = number_or_nan(text)
    if text in found.names or not np.isfinite(value):
        return None
    if name != "time_s":
        return value * _factor(name, QUANTITIES[name], "", unit)[0]
    if unit != "Hz" or value <= 0.0:
        raise InputError(
            "column", "give time_s a column or a rate", asked, "write for example time_s=500:Hz"
        )
    return value


def _split(text: str) -> tuple[str, str]:
    """Split ``COLUMN:UNIT`` into column and unit."""
    column, found, unit = text.rpartition(":")
    return (column.strip(), unit.strip()) if found and column else (text, "")


def from_first(values: dict[str, Array], notes: list[str]) -> None:
    """Subtract the first time from times since 1970, in place."""
    clocks = [name for name in ("time_s", "load_time_s") if len(values.get(name, ()))]
    start_s = min((float(values[name][0]) for name in clocks), default=0.0)
    if start_s > EPOCH_S:
        for name in clocks:
            values[name] = values[name] - start_s
        moment = datetime.fromtimestamp(min(start_s, 1e11), UTC)
        notes.append(f"times are counted from {moment:%Y-%m-%d %H:%M:%S} UTC")


def suggested(missing: Sequence[str], names: Sequence[str]) -> str:
    """Return flags that assign columns to missing quantities, guessed from the headers."""
    found = {name: [each for each in names if _is_like(name, each)] for name in missing}
    depths = [each for each in names if unit_of(each, "length")]
    if set(TIPS) <= set(missing) and len(depths) == 1 and not found[TIPS[0]]:
        # a testing machine of one axis, whose depth grows downward
        heights = (["0"], ["0"], [f"-{depths[0]}"])
        found |= dict(zip(TIPS, heights, strict=True))
    flags = []
    for name, columns in found.items():
        column = columns[0] if len(columns) == 1 else "COLUMN[:UNIT]"
        flags.append(f"--column '{name}={column}'")
    return " ".join(flags)


def _is_like(name: str, header: str) -> bool:
    """Return whether a header such as "Fx [mN]" may be the name of a quantity along an axis."""
    measure = QUANTITIES[name]
    if measure not in ("length", "force"):
        return measure == "time" and bool(unit_of(header, "time"))
    axis = name.split("_")[1]
    *first, last = name_of(header, measure).split("_")
    if measure == "force":
        return last == f"f{axis}" or (last == axis and bool(set(first) & set(OF_FORCE)))
    return last in (axis, f"p{axis}", f"pos{axis}") and not set(first) & set(NOT_OF_PLACE)
