"""Map from the columns of a log to quantities: known names, units, and flags of the user."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from meshes.base.errors import InputError

__all__ = ["QUANTITIES", "UNITS", "ColumnMap", "Quantity", "parse_column", "parse_columns"]

UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6},
    "length": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "gf": 9.80665e-3, "lbf": 4.4482216152605},
    "torque": {"Nm": 1.0, "Nmm": 1e-3, "mNm": 1e-3},
    "angle": {"rad": 1.0, "deg": 0.017453292519943295},
    "number": {},
}
"""Factors to SI by quantity.

The factors of gf and lbf are from BIPM and NIST SP 811 and are exact.
"""


@dataclass(frozen=True)
class Quantity:
    """Quantity that a log may hold, by the name of its column in a trace.

    Attributes
    ----------
    name
        Name such as ``tool_x_mm``, with the unit at its end.
    measures
        Key of `UNITS`.
    unit
        Unit in the name. Empty for a number.
    """

    name: str
    measures: str
    unit: str

    @property
    def factor(self) -> float:
        """SI values of 1 in the unit of the name."""
        return UNITS[self.measures].get(self.unit, 1.0)


def _of(measures: str, *names: str) -> tuple[Quantity, ...]:
    return tuple(
        Quantity(name, measures, name.rsplit("_", 1)[1] if UNITS[measures] else "")
        for name in names
    )


def _vector(measures: str, form: str) -> tuple[Quantity, ...]:
    return _of(measures, *(form.format(axis) for axis in "xyz"))


_TIMES = _of("time", "time_s", "load_time_s")
_TURN = (
    *_of("number", "tool_qx", "tool_qy", "tool_qz", "tool_qw"),
    *_vector("angle", "tool_r{}_rad"),
)
_POSE = (*_vector("length", "tool_{}_mm"), *_TURN)
_FORCE = _vector("force", "force_{}_N")
_TORQUE = _vector("torque", "torque_{}_Nm")
QUANTITIES = {each.name: each for each in (*_TIMES, *_POSE, *_FORCE, *_TORQUE)}
"""Quantities that a fit of a cut can use, by name.

Poses are poses of the tool's tip in the scene's frame, as in a replayed motion. ``tool_r*_rad`` is
a rotation vector that replaces a quaternion. Forces and torques act on the tool, in the scene's
frame, torques about the tip. ``load_time_s`` is the clock of forces and torques if it differs from
the clock of the poses.
"""


@dataclass(frozen=True)
class ColumnMap:
    """Quantity that is read from a column of another name or unit.

    Attributes
    ----------
    quantity
        Name of the quantity.
    column
        Text after the name: the column, with its sign before it and its unit after it.
    """

    quantity: Quantity
    column: str

    def find(self, known: Iterable[str]) -> tuple[str, float, str]:
        """Return the matching column, the factor from its values to SI, and a remark.

        The factor includes the sign. The remark may be empty.

        Raises
        ------
        InputError
            If the column is not there, or its unit is unknown or one of another quantity.
        """
        names = set(known)
        for sign, text in ((1.0, self.column), (-1.0, self.column.removeprefix("-"))):
            column, unit = (text, "") if text in names else _split(text)
            if column in names and (sign > 0.0 or self.column.startswith("-")):
                factor, remark = self._factor(column, unit)
                return column, sign * factor, remark
        asked = _split(self.column)[0].removeprefix("-")
        listed = ", ".join(sorted(names)[:60]) + (" and others" if len(names) > 60 else "")
        raise InputError(
            "column",
            f"map {self.quantity.name} to a column of the log",
            asked,
            f"choose one of {listed}",
        )

    def _factor(self, column: str, unit: str) -> tuple[float, str]:
        """Return the factor to SI, and a remark if the column's header gives another unit."""
        fitting = UNITS[self.quantity.measures]
        if unit and _plain(unit) not in fitting:
            allowed = f"be one of {', '.join(fitting)}" if fitting else "be absent"
            raise InputError(
                "column",
                f"give {self.quantity.name} a unit of {self.quantity.measures}",
                unit,
                f"it must {allowed}",
            )
        taken = _plain(unit) or self.quantity.unit
        stated = _stated(column, fitting)
        if stated and stated != taken and not unit:
            raise InputError(
                "column",
                (
                    f"state the unit where the header of {column} has {stated} and "
                    f"{self.quantity.name} has {taken}"
                ),
                "none",
                f"write {self.quantity.name}={self.column}:{stated}",
            )
        remark = (
            f"{column} is read in {taken}, as asked; its header has {stated}"
            if stated not in ("", taken)
            else ""
        )
        return fitting.get(taken, 1.0), remark


def parse_column(text: str, quantities: Mapping[str, Quantity] = QUANTITIES) -> ColumnMap:
    """Parse a flag ``NAME=COLUMN``, ``NAME=COLUMN:UNIT`` or ``NAME=-COLUMN:UNIT``.

    A minus reverses the sign.

    Without a unit the column is in the unit of the name.

    Raises
    ------
    InputError
        If it has another form, or a fit does not use that name.
    """
    name, found, column = text.partition("=")
    name = name.strip()
    column = column.strip()
    if not found or not name or not column.removeprefix("-"):
        raise InputError(
            "column",
            "be NAME=COLUMN or NAME=COLUMN:UNIT",
            f"{text!r}",
            "write for example force_x_N=Fx",
        )
    if name not in quantities:
        raise InputError(
            "column",
            "name what a fit uses",
            name,
            f"choose one of {', '.join(quantities)} or leave it out",
        )
    return ColumnMap(quantities[name], column)


def parse_columns(
    texts: Sequence[str], quantities: Mapping[str, Quantity] = QUANTITIES
) -> dict[str, ColumnMap]:
    """Parse flags and return them by the name that they map, see `parse_column`.

    `quantities` are the quantities that a log may hold.

    Raises
    ------
    InputError
        As for `parse_column`, or if a name is mapped twice.
    """
    maps: dict[str, ColumnMap] = {}
    for text in texts:
        each = parse_column(text, quantities)
        if each.quantity.name in maps:
            raise InputError(
                "column", "map a name once", f"{each.quantity.name} twice", "leave one out"
            )
        maps[each.quantity.name] = each
    return maps


def _split(text: str) -> tuple[str, str]:
    """Split ``COLUMN:UNIT`` into column and unit."""
    column, found, unit = text.rpartition(":")
    return (column.strip(), unit.strip()) if found and column else (text, "")


def _plain(unit: str) -> str:
    """Return a unit in the spelling of `UNITS`: N m, N*m and N·m become Nm."""
    return re.sub(r"[\s*·.]", "", unit).replace("µ", "u").replace("μ", "u")


def _stated(column: str, fitting: dict[str, float]) -> str:
    """Return the unit in a header if it is one of the fitting units.

    A header has the form ``Load (N)``, ``Load [N]`` or ``load_N``. The result is an empty string
    without a fitting unit.
    """
    found = re.search(r"[\[(]([^\])]+)[\])]\s*$", column) or re.search(r"_([A-Za-zµ]+)$", column)
    unit = _plain(found[1]) if found else ""
    return unit if unit in fitting else ""
