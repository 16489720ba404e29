"""Extraction of a log's quantities from file columns by names, units, signs and rates."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated
from meshes.base.text_tables import number_or_nan
from meshes.base.units import UNITS, column_of, name_of, plain_unit, unit_of
from tissue.fitting.log_files import CHANNELS, QUATERNION, TIPS, LogColumns

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
"""Time [s] above which a clock counts from 1970, because no log lasts three years."""
USUAL = {
    "time_s": TIMES,
    "depth_mm": ("indentation", "displacement", "penetration"),
    "force_N": ("load", "fn"),
}
"""Usual names of a column in lower-case letters.

Except for times, the names are used only if the header has a unit.
"""
OF_FORCE = ("f", "force", "load", "kraft", "wrench")
"""Words that precede the axis in the header of a force column."""
NOT_OF_PLACE = (*OF_FORCE, "torque", "moment", "velocity", "vel", "acc", "orientation", "q")
"""Words that precede the axis in the header of a column that is not a position."""


def parsed(texts: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    """Parse flags ``NAME=COLUMN`` to a dictionary from quantity to column, with sign and unit."""
    asked: dict[str, str] = {}
    for text in texts:
        name, _, column = (part.strip() for part in text.partition("="))
        if name not in names or name in asked or not column.removeprefix("-"):
            raise InputError(
                "column",
                "be NAME=COLUMN or NAME=COLUMN:UNIT, each name once",
                f"{text!r}",
                f"write for example {names[-1]}=F. The name is one of {', '.join(names)}",
            )
        asked[name] = column
    return asked


def quantities(
    found: LogColumns, asked: Mapping[str, str], measures: Mapping[str, str], notes: list[str]
) -> tuple[dict[str, Array], list[str]]:
    """Return the available quantities in SI units, keyed by name, and the names of unused columns.

    Parameters
    ----------
    found
        Columns of the file.
    asked
        Column with sign and unit, or a number, keyed by the name of the quantity. For other
        quantities, the function searches for a column with a matching header.
    measures
        Kind of each quantity, keyed by the quantity's name with unit. A kind is a key of `UNITS`.
    notes
        List to which a sentence is added if a column's unit differs from the unit in the quantity's
        name.
    """
    values: dict[str, Array] = {}
    constants: dict[str, float] = {}
    unused = list(found.names)
    for name, measure in measures.items():
        text = asked.get(name) or column_for(name, measure, found.names)
        if text is None:
            continue
        column, sign, unit = _column(name, text, found.names)
        if not column:
            constants[name] = sign * _factor(name, measure, "", unit)[0]
            continue
        numbers = found.numbers(column)
        if measure == "time" and not unit and not unit_of(column, "time"):
            factor, remark = _clock(column, numbers)
        else:
            factor, remark = _factor(name, measure, column, unit)
        values[name] = sign * factor * numbers
        if column in unused:
            unused.remove(column)
        if remark:
            notes.append(remark)
    rows = len(next(iter(values.values()), ()))
    return values | {name: np.full(rows, value) for name, value in constants.items()}, unused


def column_for(name: str, measure: str, names: Sequence[str]) -> str | None:
    """Return the column whose header fits a quantity; None if no or several headers fit."""
    found = column_of(name, measure, names)
    if found is not None:
        return found
    # HDF5 files have columns in groups
    likely = [each for each in names if each.endswith(f"/{name}")]
    if not likely:
        likely = [
            each
            for each in names
            if name_of(each, measure) in USUAL.get(name, ())
            and (name == "time_s" or unit_of(each, measure))
        ]
    return likely[0] if len(likely) == 1 else None


def _column(name: str, asked: str, known: Sequence[str]) -> tuple[str, float, str]:
    """Return the column that `asked` names, its sign, and its unit, which may be empty.

    For a constant, the column is empty, and the sign is the value of the constant.
    """
    for sign, text in ((1.0, asked), (-1.0, asked.removeprefix("-"))):
        column, unit = (text, "") if text in known else split_unit(text)
        if column in known:
            return column, sign, unit
    text, unit = split_unit(asked)
    if np.isfinite(value := number_or_nan(text)):
        return "", value, unit
    raise InputError(
        "column",
        f"map {name} to a column of the log",
        text.removeprefix("-"),
        # a table of a simulator may have hundreds of columns
        f"choose one of {', '.join(sorted(known)[:60])}",
    )


def _factor(name: str, measure: str, column: str, unit: str) -> tuple[float, str]:
    """Return the factor that converts a column to SI, and a remark, which may be empty.

    The unit is the first of these that exists: the given unit, the unit in the header, the unit in
    the quantity's name.
    """
    factors = UNITS[measure]
    # components of a quaternion have no unit
    if not factors and not unit:
        return 1.0, ""
    # the name of a feed ends in mm_s or per_turn
    default = unit_of(name, measure) or "mm"
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
    """Return the factor that converts times without a unit to seconds, and a remark or "".

    The unit of times since 1970 follows from their size, because every log was made after 1973.
    """
    middle = float(np.nanmedian(times)) if len(times) else 0.0
    for unit in ("ns", "us", "ms"):
        if middle * UNITS["time"][unit] > EPOCH_S:
            return UNITS["time"][unit], f"{column} has no unit and is read in {unit} since 1970"
    return 1.0, "" if middle > EPOCH_S else f"{column} has no unit and is read in s"


def split_unit(text: str) -> tuple[str, str]:
    """Split ``COLUMN:UNIT`` into column and unit."""
    column, found, unit = text.rpartition(":")
    return (column.strip(), unit.strip()) if found and column else (text, "")


def from_first(values: dict[str, Array], notes: list[str]) -> None:
    """Subtract the first time, in place, if the times are counted from 1970."""
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


def the_columns(names: Sequence[str]) -> str:
    """Return the names of columns as a phrase such as "the columns a and b"."""
    return f"the {'column' if len(names) == 1 else 'columns'} {enumerated(names)}"


def _is_like(name: str, header: str) -> bool:
    """Return True if a header such as "Fx [mN]" can name a quantity along an axis."""
    measure = QUANTITIES[name]
    if measure not in ("length", "force"):
        return measure == "time" and bool(unit_of(header, "time"))
    axis = name.split("_")[1]
    *first, last = name_of(header, measure).split("_")
    if measure == "force":
        return last == f"f{axis}" or (last == axis and bool(set(first) & set(OF_FORCE)))
    return last in (axis, f"p{axis}", f"pos{axis}") and not set(first) & set(NOT_OF_PLACE)
