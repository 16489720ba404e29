"""A tool's path from a file: CSV, a curve of 3D Slicer, or G-code, in the frame of a patient."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_file
from meshes.base.text_numbers import number_in, require_distinct_columns
from meshes.paths.gcode import read_gcode
from meshes.surfaces.markups import TO_LPS, read_curve

__all__ = ["GCODE", "Toolpath", "read_toolpath"]

GCODE = (".gcode", ".nc", ".ngc", ".tap", ".cnc")
_PLACE, _FEED, _AXIS = ("x_mm", "y_mm", "z_mm"), "feed_mm_s", ("axis_x", "axis_y", "axis_z")


@dataclass(frozen=True, eq=False)
class Toolpath:
    """Points that a tool's tip goes through on straight lines.

    Attributes
    ----------
    points_mm
        Points [mm, LPS], shape (n, 3).
    feeds_mm_s
        Speed to each point from the one before it [mm/s], shape (n,), NaN where the tool goes there rapidly; None where
        the file states none. The first counts for nothing.
    axes
        Unit vectors from the tip towards the shaft at each point, LPS, shape (n, 3); None where the file states none.
    """

    points_mm: Array
    feeds_mm_s: Array | None = None
    axes: Array | None = None


def read_toolpath(path: str | Path, coordinates: str) -> Toolpath:
    """Read a path.

    Parameters
    ----------
    path
        CSV with the columns x_mm, y_mm, z_mm and, where wanted, feed_mm_s and axis_x, axis_y, axis_z; a curve as
        ``.mrk.json`` or points as ``.fcsv``; or G-code (`meshes.paths.gcode`).
    coordinates
        ``LPS`` or ``RAS``: the frame of the numbers in CSV and G-code. Markups state their own.

    Raises
    ------
    InputError
        If the file cannot be read, holds fewer than two points or numbers that are not finite, a feed is not positive,
        or an axis is zero.
    """
    file = Path(path)
    if coordinates not in TO_LPS:
        raise InputError(f"coordinates must be LPS or RAS, got {coordinates}: look which of them the file was made in")
    require_file(file, "a path")
    name, frame = file.name.lower(), TO_LPS[coordinates]
    if name.endswith((".json", ".fcsv")):
        return Toolpath(read_curve(file))
    if file.suffix.lower() in GCODE:
        points, feeds = read_gcode(file)
        return Toolpath(points * frame, feeds)
    if file.suffix.lower() == ".csv":
        points, given, axes = _read_table(file)
        return Toolpath(points * frame, given, None if axes is None else axes * frame)
    raise InputError(
        f"path must be a .csv, .mrk.json, .fcsv or G-code file ({', '.join(GCODE)}), got {file}: rename it"
    )


def _read_table(file: Path) -> tuple[Array, Array | None, Array | None]:
    """Points, feeds and axes of a CSV file, in its frame."""
    try:
        with file.open(newline="", encoding="utf-8-sig") as opened:
            reader = csv.DictReader(opened, skipinitialspace=True)
            names = tuple(name.strip() for name in reader.fieldnames or ())
            reader.fieldnames = names
            require_distinct_columns(names, "path", file)
            _check_columns(names, file)
            used = [name for name in (*_PLACE, _FEED, *_AXIS) if name in names]
            rows = [[_number(row[name], name, reader.line_num, file) for name in used] for row in reader]
    except (UnicodeDecodeError, csv.Error):
        raise InputError(f"path must be a CSV table, got other data in {file}: export it as text") from None
    if len(rows) < 2:
        raise InputError(f"path must have at least two points, got {len(rows)} in {file}: add some")
    table = np.array(rows)
    column = {name: table[:, number] for number, name in enumerate(used)}
    points = np.column_stack([column[name] for name in _PLACE])
    feeds = column.get(_FEED)
    if feeds is not None and (feeds[1:] <= 0.0).any():
        row = 1 + int(np.argmax(feeds[1:] <= 0.0))
        raise InputError(
            f"{_FEED} must be positive, got {feeds[row]:g} at point {row + 1} of {file}: use for example 2"
        )
    if _AXIS[0] not in column:
        return points, feeds, None
    axes = np.column_stack([column[name] for name in _AXIS])
    length = np.linalg.norm(axes, axis=1)
    if (length < 1e-6).any():
        raise InputError(f"axis must not be zero, got it at point {int(np.argmin(length)) + 1} of {file}: mend it")
    return points, feeds, axes / length[:, None]


def _check_columns(names: tuple[str, ...], file: Path) -> None:
    """Refuse missing and unknown columns."""
    missing = [name for name in _PLACE if name not in names]
    if any(name in names for name in _AXIS):
        missing += [name for name in _AXIS if name not in names]
    if missing:
        raise InputError(f"path must have the columns {', '.join(missing)}, got {', '.join(names)} in {file}: add them")
    unknown = [name for name in names if name not in (*_PLACE, _FEED, *_AXIS)]
    if unknown:
        raise InputError(
            f"path must have no columns but {', '.join((*_PLACE, _FEED, *_AXIS))}, got {', '.join(unknown)} in {file}: "
            "drop them"
        )


def _number(text: str | None, name: str, line: int, file: Path) -> float:
    try:
        value = number_in(text or "")
    except ValueError:
        value = float("nan")
    if not np.isfinite(value):
        raise InputError(
            f"path must hold finite numbers, got {text or 'nothing'} for {name} in line {line} of {file}: mend it"
        )
    return value
