"""Reading of points, lines, curves and planes that were saved by 3D Slicer.

The files are markups ``.mrk.json`` and older point lists ``.fcsv``.

All results are in LPS [mm]. The files may be in LPS or RAS.
"""

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, as_vector, counted, enumerated, require_file
from meshes.base.text_tables import (
    number_or_nan,
    read_json,
    read_text,
    require_distinct_columns,
)

TO_LPS = {"LPS": np.ones(3), "RAS": np.array([-1.0, -1.0, 1.0])}
"""Factors of x, y and z that convert coordinates from each of the two patient frames to LPS."""
_FRAMES = {**TO_LPS, "0": TO_LPS["RAS"], "1": TO_LPS["LPS"]}
"""Factors of `TO_LPS` by frame name, and by frame number as in 3D Slicer before version 4.11."""
_POINTS = "Fiducial"
_CURVES = ("Line", "Curve", "ClosedCurve")


@dataclass(frozen=True, eq=False)
class Markup:
    """Markup of 3D Slicer (points, line, curve or plane) from a file.

    Attributes
    ----------
    kind
        ``Fiducial`` (points), ``Line``, ``Curve``, ``ClosedCurve``, ``Plane`` or another word from
        the file.
    points_mm
        Control points [mm, LPS], shape (n, 3). A plane has one point, its origin.
    labels
        Names of the control points.
    normal
        Unit normal of a plane in LPS, shape (3,); None for all other kinds.
    """

    kind: str
    points_mm: Array
    labels: tuple[str, ...]
    normal: Array | None = None


def read_markups(path: str | Path) -> tuple[Markup, ...]:
    """Read all markups of a ``.mrk.json`` or ``.fcsv`` file.

    Raises
    ------
    InputError
        If the file is missing or has another format. Also raised if the frame is not LPS or RAS, or
        if the unit is not mm. Also raised if a control point is undefined or does not consist of
        three finite numbers.
    """
    file = Path(path)
    require_file(file, "markups")
    try:
        text = read_text(file)
        if file.suffix.lower() == ".fcsv":
            return (_point_list(text, file),)
        if not file.name.lower().endswith(".json"):
            raise _error(
                "be a .mrk.json or .fcsv file", f"the suffix {file.suffix or 'none'}", file
            )
        found = tuple(_markup(one, file) for one in read_json(text)["markups"])
    except (UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError, AttributeError):
        raise _error("be a markups file of 3D Slicer", "other data", file) from None
    if not found:
        raise _error("contain at least one markup", "none", file)
    return found


def read_site(path: str | Path) -> tuple[Array, Array | None]:
    """Read the site (place where a tool works) that a markups file marks.

    A file marks a site by a plane (origin and normal), by a line from the site into the bone, or by
    one point.

    Returns
    -------
    Point [mm, LPS], shape (3,), and outward unit normal in LPS, shape (3,). The normal is None if
    the file only contains a point.

    Raises
    ------
    InputError
        If the file cannot be read, or does not mark exactly one site.
    """
    found = read_markups(path)
    chosen: list[Markup] = []
    for kind in ("Plane", "Line", _POINTS):
        chosen = chosen or [one for one in found if one.kind == kind and len(one.labels)]
    wanted = 2 if chosen and chosen[0].kind == "Line" else 1
    if len(chosen) != 1 or len(chosen[0].points_mm) != wanted:
        held = enumerated(
            f"a {one.kind} with {counted(len(one.points_mm), 'point')}" for one in chosen
        )
        required = "contain one plane, one line from the site inward, or one point"
        raise _error(required, held or "none", Path(path))
    one = chosen[0]
    if one.kind != "Line":
        return one.points_mm[0], one.normal
    outward = one.points_mm[0] - one.points_mm[1]
    return one.points_mm[0], _unit(outward, Path(path))


def read_curve(path: str | Path) -> Array:
    """Read the control points [mm, LPS], shape (n, 3), of the only curve in a file.

    If the file has one point list and no curve, the points of the list are returned in the order of
    the list.

    3D Slicer draws a smooth curve through the points, but this library joins the points by straight
    lines. If the points lie far apart, resample the curve in 3D Slicer. For a closed curve, the
    first point is repeated at the end.

    Raises
    ------
    InputError
        If the file cannot be read, or does not contain exactly one curve or point list.
    """
    found = read_markups(path)
    curves = [one for one in found if one.kind in _CURVES] or [
        one for one in found if one.kind == _POINTS
    ]
    if len(curves) != 1 or len(curves[0].points_mm) < 2:
        held = f"{len(curves)} curves"
        if len(curves) == 1:
            held = f"a curve with {counted(len(curves[0].points_mm), 'point')}"
        raise _error("contain one curve with at least two points", held, Path(path))
    points = curves[0].points_mm
    return np.vstack([points, points[:1]]) if curves[0].kind == "ClosedCurve" else points


def _markup(record: dict[str, Any], file: Path) -> Markup:
    """Read one markup of a JSON file."""
    kind = str(record["type"])
    frame = _frame(record.get("coordinateSystem"), file)
    unit = record.get("coordinateUnits", "mm")
    if unit not in ("mm", ["mm", "mm", "mm"]):
        raise _error("have coordinateUnits mm", unit, file)
    points = []
    labels = []
    for number, point in enumerate(record.get("controlPoints") or [], start=1):
        label = str(point.get("label") or point.get("id") or number)
        status = point.get("positionStatus", "defined")
        if status != "defined":
            raise _error(
                "contain only placed control points", f"the status {status} of {label}", file
            )
        points.append(frame * _three(point["position"], label, file))
        labels.append(label)
    if kind != "Plane":
        return Markup(kind, np.array(points).reshape(-1, 3), tuple(labels))
    stated = [record[key] for key in ("center", "origin") if record.get(key) is not None]
    if not stated and not points:
        raise _error("contain planes with an origin", "a plane without an origin", file)
    centre = frame * _three(stated[0], "its origin", file) if stated else points[0]
    normal = _unit(_normal(record, points, frame, file), file)
    return Markup(kind, centre[None], (labels[0] if labels else "plane",), normal)


def _normal(record: dict[str, Any], points: list[Array], frame: Array, file: Path) -> Array:
    """Return a normal vector of a plane, with arbitrary length.

    If the record states a normal, this normal is used. Otherwise, the third axis of the plane's
    orientation is used. Without an orientation, the normal of three points is used.
    """
    if record.get("normal") is not None:
        return frame * _three(record["normal"], "the normal", file)
    if record.get("orientation") is not None:
        # stored row by row, with axes as columns
        numbers = np.asarray(record["orientation"], dtype=np.float64).reshape(-1)[2::3]
        return frame * _three(numbers, "the orientation", file)
    if len(points) == 3:
        return np.cross(points[1] - points[0], points[2] - points[0])
    raise _error("contain planes with a normal", "a plane without a normal", file)


def _point_list(text: str, file: Path) -> Markup:
    """Read the points of a .fcsv file.

    The header may occur several times, because a file may have been joined from several files.
    """
    frame: Array | None = None
    columns: tuple[str, ...] = ("id", "x", "y", "z")
    points: list[Array] = []
    labels: list[str] = []
    for line in text.splitlines():
        if line.startswith("#"):
            key, _, value = line.lstrip("# ").partition("=")
            if key.strip() == "CoordinateSystem":
                frame = _frame(value.strip(), file)
            elif key.strip() == "columns":
                columns = tuple(name.strip() for name in value.split(","))
                require_distinct_columns(columns, "markups", file)
        elif line.strip():
            frame = _frame(None, file) if frame is None else frame
            row = dict(zip(columns, next(csv.reader([line])), strict=False))
            label = row.get("label") or row.get("id") or str(len(points) + 1)
            numbers = [number_or_nan(row.get(axis)) for axis in "xyz"]
            points.append(frame * _three(numbers, label, file))
            labels.append(label)
    if not points:
        raise _error("contain at least one point", "none", file)
    return Markup(_POINTS, np.array(points), tuple(labels))


def _frame(name: object, file: Path) -> Array:
    if str(name) not in _FRAMES:
        raise _error("have the coordinateSystem LPS or RAS", name or "none", file)
    return _FRAMES[str(name)]


def _three(value: Any, what: str, file: Path) -> Array:
    numbers = as_vector(value)
    if numbers is None:
        raise _error("have three finite coordinates", f"{value!r:.80} for {what}", file)
    return numbers


def _unit(direction: Array, file: Path) -> Array:
    """Return the unit vector along a direction."""
    length = float(np.linalg.norm(direction))
    # The limit is far below the digits of a file in mm, so it only excludes rounding errors of
    # zero.
    if length < 1e-9:
        raise _error("have normals and lines of non-zero length", "one of length 0", file)
    return direction / length


def _error(wanted: str, got: object, file: Path) -> InputError:
    return InputError("markups", wanted, f"{got} in {file}", "save them again from 3D Slicer")
