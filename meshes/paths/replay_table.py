"""Conversion of a toolpath to the table of poses that a replayed motion reads.

The table holds times, tips and orientations in the site's frame.
"""

import csv
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from meshes.base.whole_file import whole_file
from meshes.paths.toolpath import Toolpath
from meshes.surfaces.site import Site

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["POSE_COLUMNS", "ReplayTable", "to_replay"]

POSE_COLUMNS = ("tool_x_mm", "tool_y_mm", "tool_z_mm", "tool_qx", "tool_qy", "tool_qz", "tool_qw")
_TURN_RAD_S = 0.5 * np.pi
"""Fastest turn of the tool [rad/s].

A hand turns a drill through a right angle in about a second.
"""
_SAME_MM = 1e-6
_SAME_RAD = 1e-6


@dataclass(frozen=True, eq=False)
class ReplayTable:
    """Poses at increasing times in the site's frame.

    Attributes
    ----------
    times_s
        Times [s] from 0, shape (n,).
    tips_mm
        Tip of the tool [mm], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4); (0, 0, 0, 1) points the tool along -z.
    """

    times_s: Array
    tips_mm: Array
    quaternions: Array

    def write(self, path: Path) -> None:
        """Write the CSV that ``motion.kind = "replay"`` reads."""
        with (
            whole_file(path) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(("time_s", *POSE_COLUMNS))
            for time_s, tip, turn in zip(self.times_s, self.tips_mm, self.quaternions, strict=True):
                writer.writerow(
                    [
                        f"{time_s:.6f}",
                        *(f"{each:.6f}" for each in tip),
                        *(f"{each:.9f}" for each in turn),
                    ]
                )


def to_replay(
    path: Toolpath,
    site: Site,
    *,
    feed_mm_s: float,
    rapid_mm_s: float = 20.0,
    clearance_mm: float = 0.0,
) -> ReplayTable:
    """Bring a path into a site's frame and give it times.

    Parameters
    ----------
    path
        The path in the frame of the file in which the site lies.
    site
        Site that defines the scene's frame.
    feed_mm_s
        Speed where the path states no speed [mm/s].
    rapid_mm_s
        Speed of rapid moves and of the approach [mm/s].
    clearance_mm
        Distance of the start from the first point, along the tool's axis [mm].

    Raises
    ------
    InputError
        If a speed is not positive, the clearance is negative, or all points are one.
    """
    from scipy.spatial.transform import Rotation

    feed = require_positive("feed_mm_s", feed_mm_s, "use for example 2")
    rapid = require_positive("rapid_mm_s", rapid_mm_s, "use for example 20")
    if not clearance_mm >= 0.0:
        raise InputError("clearance_mm", "be at least 0", clearance_mm, "use for example 5")
    tips = 1e3 * site.to_site(1e-3 * path.points_mm)
    axes = (
        np.tile([0.0, 0.0, 1.0], (len(tips), 1)) if path.axes is None else path.axes @ site.rotation
    )
    given = np.full(len(tips), feed) if path.feeds_mm_s is None else path.feeds_mm_s
    speeds = np.where(np.isnan(given), rapid, given)
    if clearance_mm > 0.0:
        tips = np.vstack([tips[0] + clearance_mm * axes[0], tips])
        axes = np.vstack([axes[:1], axes])
        speeds = np.concatenate([[rapid, rapid], speeds[1:]])
    length = np.linalg.norm(np.diff(tips, axis=0), axis=1)
    turn = np.arccos(np.clip(np.einsum("ij,ij->i", axes[1:], axes[:-1]), -1.0, 1.0))
    moved = np.concatenate([[True], (length > _SAME_MM) | (turn > _SAME_RAD)])
    if moved.sum() < 2:
        raise InputError("path", "lead somewhere", "points that are all one", "add another")
    lasting = np.maximum(length / speeds[1:], turn / _TURN_RAD_S)
    times = np.concatenate([[0.0], np.cumsum(lasting)])
    turns = Rotation.concatenate([_towards(axis) for axis in axes[moved]])
    return ReplayTable(times[moved], tips[moved], turns.as_quat())


def _towards(axis: Array) -> "Rotation":
    """Return the shortest turn that brings z to a unit vector."""
    from scipy.spatial.transform import Rotation

    across = np.cross([0.0, 0.0, 1.0], axis)
    sine = float(np.linalg.norm(across))
    if sine < 1e-12:
        return Rotation.from_rotvec([0.0 if axis[2] > 0.0 else np.pi, 0.0, 0.0])
    return Rotation.from_rotvec(across / sine * np.arctan2(sine, axis[2]))
