"""Cut of a tool in bone along given poses, with its result."""

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import ceil
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_direction, require_positive
from meshes.base.hints import suggests_arguments
from meshes.paths.toolpath import arc_length, points_along
from tissue.cutters.cutter import Cutter
from tissue.models.bone.model import BoneModel
from tissue.models.keep_clear import KeepClear, Structure
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import LONGEST_S, frame_along
from tissue.motion.posed import poses_in
from tissue.motion.replay import GivenPoses
from tissue.objects.trace import Trace
from tissue.scene.scene import Output
from tissue.simulation.builders.arguments import surface_of
from tissue.simulation.builders.cutting import VoxelBone, tool_boxes
from tissue.simulation.builders.parts import Parts
from tissue.simulation.loop import Loop, undisturbed
from tissue.simulation.trace import Table, TraceLayout, write_table

if TYPE_CHECKING:
    import pandas
    import pyvista
    import xarray
    from matplotlib.figure import Figure

NAME = re.compile("[a-z0-9][a-z0-9_]*")
"""Pattern of a valid name of a structure that the tool must not touch."""


@dataclass(frozen=True, eq=False)
class TimedPoses:
    """Poses of a tool: times [s], shape (n,), tip positions [m], shape (n, 3), and orientations."""

    times_s: Array
    tips_m: Array
    rotations: Rotation


def cut_along(
    bone: VoxelBone,
    tool: Cutter,
    poses: TimedPoses,
    *,
    shell_spacing_m: float,
    keep_clear: KeepClear | None,
) -> "Cut":
    """Cut a bone along poses; see `tissue.objects.bone.Bone.cut`."""
    tips = poses.tips_m
    turns = poses.rotations
    motion = GivenPoses(poses.times_s, tips, turns)
    boxes = tool_boxes(tool, tips, turns.as_matrix()[:, :, 2], spacing_m=bone.store.grid.spacing_m)
    model, goes_on = bone.under(
        tool, boxes, (tips[0], turns[0].as_matrix()), shell_spacing_m=shell_spacing_m
    )
    before = model.removed_m3
    parts = Parts(motion, model, cutter=tool, keep_clear=keep_clear)
    loop = Loop(parts, ticks=len(tips), output=Output(low_pass_ms=0.0))
    model.limits.restart()
    bone.left_at = None
    loop.place(resume=goes_on)
    with undisturbed():
        for number in range(len(tips)):
            loop.step()
            _require_chips(model, number)
    loop.finish()
    loop.close()
    bone.left_at = tips[-1], turns[-1].as_matrix()
    cut = Cut.of(loop, poses.times_s, removed_before_m3=before)
    cut.notes |= model.limits.exceeded
    warn_of(list(model.limits.exceeded.values()))
    return cut


def warn_of(sentences: Sequence[str]) -> None:
    """Issue a Python warning for each sentence."""
    for sentence in sentences:
        # Level 5 is the caller of `Bone.cut` or `Loop.step`, which have a decorator.
        warnings.warn(sentence, stacklevel=5)


def _require_chips(model: BoneModel, number: int) -> None:
    """Raise an error if a chip was thicker than the tool's radius."""
    thickest_mm = 1e3 * model.limits.thickest_m
    radius_mm = 1e3 * model.cutter.profile.radius_m
    if thickest_mm > radius_mm:
        raise InputError(
            "times_s",
            f"make each tooth's chip thinner than the tool's radius of {radius_mm:.3g} mm",
            f"a chip of {thickest_mm:.3g} mm at pose {number}",
            "use a slower feed or a higher spin_rpm of the tool. The bone is cut up to this pose",
        )


@suggests_arguments
def feed_along(points_mm: ArrayLike, feed_mm_s: float) -> tuple[Array, Array]:
    """Return a tip position and a time for each millisecond of a feed along straight lines.

    Parameters
    ----------
    points_mm
        Corners of the path [mm], shape (k, 3). At least two corners must differ.
    feed_mm_s
        Speed of the tip along the path [mm/s].

    Returns
    -------
    Tip positions [mm], shape (n, 3), and times [s], shape (n,). `Bone.cut` takes both arrays:
    ``bone.cut(burr, *feed_along(points_mm, feed_mm_s=2))``.

    Raises
    ------
    InputError
        If the points or the feed cannot be used, or the path takes longer than an hour.
    """
    corners = np.asarray(points_mm, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 3 or not np.isfinite(corners).all():
        raise InputError(
            "points_mm",
            "be finite numbers of shape (k, 3)",
            f"an array of shape {corners.shape}",
            "give x, y and z of each corner",
        )
    feed = require_positive("feed_mm_s", feed_mm_s, "use about 2")
    if not np.diff(corners, axis=0).any():
        raise InputError(
            "points_mm",
            "contain at least two different points",
            "only one",
            "add the point to which the tool moves",
        )
    duration_s = float(arc_length(corners)[-1]) / feed
    if duration_s > LONGEST_S:
        raise InputError(
            "feed_mm_s",
            f"bring the tool along the path within {LONGEST_S:g} s",
            f"{feed:g}, which takes {duration_s:.4g} s",
            f"use {feed * duration_s / LONGEST_S:.3g} or more",
        )
    # 1e-6 allows for rounding: a duration of whole ticks gets no additional tick.
    whole: Array = TICK_S * np.arange(ceil(duration_s / TICK_S - 1e-6), dtype=np.float64)
    times = np.append(whole, duration_s)  # the last step is shorter: the feed holds to the end
    return points_along(corners, feed * times), times


def poses_of(poses: ArrayLike, axis: ArrayLike | None) -> tuple[Array, Rotation]:
    """Return tip positions [m], shape (n, 3), and orientations from an array of poses.

    Parameters
    ----------
    poses
        As for `tissue.motion.posed.poses_in`.
    axis
        Direction from tip to shank for poses without an orientation; default z.

    Raises
    ------
    InputError
        If the poses cannot be used, or if an axis is given for poses that have an orientation.
    """
    along = require_direction("axis", (0.0, 0.0, 1.0) if axis is None else axis)
    tips, turns = poses_in("poses", poses, frame_along(along))
    if axis is not None and np.shape(poses)[1:] != (3,):
        raise InputError(
            "axis",
            "be left out for poses with rotations",
            "an axis for such poses",
            "remove it, because the rotations contain the axis of the tool",
        )
    return tips, Rotation.from_matrix(turns)


def times_of(times_s: ArrayLike, count: int) -> Array:
    """Validate the times of `count` poses and return the times [s], shape (n,).

    Raises
    ------
    InputError
        If there are fewer than two times, their number differs from the number of poses, or they
        are not finite or do not increase.
    """
    times = np.asarray(times_s, dtype=np.float64)
    problem = ""
    if times.shape != (count,) or count < 2:
        problem = f"times of shape {times.shape} for {count} poses"
    elif not np.isfinite(times).all():
        problem = "times that are not finite"
    elif (np.diff(times) <= 0.0).any():
        problem = "times that do not increase"
    if problem:
        raise InputError(
            "times_s",
            "be increasing times, one for each of at least two poses",
            problem,
            "compute poses and times with feed_along",
        )
    return times


Structures = Mapping[str, Union[str, PathLike[str], "pyvista.PolyData"]]
"""Closed surfaces of structures that a tool must not touch, keyed by name.

Each surface is a file or a pyvista surface, with lengths in millimetres, in the frame of the bone.
"""


def clearance_of(
    structures: Structures | None,
    tool: Cutter,
    *,
    box_m: Array | None = None,
    times_s: Array | None = None,
) -> KeepClear | None:
    """Return an object that measures a tool's distance from structures, if there are any.

    Parameters
    ----------
    box_m, times_s
        As for `tissue.models.keep_clear.KeepClear`.

    Raises
    ------
    InputError
        If a structure's name has characters other than small letters, digits and underscores, or a
        surface cannot be used.
    """
    if not structures:
        return None
    if not isinstance(structures, Mapping):
        raise InputError(
            "keep_clear",
            "be a dictionary of names and surfaces",
            f"an object of type {type(structures).__name__}",
            'use for example {"nerve": "nerve.stl"}',
        )
    found = {}
    for name, surface in structures.items():
        if not NAME.fullmatch(str(name)):
            raise InputError(
                "keep_clear",
                "have names that contain only lower-case letters, digits and underscores",
                f"{name!r}",
                "use a name such as facial_nerve",
            )
        made = surface_of(f"keep_clear[{name}]", surface, 1.0, is_part=True)
        found[name] = Structure(made.vertices_m, made.faces)
    return KeepClear(tool.profile, found, box_m=box_m, times_s=times_s)


@suggests_arguments
class Cut:
    """Result of `Bone.cut`: force, torque and removed volume at every pose.

    The forces act on the tool. The torques are about the tip of the tool.

    Attributes
    ----------
    trace
        All columns, keyed by name, with one row per pose: ``cut.trace["force_z_N"]``.
    notes
        Notes on the cut, keyed by subject; warnings are included.
    pose_us
        Computing time of each pose [µs], shape (n,).
    events
        Events, each with a time [s] and a sentence. An example is an overlap of the tool with one
        of the structures in `keep_clear`.
    """

    def __init__(
        self, trace: Table, pose_us: Array, events: Sequence[tuple[float, str]] = ()
    ) -> None:
        self.trace = Trace(trace)
        self.pose_us = pose_us
        self.events = list(events)
        self.notes: dict[str, str] = {}
        start_mm3 = float(self.trace["removed_mm3"][0])
        if start_mm3 > 0.0:
            self.notes["start"] = (
                f"the first pose lies inside bone: {start_mm3:.3g} mm3 were removed "
                "there without a force; if this is not intended, check the axis, the "
                "unit and the frame of the poses"
            )

    @classmethod
    def of(cls, loop: Loop, times_s: Array, *, removed_before_m3: Array) -> "Cut":
        """Return the result of a loop that has moved a tool through poses at times `times_s`.

        `removed_before_m3` is the volume that was removed before this cut; it is subtracted.
        """
        at = TraceLayout.of(loop.parts.tissue.layer_names).at
        names = [name for name in loop.trace.columns if not name.startswith("model_")]
        places = [loop.trace.columns.index(name) for name in names]
        rows = loop.trace.rows.copy()
        rows[:, at["time"]] = times_s[:, None]
        # The removal of a slow cut is spread over several ticks, so the last row takes the final
        # volume.
        rows[-1, at["removed_by_layer"]] = 1e9 * loop.parts.tissue.removed_m3
        by_layer = rows[:, at["removed_by_layer"]]
        by_layer -= 1e9 * removed_before_m3
        rows[:, at["removed"]] = by_layer.sum(axis=1, keepdims=True)
        trace = Table(tuple(names), rows[:, places], loop.trace.layer_names)
        last = len(times_s) - 1
        events = [
            (float(times_s[min(round(at_s / TICK_S), last)]), what) for at_s, what in loop.events
        ]
        return cls(trace, np.asarray(loop.timing["tick_us"]), events)

    def __len__(self) -> int:
        return len(self.trace.rows)

    @property
    def times_s(self) -> Array:
        """Times of the poses [s], shape (n,)."""
        return np.asarray(self.trace["time_s"])

    @property
    def tip_mm(self) -> Array:
        """Positions of the tool's tip [mm], shape (n, 3)."""
        return self.trace.vectors("tool", "mm")

    @property
    def force_N(self) -> Array:
        """Force on the tool [N], shape (n, 3).

        The force is 0 at the first pose, where the tool is at rest.
        """
        return self.trace.vectors("force", "N")

    @property
    def force_magnitude_N(self) -> Array:
        """Magnitude of the force [N], shape (n,)."""
        return np.linalg.norm(self.force_N, axis=1)

    @property
    def torque_Nm(self) -> Array:
        """Torque about the tip [N m], shape (n, 3)."""
        return self.trace.vectors("torque", "Nm")

    @property
    def removed_mm3(self) -> Array:
        """Volume that this cut has removed up to each pose [mm3], shape (n,)."""
        return np.asarray(self.trace["removed_mm3"])

    def distance_mm(self, name: str) -> Array:
        """Return the distance of the tool from a structure in `keep_clear` [mm], shape (n,).

        The distance is negative where tool and structure overlap.

        Raises
        ------
        InputError
            If no structure of this name was given.
        """
        column = f"distance_{name}_mm"
        if column not in self.trace.columns:
            raise InputError(
                "name",
                "be a structure of keep_clear",
                name,
                "add this structure to keep_clear of Bone.cut",
            )
        return np.asarray(self.trace[column])

    @property
    def layer(self) -> NDArray[np.str_]:
        """Name of the layer that has the largest area in contact with the tool, for each pose.

        The result has shape (n,), with the name "none" at poses without contact.
        """
        return np.asarray(self.trace["layer"])

    def to_pandas(self) -> "pandas.DataFrame":
        """Return all columns of `trace` as a table, one row per pose.

        See `tissue.objects.trace.Trace.to_pandas`.
        """
        return self.trace.to_pandas()

    def to_xarray(self) -> "xarray.Dataset":
        """Return all columns of `trace` over time; see `tissue.objects.trace.Trace.to_xarray`."""
        return self.trace.to_xarray()

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write all columns of `trace` to a file; the suffix of its name selects the format.

        The suffixes are .csv, .mat (MATLAB), .npz, .parquet and .h5.

        Raises
        ------
        InputError
            If the suffix is unknown, the package that writes the format is not installed, or the
            file exists and `overwrite` is not set.
        """
        return saved_table(self.trace, path, overwrite=overwrite)

    def plot(self, *, over: "Figure | None" = None, label: str | None = None) -> "Figure":
        """Draw force and torque over time, in two panels.

        Without `label`, each panel shows the three components and the magnitude. With `label`, each
        panel shows only the magnitude, so that several cuts can be compared.

        Parameters
        ----------
        over
            Figure returned by an earlier call of `plot`. The curves of this cut are added to it:
            ``b.plot(over=a.plot(label="a"), label="b")``.
        label
            Name of this cut in the legend.
        """
        from tissue.objects.plots import new_panels
        from tissue.show.figures.figure import COMPONENTS

        panels = new_panels(2) if over is None else over.axes
        shown = (self.force_N, "force / N"), (self.torque_Nm, "torque / N m")
        for panel, (values, what) in zip(panels, shown, strict=True):
            if label is None:
                for axis, column, colour in zip("xyz", values.T, COMPONENTS, strict=True):
                    panel.plot(self.times_s, column, color=colour, linewidth=1.0, label=axis)
            look = {"color": "0.2", "label": "size"} if label is None else {"label": label}
            panel.plot(self.times_s, np.linalg.norm(values, axis=1), linewidth=1.0, **look)
            panel.set_ylabel(what)
        panels[0].legend(ncols=4, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        panels[-1].set_xlabel("time / s")
        chart: Any = panels[0].figure
        return chart

    def __repr__(self) -> str:
        force = self.force_magnitude_N
        return (
            f"Cut({len(self)} poses in {self.times_s[-1] - self.times_s[0]:.4g} s, "
            f"{self.removed_mm3[-1]:.4g} mm3 "
            f"removed, peak force {force.max():.3g} N, {np.median(self.pose_us):.0f} us a pose"
            f"{''.join(f'; {note}' for note in self.notes.values())})"
        )


def saved_table(trace: Table, path: str | Path, *, overwrite: bool) -> Path:
    """Write a table to a file in the format of the suffix, and return the path of the file.

    Raises
    ------
    InputError
        If the suffix is unknown, the package that writes the format is not installed, or the file
        exists and `overwrite` is not set.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise InputError("path", "not exist", path, "choose another path, or pass overwrite=True")
    write_table(trace, path)
    return path
