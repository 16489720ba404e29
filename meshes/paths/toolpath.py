"""Tool paths from files, in a patient frame, and their depth below a bone's surface.

A path is read from a CSV table, a curve of 3D Slicer, or G-code (see `meshes.paths.gcode`).

A path can be converted to a replay table, which the simulation uses to move the tool along the
path. The table contains times, and positions and orientations of the tool in the site's frame.
"""

import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, enumerated, require_file, require_positive
from meshes.base.tables import decoded_text, read_table
from meshes.base.text_tables import require_distinct_columns
from meshes.base.units import UNITS, column_of, name_of, unit_of
from meshes.base.whole_file import write_rows
from meshes.paths.gcode import read_gcode
from meshes.surfaces.markups import TO_LPS, read_curve
from meshes.surfaces.site import Site
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import inside_scattered, triangle_distance


def arc_length(corners: ArrayLike) -> Array:
    """Compute the path length, shape (n,), from the first corner to each corner.

    The argument `corners` has the shape (n, 3). The lengths have the unit of the corners.
    """
    return np.concatenate(
        [[0.0], np.cumsum(np.linalg.norm(np.diff(np.asarray(corners), axis=0), axis=1))]
    )


def points_along(corners: ArrayLike, lengths: ArrayLike) -> Array:
    """Return points, shape (m, 3), at given path lengths from the first corner.

    A length below 0 gives the start of the path. A length beyond the path gives the end.
    """
    along = arc_length(corners)
    given = np.asarray(corners)
    at = np.asarray(lengths, dtype=np.float64)
    return np.column_stack([np.interp(at, along, given[:, axis]) for axis in range(3)])


def path_distance(points: Array, corners: Array) -> Array:
    """Return the distance, shape (n,), of each point from a path of straight legs.

    The legs connect consecutive corners. `points` has the shape (n, 3) and `corners` the shape (m,
    3). Points, corners and distances have the same unit.
    """
    nearest = np.full(len(points), np.inf)
    for start, end in pairwise(corners):
        leg = end - start
        # a leg without length is its start
        along = np.clip((points - start) @ leg / max(float(leg @ leg), 1e-300), 0.0, 1.0)
        nearest = np.minimum(nearest, np.linalg.norm(points - start - along[:, None] * leg, axis=1))
    return nearest


def kept_corners(corners: ArrayLike, within: float) -> Ints:
    """Simplify a polyline: return the ascending indices of the corners to keep.

    The distance of each removed corner from the polyline through the kept corners is at most
    `within` (Douglas and Peucker 1973).

    Parameters
    ----------
    corners
        Corners of the polyline, shape (n, 3).
    within
        Largest allowed distance of a removed corner from the simplified polyline, in the unit of
        the corners.
    """
    given = np.asarray(corners, dtype=np.float64)
    kept = {0, len(given) - 1}
    open_legs = [(0, len(given) - 1)]
    while open_legs:
        first, last = open_legs.pop()
        if last - first < 2:
            continue
        # A closed section has the length 0. The distance of its corners is then measured from the
        # first corner.
        off = path_distance(given[first + 1 : last], given[[first, last]])
        if off.max() > within:
            farthest = first + 1 + int(np.argmax(off))
            kept.add(farthest)
            open_legs += [(first, farthest), (farthest, last)]
    return np.array(sorted(kept), dtype=np.int64)


GCODE = (".gcode", ".nc", ".ngc", ".tap", ".cnc", ".gc", ".mpf")
_PROGRAM = re.compile(r"^\s*(N\d+\s*)?G0?\d\b", re.IGNORECASE | re.MULTILINE)
"""Regular expression for a G-code line.

It identifies G-code in files whose suffix is also used for tables.
"""
TABLES = (".csv", ".txt", ".tsv")
_PLACE = ("x_mm", "y_mm", "z_mm")
_FEED = "feed_mm_s"
_AXIS = ("axis_x", "axis_y", "axis_z")
_COLUMNS = {**dict.fromkeys(_PLACE, "length"), _FEED: "speed", **dict.fromkeys(_AXIS, "number")}
"""Dictionary from each column of a table to the physical quantity of the column."""

_STEP_MM = 0.5
"""Distance [mm] between the path points at which the depth below the surface is evaluated.

Between two points, the depth is therefore at most 0.25 mm larger than at the deeper point.
"""
_MOST_POINTS = 20_000
"""Largest number of points at which the depth is evaluated.

On longer paths, the distance between points is increased.
"""


@dataclass(frozen=True, eq=False)
class Toolpath:
    """Tool path: points that a tool's tip visits along straight lines.

    Attributes
    ----------
    points_mm
        Points [mm, LPS], shape (n, 3).
    feeds_mm_s
        Speed [mm/s] of the move to each point, shape (n,). The speed of a rapid move is NaN. The
        attribute is None if the file does not state speeds. The first speed is not used.
    axes
        Unit vectors from the tip towards the shaft at each point, LPS, shape (n, 3); None if the
        file does not state axes.
    notes
        Findings and assumptions, in sentences.
    """

    points_mm: Array
    feeds_mm_s: Array | None = None
    axes: Array | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class PathDepth:
    """Depth of the points along a path below the bone's surface.

    Attributes
    ----------
    points_mm
        Points [mm, LPS], shape (n, 3): the points of the path, and intermediate points. Neighbours
        are at most 0.5 mm apart, or farther on a path longer than 10 m.
    depth_mm
        Distance [mm], shape (n,), of each point from the bone's surface, positive inside the bone
        and negative outside.
    """

    points_mm: Array
    depth_mm: Array

    @property
    def deepest_mm(self) -> float:
        """Largest depth [mm]. It is negative if the path never enters the bone."""
        return float(self.depth_mm.max())

    @property
    def share_inside(self) -> float:
        """Share of the path's points that lie in the bone."""
        return float((self.depth_mm > 0.0).mean())


def depth_along(path: Toolpath, surface: Surface) -> PathDepth:
    """Compute the depth of a path below the surface of the uncut bone."""
    corners = path.points_mm
    length = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    step = max(_STEP_MM, float(length.sum()) / _MOST_POINTS)
    counts = np.maximum(np.ceil(length / step), 1.0).astype(int).tolist()
    moves = zip(corners[:-1], corners[1:], counts, strict=True)
    parts = [np.linspace(first, last, count, endpoint=False) for first, last, count in moves]
    points = np.vstack([*parts, corners[-1:]])
    distance = np.abs(triangle_distance(surface.vertices_m, surface.faces, 1e-3 * points))
    inside = inside_scattered(surface.vertices_m, surface.faces, 1e-3 * points)
    return PathDepth(points, 1e3 * np.where(inside, distance, -distance))


def read_toolpath(path: str | Path, coordinates: str) -> Toolpath:
    """Read a tool path from a file.

    Parameters
    ----------
    path
        Text table, markups of 3D Slicer (``.mrk.json``, ``.fcsv``) or G-code. A table (.csv, .txt,
        .tsv) has the columns x_mm, y_mm, z_mm and, optionally, feed_mm_s and axis_x, axis_y,
        axis_z. Its header may state other units, such as "X [m]".
    coordinates
        ``LPS`` or ``RAS``: frame of the coordinates in tables and G-code. Markups files contain
        their own frame.

    Raises
    ------
    InputError
        If the file cannot be read, has fewer than two points, or contains a number that is not
        finite, a feed that is not positive, or a zero axis.
    """
    file = Path(path)
    if coordinates not in TO_LPS:
        raise InputError(
            "coordinates",
            "be LPS or RAS",
            coordinates,
            "write LPS or RAS in capital letters, according to the file",
        )
    require_file(file, "a path")
    suffix = file.suffix.lower()
    if suffix in (".json", ".fcsv"):
        note = "the control points of the curve are joined by straight lines"
        return Toolpath(read_curve(file), notes=(note,))
    if suffix not in (*TABLES, *GCODE):
        raise InputError(
            "path",
            f"be a {', '.join(TABLES)}, .mrk.json or .fcsv file, or a file of G-code "
            f"({enumerated(GCODE, 'or')})",
            file,
            "rename or convert the file",
        )
    feeds: Array | None
    axes: Array | None = None
    if suffix in GCODE or (suffix == ".txt" and _PROGRAM.search(decoded_text(file, "path"))):
        points, feeds, notes = read_gcode(file)
    else:
        points, feeds, axes, notes = _read_table(file)
    if len(points) < 2:
        raise InputError(
            "path", "have at least two points", f"{len(points)} in {file}", "add points to the file"
        )
    frame = TO_LPS[coordinates]
    return Toolpath(points * frame, feeds, None if axes is None else axes * frame, notes)


def _read_table(file: Path) -> tuple[Array, Array | None, Array | None, tuple[str, ...]]:
    """Return points, speeds, axes and notes of a text table, as in `Toolpath` but not in LPS."""
    table = read_table(file, "path")
    require_distinct_columns(table.names, "path", file)
    notes = [*table.notes]
    column: dict[str, Array] = {}
    used = set[str]()
    for name, measure in _COLUMNS.items():
        header = column_of(name, measure, table.names)
        if header is None and name in _PLACE:
            bare = [each for each in table.names if name_of(each, "length") == name[0]]
            header = bare[0] if len(bare) == 1 else None
        if header is None:
            continue
        used.add(header)
        column[name] = table.finite(header)
        unit = unit_of(header, measure)
        if measure != "number":
            # convert lengths to mm, and speeds to mm/s
            column[name] = column[name] * (1e3 * UNITS[measure][unit] if unit else 1.0)
        if measure == "length" and unit != "mm":
            notes.append(f"{header} is read in {unit or 'mm, since its header names no unit'}")
    has_axes = not column.keys().isdisjoint(_AXIS)
    if missing := [each for each in (*_PLACE, *_AXIS[: 3 * has_axes]) if each not in column]:
        raise InputError(
            "path",
            f"have the column{'s' * (len(missing) > 1)} {enumerated(missing)}",
            f"the columns {enumerated(table.names[:40])} in {file}",
            "rename the columns, and write another unit as in x_m or X [in]",
        )
    if left := [each for each in table.names if each not in used]:
        notes.append(f"columns without a use: {', '.join(left[:12])}")
    feeds = column.get(_FEED)
    if feeds is not None and (feeds[1:] <= 0.0).any():
        row = 1 + int(np.argmax(feeds[1:] <= 0.0))
        got = f"{feeds[row]:g} at point {row + 1} of {file}"
        raise InputError(_FEED, "be positive", got, "use for example 2")
    axes: Array | None = None
    if has_axes:
        given = np.column_stack([column[name] for name in _AXIS])
        length = np.linalg.norm(given, axis=1)
        # In a file with six decimals, such an axis is zero. Its direction would only be rounding
        # errors.
        if (length < 1e-6).any():
            got = f"(0, 0, 0) at point {int(np.argmin(length)) + 1} of {file}"
            raise InputError("axis", "not be zero", got, "fix this point of the file")
        axes = given / length[:, None]
    points = np.column_stack([column[name] for name in _PLACE])
    return points, feeds, axes, tuple(notes)


POSE_COLUMNS = ("tool_x_mm", "tool_y_mm", "tool_z_mm", "tool_qx", "tool_qy", "tool_qz", "tool_qw")
_RAPID_MM_S = 20.0
"""Speed of rapid moves and of the approach to the first point [mm/s].

For comparison, cutting moves have about 2 mm/s.
"""
_TURN_RAD_S = 0.5 * np.pi
"""Largest angular velocity of the tool [rad/s].

A person turns a drill by a right angle in about a second.
"""
_SAME_MM = 1e-6
_SAME_RAD = 1e-6
"""Smallest rotation [rad], or motion `_SAME_MM` [mm], for which a replay table gets a new row.

The times of a replay table must increase, and a motion of zero length takes no time.
"""


@dataclass(frozen=True, eq=False)
class ReplayTable:
    """Poses in the site's frame at increasing times.

    Attributes
    ----------
    times_s
        Times [s], shape (n,). The first time is 0.
    tips_mm
        Positions of the tool's tip [mm], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4); (0, 0, 0, 1) points the tool along -z.
    """

    times_s: Array
    tips_mm: Array
    quaternions: Array

    def write(self, path: Path) -> None:
        """Write the CSV that ``motion.kind = "replay"`` reads."""
        rows = zip(self.times_s, self.tips_mm, self.quaternions, strict=True)
        texts = (
            [f"{time_s:.6f}", *(f"{each:.6f}" for each in tip), *(f"{each:.9f}" for each in turn)]
            for time_s, tip, turn in rows
        )
        write_rows(path, [("time_s", *POSE_COLUMNS), *texts])


def to_replay(
    path: Toolpath,
    site: Site,
    *,
    feed_mm_s: float,
    clearance_mm: float = 0.0,
) -> ReplayTable:
    """Convert a path to a replay table: timed poses in a site's frame.

    Parameters
    ----------
    path
        Path, in the same frame as the site.
    site
        Site that defines the scene's frame.
    feed_mm_s
        Speed [mm/s] in the parts of the path for which the file states no speed.
    clearance_mm
        Distance [mm] along the tool's axis between the start of the motion and the first point.

    Raises
    ------
    InputError
        If a speed is not positive, the clearance is negative, or all points are equal.
    """
    from scipy.spatial.transform import Rotation

    feed = require_positive("feed_mm_s", feed_mm_s, "use for example 2")
    if not clearance_mm >= 0.0:
        raise InputError("clearance_mm", "be at least 0", clearance_mm, "use for example 5")
    tips = 1e3 * site.to_site(1e-3 * path.points_mm)
    axes = (
        np.tile([0.0, 0.0, 1.0], (len(tips), 1)) if path.axes is None else path.axes @ site.rotation
    )
    given = np.full(len(tips), feed) if path.feeds_mm_s is None else path.feeds_mm_s
    speeds = np.where(np.isnan(given), _RAPID_MM_S, given)
    if clearance_mm > 0.0:
        tips = np.vstack([tips[0] + clearance_mm * axes[0], tips])
        axes = np.vstack([axes[:1], axes])
        speeds = np.concatenate([[_RAPID_MM_S, _RAPID_MM_S], speeds[1:]])
    length = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    turn = np.arccos(np.clip(np.einsum("ij,ij->i", axes[1:], axes[:-1]), -1.0, 1.0))
    moved = np.concatenate([[True], (length > _SAME_MM) | (turn > _SAME_RAD)])
    if moved.sum() < 2:
        raise InputError(
            "path", "have at least two different points", "only one", "add another point"
        )
    lasting = np.maximum(length / speeds[1:], turn / _TURN_RAD_S)
    times = np.concatenate([[0.0], np.cumsum(lasting)])
    # The shortest rotation that turns z to the axis of the tool.
    turns = Rotation.concatenate(
        [Rotation.align_vectors(axis, (0.0, 0.0, 1.0))[0] for axis in axes[moved]]
    )
    return ReplayTable(times[moved], tips[moved], turns.as_quat())
