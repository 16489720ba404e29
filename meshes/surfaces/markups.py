"""Points, lines, curves and planes that 3D Slicer saved.

They are markups ``.mrk.json`` and its older point lists ``.fcsv``.

All results are in LPS [mm], whether the file states LPS or RAS.
"""

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, as_vector, require_file
from meshes.base.text_tables import number_in, read_json, require_distinct_columns

__all__ = ["TO_LPS", "MarkedSite", "Markup", "read_curve", "read_markups", "read_site"]

TO_LPS = {"LPS": np.ones(3), "RAS": np.array([-1.0, -1.0, 1.0])}
"""Factors of x, y and z from each of the two frames of patients to LPS."""
_FRAMES = {**TO_LPS, "0": TO_LPS["RAS"], "1": TO_LPS["LPS"]}
"""`TO_LPS`, with the frame numbers of files before version 4.11 of 3D Slicer."""
_POINTS = "Fiducial"
_CURVES = ("Line", "Curve", "ClosedCurve")
_COLUMNS = ("id", "x", "y", "z")


@dataclass(frozen=True, eq=False)
class Markup:
    """One markup.

    Attributes
    ----------
    kind
        ``Fiducial`` (points), ``Line``, ``Curve``, ``ClosedCurve``, ``Plane`` or another word of
        the file.
    points_mm
        Control points [mm, LPS], shape (n, 3); of a plane its origin alone.
    labels
        Their names.
    normal
        Unit normal of a plane, LPS, shape (3,); None for all other kinds.
    """

    kind: str
    points_mm: Array
    labels: tuple[str, ...]
    normal: Array | None = None


@dataclass(frozen=True, eq=False)
class MarkedSite:
    """Site marked by a user.

    Attributes
    ----------
    centre_mm
        Point [mm, LPS], shape (3,).
    normal
        Outward unit normal, LPS, shape (3,); None where the file holds a point alone.
    """

    centre_mm: Array
    normal: Array | None


def read_markups(path: str | Path) -> tuple[Markup, ...]:
    """Read all markups of a ``.mrk.json`` or ``.fcsv`` file.

    Raises
    ------
    InputError
        If the file is missing or of another kind, states neither LPS nor RAS or a unit that is not
        mm, or a control point is undefined or is not three finite numbers.
    """
    file = Path(path)
    require_file(file, "markups")
    if file.suffix.lower() == ".fcsv":
        return (_point_list(file),)
    if not file.name.lower().endswith(".json"):
        raise InputError(
            "markups", "be a .mrk.json or .fcsv file", file, "save them from 3D Slicer"
        )
    try:
        listed = read_json(file.read_text("utf-8"))["markups"]
        found = tuple(_markup(one, file) for one in listed)
    except (UnicodeDecodeError, json.JSONDecodeError, KeyError, TypeError, AttributeError):
        raise InputError(
            "markups", "be those of 3D Slicer", f"other JSON in {file}", "save them again"
        ) from None
    if not found:
        raise InputError("markups", "hold at least one", f"none in {file}", "save them again")
    return found


def read_site(path: str | Path) -> MarkedSite:
    """Read the site that a file marks.

    It is marked by a plane's origin and normal, a line from the site inward, or one point.

    Raises
    ------
    InputError
        If the file cannot be read, or marks no site or several.
    """
    marked = [
        one
        for one in read_markups(path)
        if one.kind in ("Plane", "Line") or (one.kind == _POINTS and len(one.labels))
    ]
    planes = (
        [one for one in marked if one.kind == "Plane"]
        or [one for one in marked if one.kind == "Line"]
        or marked
    )
    wanted = 2 if planes and planes[0].kind == "Line" else 1
    if len(planes) != 1 or len(planes[0].points_mm) != wanted:
        held = ", ".join(f"{one.kind} of {len(one.points_mm)}" for one in planes) or "none"
        raise InputError(
            "site",
            "be marked by one plane, one line from the site inward, or one point",
            f"{held} in {path}",
            "delete the others",
        )
    one = planes[0]
    if one.kind != "Line":
        return MarkedSite(one.points_mm[0], one.normal)
    outward = one.points_mm[0] - one.points_mm[1]
    length = float(np.linalg.norm(outward))
    if length == 0.0:
        raise InputError(
            "line", "have a length", f"one of two points alike in {path}", "mark it again"
        )
    return MarkedSite(one.points_mm[0], outward / length)


def read_curve(path: str | Path) -> Array:
    """Read the control points [mm, LPS], shape (n, 3), of a file's one curve.

    Without a curve, they are the points of the file's one list, in their order.

    3D Slicer draws a smooth curve through them; here they are joined by straight lines: resample it
    there if they lie far apart. A closed curve ends at its first point.

    Raises
    ------
    InputError
        If the file cannot be read, or holds no curve or several.
    """
    found = read_markups(path)
    curves = [one for one in found if one.kind in _CURVES] or [
        one for one in found if one.kind == _POINTS
    ]
    if len(curves) != 1 or len(curves[0].points_mm) < 2:
        raise InputError(
            "markups",
            "hold one curve of at least two points",
            f"{len(curves)} in {path}",
            "save the curve alone",
        )
    points = curves[0].points_mm
    return np.vstack([points, points[:1]]) if curves[0].kind == "ClosedCurve" else points


def _markup(record: dict[str, Any], file: Path) -> Markup:
    """Read one markup of a JSON file."""
    kind = str(record["type"])
    frame = _frame(record.get("coordinateSystem"), file)
    unit = record.get("coordinateUnits", "mm")
    if unit not in ("mm", ["mm", "mm", "mm"]):
        raise InputError("coordinateUnits", "be mm", f"{unit} in {file}", "save the markups in mm")
    listed = record.get("controlPoints") or []
    labels = tuple(
        str(point.get("label") or point.get("id") or number + 1)
        for number, point in enumerate(listed)
    )
    for point, label in zip(listed, labels, strict=True):
        status = point.get("positionStatus", "defined")
        if status != "defined":
            raise InputError(
                "control points",
                "be placed",
                f"{status} for {label} in {file}",
                "place or delete it",
            )
    points = [
        frame * _three(point["position"], label, file)
        for point, label in zip(listed, labels, strict=True)
    ]
    if kind != "Plane":
        return Markup(kind, np.array(points).reshape(-1, 3), labels)
    origin = next(
        (record[key] for key in ("center", "origin") if record.get(key) is not None), None
    )
    if origin is None and not points:
        raise InputError("a plane", "have an origin", f"none in {file}", "place its points")
    centre = points[0] if origin is None else frame * _three(origin, "its origin", file)
    return Markup(
        kind, centre[None], labels[:1] or ("plane",), _normal(record, points, frame, file)
    )


def _normal(
    record: dict[str, Any],
    points: list[Array],
    frame: Array,
    file: Path,
) -> Array:
    """Return the unit normal of a plane.

    It is the stated normal, else the third axis of its orientation, else the normal of three
    points.
    """
    if record.get("normal") is not None:
        normal = frame * _three(record["normal"], "the normal", file)
    elif record.get("orientation") is not None:
        numbers = np.asarray(record["orientation"], dtype=np.float64)
        # row by row, axes in the columns
        normal = frame * _three(numbers.reshape(-1)[2::3], "the orientation", file)
    elif len(points) == 3:
        normal = np.cross(points[1] - points[0], points[2] - points[0])
    else:
        raise InputError("a plane", "have a normal", f"none in {file}", "save it from 3D Slicer 5")
    length = float(np.linalg.norm(normal))
    if length < 1e-9:
        raise InputError(
            "a plane's normal", "not be zero", f"(0, 0, 0) in {file}", "place its points apart"
        )
    return normal / length


def _point_list(file: Path) -> Markup:
    """Read the points of a .fcsv file.

    If several files were joined to one, the file repeats their head.
    """
    frame: Array | None = None
    columns: tuple[str, ...] = _COLUMNS
    points: list[Array] = []
    labels: list[str] = []
    try:
        lines = file.read_text("utf-8").splitlines()
    except UnicodeDecodeError:
        raise InputError("markups", "be text", f"other data in {file}", "save them again") from None
    for line in lines:
        if line.startswith("#"):
            key, _, value = line.lstrip("# ").partition("=")
            if key.strip() == "CoordinateSystem":
                frame = _frame(value.strip(), file)
            elif key.strip() == "columns":
                columns = tuple(name.strip() for name in value.split(","))
                require_distinct_columns(columns, "markups", file)
            continue
        if not line.strip():
            continue
        if frame is None:
            frame = _frame(None, file)
        row = dict(zip(columns, next(csv.reader([line])), strict=False))
        label = row.get("label") or row.get("id") or str(len(points) + 1)
        points.append(frame * _three([_number(row.get(axis)) for axis in "xyz"], label, file))
        labels.append(label)
    if not points:
        raise InputError("markups", "hold at least one point", f"none in {file}", "save them again")
    return Markup(_POINTS, np.array(points), tuple(labels))


def _number(text: str | None) -> float:
    """Return the number of a cell, NaN if it holds none."""
    try:
        return number_in(text or "")
    except ValueError:
        return float("nan")


def _frame(name: object, file: Path) -> Array:
    if str(name) not in _FRAMES:
        raise InputError(
            "coordinateSystem",
            "be LPS or RAS",
            f"{name or 'none'} in {file}",
            "save it from 3D Slicer",
        )
    return _FRAMES[str(name)]


def _three(value: Any, what: str, file: Path) -> Array:
    numbers = as_vector(value)
    if numbers is None:
        raise InputError(
            "markups", "hold three finite numbers", f"{value!r:.80} for {what} in {file}", "fix it"
        )
    return numbers
