"""A measured log of poses and loads."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from tissue.fitting.columns import QUANTITIES, ColumnMap, parse_columns
from tissue.fitting.log_files import LogColumns, read_columns
from tissue.models.tissue_model import TICK_S
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import motion_of

__all__ = ["MeasuredLog", "pose_notes", "read_log", "without_saturation"]

GREATEST = {"N": 1e5, "Nm": 1e4}
"""Loads beyond which a log is in another unit [N, N m]."""
FARTHEST_M = 10.0
"""Distance from the scene's origin beyond which a tool position is refused [m].

The position is then in another unit or damaged, and carving along such a jump would not end.
"""
GAP = 5.0
"""Time between two samples, in medians, that is a gap."""
SHORTEST_S = 0.5
"""Shortest log whose noise can be estimated [s]."""


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """Measured poses of a tool and measured loads on it.

    Attributes
    ----------
    path
        File.
    times_s
        Increasing times of the poses [s], shape (n,).
    tips_m
        Tips of the tool in the scene's frame [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4). None if the log has no orientations.
    load_times_s
        Times of the loads [s], shape (m,).
    loads
        Loads on the tool in the scene's frame [N, N m], torques about the tip, shape (m, channels);
        NaN where missing.
    channels
        Names of the channels, such as ``force_x_N``.
    notes
        Findings and assumptions, in sentences.
    """

    path: Path
    times_s: Array
    tips_m: Array
    quaternions: Array | None
    load_times_s: Array
    loads: Array
    channels: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def load_period_s(self) -> float:
        """Time between two samples of the loads [s]."""
        return float(np.median(np.diff(self.load_times_s)))

    def quaternions_of(self, scene: Scene) -> Array:
        """Return the orientations, shape (n, 4).

        A log without orientations gets the orientation at the start of the scene's motion.
        """
        if self.quaternions is not None:
            return self.quaternions
        first = motion_of(scene, step_s=TICK_S).rotations()[0]
        return np.tile(Rotation.from_matrix(first).as_quat(), (len(self.times_s), 1))


def read_log(path: Path, columns: Sequence[str] = ()) -> MeasuredLog:
    """Read a log of a tool's poses and loads.

    Parameters
    ----------
    path
        CSV, Parquet, HDF5, .mat or .npz file. For a run's own trace, `columns` is not needed. If a
        trace holds both ``model_force`` (the force of the tissue) and the force commanded to a
        device, ``model_force`` is used.
    columns
        ``NAME=COLUMN[:UNIT]`` for quantities with another name, see
        `tissue.fitting.columns.parse_column`.

    Raises
    ------
    InputError
        If a column is missing or holds impossible values, times do not increase, or the log is too
        short.
    """
    maps = parse_columns(columns)
    found = read_columns(path)
    notes = []
    if "model_force_x_N" in found.names:
        for name in QUANTITIES:
            if (
                name.startswith(("force_", "torque_"))
                and name not in maps
                and f"model_{name}" in found.names
            ):
                maps[name] = ColumnMap(QUANTITIES[name], f"model_{name}")
        notes.append("forces are those of the model (model_force), before low-pass and device")
    taken, remarks = found.taken(maps, QUANTITIES)
    notes += remarks
    return _checked(path, taken, found, notes)


def _checked(
    path: Path, taken: dict[str, Array], found: LogColumns, notes: list[str]
) -> MeasuredLog:
    """Return a checked log of the columns that were read."""
    wanted = ["time_s", *(f"tool_{c}_mm" for c in "xyz")]
    forces = [f"force_{c}_N" for c in "xyz"]
    wanted += forces if not taken.keys() & set(forces) else []  # one axis of a sensor is enough
    if missing := [name for name in wanted if name not in taken]:
        have = ", ".join(found.names[:40])
        raise InputError(
            "measured",
            f"hold {', '.join(missing)}",
            f"{path.name} with {have}",
            f"name the log's own columns by --column {missing[0]}=COLUMN[:UNIT]",
        )
    times_s = _increasing(taken["time_s"], "time_s", path, notes)
    load_times_s = taken.get("load_time_s")
    load_times_s = (
        times_s if load_times_s is None else _increasing(load_times_s, "load_time_s", path, notes)
    )
    channels = tuple(name for name in taken if name.startswith(("force_", "torque_")))
    loads = np.column_stack([taken[name] for name in channels])
    tips_m = np.column_stack([taken[f"tool_{c}_mm"] for c in "xyz"])
    if len(tips_m) != len(times_s) or len(loads) != len(load_times_s):
        raise InputError(
            "measured",
            "hold a pose and a load at each of its times",
            (
                f"{len(tips_m)} poses and {len(loads)} loads at {len(times_s)} and "
                f"{len(load_times_s)} times in {path.name}"
            ),
            "name the times of the loads load_time_s",
        )
    if not np.isfinite(tips_m).all():
        raise InputError(
            "measured",
            "hold finite positions",
            f"one that is not in {path.name}",
            "leave its row out",
        )
    if (farthest := float(np.abs(tips_m).max())) >= FARTHEST_M:
        raise InputError(
            "measured",
            f"hold positions within {FARTHEST_M:g} m of the scene's origin",
            f"{farthest:.3g} m in {path.name}",
            "leave damaged rows out, or give the unit, --column tool_x_mm=COLUMN:um for example",
        )
    for name, values in zip(channels, loads.T, strict=True):
        most = GREATEST[name.rpartition("_")[2]]
        if (greatest := float(np.nanmax(np.abs(values), initial=0.0))) >= most:
            raise InputError(
                "measured",
                f"hold loads below {most:g} in {name}",
                f"{greatest:.3g} in {path.name}",
                (
                    "give its unit, --column "
                    f"{name}=COLUMN:{('mN' if name.endswith('_N') else 'mNm')} for example"
                ),
            )
    loads, remarks = without_saturation(loads, channels)
    notes += remarks + pose_notes(times_s, tips_m, float(np.median(np.diff(load_times_s))))
    return MeasuredLog(
        path, times_s, tips_m, _turns(taken, path), load_times_s, loads, channels, tuple(notes)
    )


def _increasing(times_s: Array, name: str, path: Path, notes: list[str]) -> Array:
    """Return increasing times and note gaps."""
    steps = np.diff(times_s)
    if not np.isfinite(times_s).all() or not (steps > 0.0).all():
        line = 0 if not np.isfinite(times_s).all() else int(np.argmin(steps)) + 2
        raise InputError(
            "measured",
            "hold times that increase",
            f"{name} that does not in row {line} of {path.name}",
            "sort it",
        )
    if times_s[-1] - times_s[0] < SHORTEST_S:
        raise InputError(
            "measured",
            f"last {SHORTEST_S:g} s or more",
            f"{times_s[-1] - times_s[0]:.3g} s in {path.name}",
            f"give a longer log, or the unit of its times by --column {name}={name}:ms",
        )
    rate = float(np.median(steps))
    if gaps := int((steps > GAP * rate).sum()):
        notes.append(f"{counted(gaps, 'gap')} of more than {1e3 * GAP * rate:.3g} ms in {name}")
    return times_s


def _turns(taken: dict[str, Array], path: Path) -> Array | None:
    """Return orientations as quaternions, shape (n, 4), or None for a log without orientations."""
    quaternion = [f"tool_q{c}" for c in "xyzw"]
    if all(name in taken for name in quaternion):
        found = np.column_stack([taken[name] for name in quaternion])
        size = np.linalg.norm(found, axis=1)
        if not (size > 1e-6).all():
            raise InputError(
                "measured",
                "hold unit quaternions",
                f"a zero one in {path.name}",
                "use 0, 0, 0, 1 there",
            )
        return np.asarray(found / size[:, None])
    vector = [f"tool_r{c}_rad" for c in "xyz"]
    if all(name in taken for name in vector):
        return np.asarray(
            Rotation.from_rotvec(np.column_stack([taken[name] for name in vector])).as_quat()
        )
    return None


PLATEAU = 10
"""Consecutive samples at a channel's extreme from which a sensor counts as saturated."""
SHARPER = 5
"""Length of a row of equal values over the lengths of the rows before and after it.

A peak in a signal with coarse steps stays below this ratio.
"""
ROUGH = 0.05
"""Share of samples at which a measured channel reverses its direction.

A smoother channel has no noise and may rest at any value.
"""
BASELINE = 0.5
"""Share of the largest load below which an extreme value counts as a tool without contact.

Such an extreme is not the end of a sensor's range.
"""
SLOWER = 5.0
"""Ratio of the pose interval to the load interval from which the path between poses matters."""
CORNER_M = 2e-5
"""Largest error of a straight line between two poses [m], half the noise of an optical tracker."""
SPEED_S = 0.1
"""Time over which the speed of a tool is computed [s]."""


def without_saturation(loads: Array, channels: tuple[str, ...]) -> tuple[Array, list[str]]:
    """Return loads without saturated values, shape (m, channels), and remarks.

    The remarks are sentences on saturation and on coarse steps.

    Parameters
    ----------
    loads
        Loads [N, N m], shape (m, channels), NaN where missing.
    channels
        Their names.
    """
    kept = loads.copy()
    notes = []
    for at, name in enumerate(channels):
        values = loads[:, at]
        unit = name.rpartition("_")[2].replace("Nm", "N m")
        for extreme in _saturated(values):
            full = values == extreme
            kept[full, at] = np.nan
            notes.append(
                f"{counted(int(full.sum()), 'sample')} of {name} at {extreme:.4g} {unit} "
                "left out: saturated"
            )
        if (step := _coarse_step(values)) > 0.0:
            notes.append(
                f"{name} comes in steps of {step:.3g} {unit}, coarser than its noise: their "
                "error of "
                f"{step / np.sqrt(12.0):.2g} {unit} is part of the noise that is fitted"
            )
    return kept, notes


def pose_notes(times_s: Array, tips_m: Array, load_period_s: float) -> list[str]:
    """Return sentences on poses that are too slow for the loads, and on noise in them.

    Parameters
    ----------
    times_s, tips_m
        Times [s], shape (n,), and tips [m], shape (n, 3).
    load_period_s
        Time between two loads [s].
    """
    new = np.concatenate([[0], np.flatnonzero(np.any(np.diff(tips_m, axis=0) != 0.0, axis=1)) + 1])
    if len(new) < PLATEAU:
        return []
    times_s = times_s[new]
    tips_m = tips_m[new]
    period_s = float(np.median(np.diff(times_s)))
    notes = []
    bend_m = float(np.linalg.norm(np.diff(tips_m, 2, axis=0), axis=1).max()) / 8.0
    noise_m = float(
        np.linalg.norm(1.4826 * np.median(np.abs(np.diff(tips_m, 3, axis=0)), axis=0))
    ) / np.sqrt(20.0)
    if period_s > SLOWER * load_period_s and bend_m > CORNER_M:
        notes.append(
            f"poses come every {1e3 * period_s:.3g} ms, loads every "
            f"{1e3 * load_period_s:.3g} ms: the straight path "
            f"between poses is off by {1e3 * bend_m:.2g} mm at the sharpest corner, log them faster"
        )
    lag = max(round(SPEED_S / period_s), 1)
    moved_m = np.linalg.norm(tips_m[lag:] - tips_m[:-lag], axis=1)
    fastest_m_s = float((moved_m / (times_s[lag:] - times_s[:-lag])).max(initial=0.0))
    if (shaken_m_s := np.sqrt(2.0) * noise_m / period_s) > fastest_m_s:
        notes.append(
            f"poses have noise of {1e3 * noise_m:.2g} mm, which is a speed of "
            f"{1e3 * shaken_m_s:.3g} mm/s from one to "
            f"the next where the tool moves at {1e3 * fastest_m_s:.3g} mm/s at most: smooth "
            "them first"
        )
    return notes


def _saturated(values: Array) -> list[float]:
    """Return the extreme values at which a channel stays, as a saturated sensor does."""
    known = values[np.isfinite(values)]
    if len(known) < PLATEAU:
        return []
    turns = np.diff(known)
    if np.mean(turns[1:] * turns[:-1] < 0.0) < ROUGH:
        return []
    greatest = float(np.abs(known).max())
    starts, lengths = _rows(known)
    found = []
    for extreme in {float(known.min()), float(known.max())}:
        if abs(extreme) < BASELINE * greatest or greatest == 0.0:
            continue
        around = np.concatenate([[1], lengths, [1]])
        neighbours = np.maximum(around[:-2], around[2:])
        long = (known[starts] == extreme) & (lengths >= PLATEAU) & (lengths >= SHARPER * neighbours)
        found += [extreme] if long.any() else []
    return sorted(found)


def _coarse_step(values: Array) -> float:
    """Return the step of a channel if it hides the noise, otherwise 0."""
    known = values[np.isfinite(values)]
    levels = np.unique(known)
    if len(levels) < 3 or np.median(np.abs(np.diff(known))) > 0.0:
        return 0.0
    gaps = np.diff(levels)
    step = float(gaps[gaps > 1e-9 * np.abs(levels).max()].min(initial=np.inf))
    shares = gaps / step
    return step if bool((np.abs(shares - np.round(shares)) < 0.05).all()) else 0.0


def _rows(values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the start indices and the lengths of rows of equal values."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0.0) + 1])
    return starts, np.diff(np.concatenate([starts, [len(values)]]))
