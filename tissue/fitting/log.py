"""Measured log of poses and loads, and checks of its values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, counted
from meshes.base.text_tables import number_or_nan
from tissue.fitting.log_columns import (
    FORCES,
    QUANTITIES,
    ROTATION_VECTOR,
    from_first,
    parsed,
    quantities,
    split_unit,
    suggested,
    the_columns,
)
from tissue.fitting.log_files import (
    CHANNELS,
    QUATERNION,
    TIPS,
    LogColumns,
    refusal,
)
from tissue.fitting.problem import SD_PER_MAD, MeasuredLoads, block_averages, block_ticks
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import motion_of

LARGEST = {"N": 1e5, "Nm": 1e4}
"""Largest plausible loads [N, N m]; a log with larger loads is refused (wrong unit)."""
FARTHEST_M = 10.0
"""Distance from the scene's origin beyond which a tool position is refused [m].

A position beyond this distance has another unit or is damaged. The cut along such a long path would
also take too long to compute.
"""
GAP = 5.0
"""Ratio of a time step to the median time step above which the step is reported as a gap.

A few lost consecutive samples are therefore not reported as a gap.
"""
SHORTEST_PATH_M = 5e-5
"""Extent of a path below which the unit of its positions must be given [m].

A path of 50 mm seems to have this extent if positions in metres are read as millimetres.
"""
SHORTEST_S = 0.5
"""Shortest log whose noise can be estimated [s].

Such a log holds 100 blocks of 5 ms. At least `tissue.fitting.problem.FEWEST` blocks must remain
after gaps are left out.
"""


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """Measured poses of a tool and measured loads on it.

    Attributes
    ----------
    path
        File of the log.
    times_s
        Increasing times of the poses [s], shape (n,).
    tips_m
        Positions of the tool's tip in the scene's frame [m], shape (n, 3).
    quaternions
        Orientations (x, y, z, w), shape (n, 4). None if the log has no orientations.
    load_times_s
        Times of the loads [s], shape (m,).
    loads
        Forces [N] and torques about the tip [N m] on the tool in the scene's frame, shape (m,
        channels). Missing values are NaN.
    channels
        Names of the channels, such as ``force_x_N``.
    notes
        Sentences on findings and assumptions.
    """

    path: Path
    times_s: Array
    tips_m: Array
    quaternions: Array | None
    load_times_s: Array
    loads: Array
    channels: tuple[str, ...]
    notes: tuple[str, ...] = ()

    def averaged(self) -> tuple[MeasuredLoads, int]:
        """Return the loads averaged over blocks, and the number of ticks in a block."""
        duration_s = float(self.load_times_s[-1] - self.load_times_s[0])
        ticks = block_ticks(duration_s, float(np.median(np.diff(self.load_times_s))))
        return block_averages(self.load_times_s, self.loads, self.channels, ticks), ticks

    def quaternions_of(self, scene: Scene) -> Array:
        """Return the orientations, shape (n, 4).

        A log without orientations gets the orientation at the start of the scene's motion.
        """
        if self.quaternions is not None:
            return self.quaternions
        # a log without orientations: the tool keeps the orientation of the scene's motion
        first = motion_of(scene).rotations()[0]
        return np.tile(Rotation.from_matrix(first).as_quat(), (len(self.times_s), 1))


def log_of(path: Path, found: LogColumns, columns: Sequence[str] = ()) -> MeasuredLog:
    """Return a log of a tool's poses and loads, read from the columns of a file.

    `columns` is not needed if the file is the trace of a run. If a trace holds ``model_force`` (the
    force of the tissue) and the force commanded to a device, ``model_force`` is used.

    Parameters
    ----------
    path
        Path of the file, used in messages.
    found
        Columns of the file.
    columns
        ``NAME=COLUMN``, ``NAME=COLUMN:UNIT`` or ``NAME=-COLUMN:UNIT`` for each quantity NAME whose
        column has a different name. A minus reverses the sign. If UNIT is not given, the unit is
        taken from the header of the column, or else from NAME. ``NAME=NUMBER`` gives a constant,
        and ``time_s=RATE:Hz`` gives a rate in place of times.

    Raises
    ------
    InputError
        If a column is missing or holds impossible values, if times do not increase, or if the log
        is too short.
    """
    asked = parsed(columns, tuple(QUANTITIES))
    notes = list(found.notes)
    rate_Hz = found.rate_Hz
    number, unit = split_unit(asked.get("time_s", ""))
    if unit == "Hz":
        rate_Hz = number_or_nan(number)
        del asked["time_s"]
    if "model_force_x_N" in found.names:
        for name in CHANNELS:
            # a column that the user has named is kept
            if f"model_{name}" in found.names:
                asked.setdefault(name, f"model_{name}")
        notes.append("forces are those of the model (model_force), before low-pass and device")
    values, unused = quantities(found, asked, QUANTITIES, notes)
    if "time_s" not in values and rate_Hz and TIPS[2] in values:
        if not rate_Hz > 0.0:
            raise InputError(
                "column",
                "give a rate above 0",
                f"time_s={number}:Hz",
                "write for example time_s=500:Hz",
            )
        values["time_s"] = np.arange(len(values[TIPS[2]])) / rate_Hz
        notes.append(f"the times follow from the rate of {rate_Hz:g} Hz")
    # the trace of a run has many columns: the note names the first 12
    if unused:
        others = " and others" if len(unused) > 12 else ""
        notes.append(f"not used: {', '.join(unused[:12])}{others}")
    from_first(values, notes)
    if not any(name in asked and ":" in asked[name] for name in TIPS):
        _require_motion(path, values, asked)
    return _checked(path, values, found.names, notes)


def _require_motion(path: Path, values: Mapping[str, Array], asked: Mapping[str, str]) -> None:
    """Refuse positions that seem to be in metres although their name states millimetres."""
    spans = [float(np.ptp(values[name])) for name in TIPS if len(values.get(name, ()))]
    span_m = max(spans, default=0.0)
    if 0.0 < span_m < SHORTEST_PATH_M:
        flags = " ".join(f"--column '{name}={asked.get(name, name)}:m'" for name in TIPS)
        raise InputError(
            f"measured: the tool in {path.name} moves only {1e3 * span_m:.2g} mm in all, so its "
            f"positions may be in metres. Give their unit by {flags}. If they are in mm, write "
            ":mm instead of :m."
        )


def _checked(
    path: Path, taken: dict[str, Array], names: Sequence[str], notes: list[str]
) -> MeasuredLog:
    """Check the quantities that were read, and return them as a log."""
    refuse = partial(refusal, path)
    wanted = ["time_s", *TIPS]
    if not taken.keys() & set(FORCES):  # one axis of a sensor is enough
        wanted += FORCES
    if missing := [name for name in wanted if name not in taken]:
        if FORCES[0] in missing:
            likely = [name for name in FORCES if "COLUMN" not in suggested([name], names)]
            missing = [name for name in missing if name not in FORCES] + (likely or [FORCES[2]])
        remedy = f"name the columns by {suggested(missing, names)}"
        if "time_s" in missing:
            remedy += ". If the log has no times, give its sampling rate by --column time_s=500:Hz"
        if set(missing) & set(TIPS) and "=0'" not in remedy:
            remedy += (
                ". If the tool does not move along an axis, give a constant, for example by "
                "--column tool_x_mm=0"
            )
        raise refuse(f"have {the_columns(missing)}", the_columns(names[:40]), remedy)
    _merge(taken, notes)
    clocks = {name: taken[name] for name in ("time_s", "load_time_s") if name in taken}
    for name, times_s in clocks.items():
        steps = np.diff(times_s)
        if not (np.isfinite(times_s).all() and (steps > 0.0).all()):
            # rows are counted from 1, and a step ends at the later of its two rows
            line = int(np.argmax(~(steps > 0.0))) + 2
            raise refuse(
                f"have increasing times in {name}",
                f"row {line}, whose time is missing or not later than in the previous row,",
                "sort the rows by time",
            )
        lasts_s = times_s[-1] - times_s[0]
        if lasts_s < SHORTEST_S:
            remedy = (
                "give a longer log, or give the unit of its times, for example by "
                f"--column {name}={name}:ms"
            )
            raise refuse(f"last {SHORTEST_S:g} s or more", f"{lasts_s:.3g} s", remedy)
        usual_s = float(np.median(steps))
        if gaps := int((steps > GAP * usual_s).sum()):
            notes.append(
                f"{counted(gaps, 'gap')} of more than {1e3 * GAP * usual_s:.3g} ms in {name}"
            )
    times_s = taken["time_s"]
    load_times_s = taken.get("load_time_s", times_s)
    channels = tuple(name for name in taken if name in CHANNELS)
    loads = np.column_stack([taken[name] for name in channels])
    tips_m = np.column_stack([taken[name] for name in TIPS])
    if len(tips_m) != len(times_s) or len(loads) != len(load_times_s):
        raise refuse(
            "have one time for each pose and one for each load",
            f"{len(tips_m)} poses at {len(times_s)} times and {len(loads)} loads at "
            f"{len(load_times_s)} times",
            "give the times of the loads in the column load_time_s",
        )
    far = tips_m[~(np.abs(tips_m) < FARTHEST_M)]
    if far.size:
        raise refuse(
            f"have finite positions within {FARTHEST_M:g} m of the scene's origin",
            f"{far[0]:.3g} m",
            "remove damaged rows, or give the unit, for example by --column tool_x_mm=COLUMN:um",
        )
    for channel, values in zip(channels, loads.T, strict=True):
        unit = channel.rpartition("_")[2]
        shown_unit = unit.replace("Nm", "N m")
        largest = float(np.nanmax(np.abs(values), initial=0.0))
        if largest >= LARGEST[unit]:
            raise refuse(
                f"have loads below {LARGEST[unit]:g} {shown_unit} in {channel}",
                f"{largest:.3g} {shown_unit}",
                f"give the unit of the column, for example by --column {channel}=COLUMN:m{unit}",
            )
    loads = without_saturation(loads, channels, notes)
    notes += pose_notes(times_s, tips_m, float(np.median(np.diff(load_times_s))))
    turns = _turns(taken, path)
    return MeasuredLog(path, times_s, tips_m, turns, load_times_s, loads, channels, tuple(notes))


def _merge(taken: dict[str, Array], notes: list[str]) -> None:
    """Average samples with equal times, in place. Of their orientations, the first one is kept."""
    of_loads = "load_time_s" if "load_time_s" in taken else "time_s"
    clocks: dict[str, list[str]] = {"time_s": [], of_loads: []}
    for name in taken:
        clocks[of_loads if name in (*CHANNELS, of_loads) else "time_s"].append(name)
    for clock, names in clocks.items():
        times_s = taken.get(clock, np.zeros(0))
        starts = np.flatnonzero(np.diff(times_s, prepend=-np.inf) != 0.0)
        equal = len(times_s) - len(starts)
        if not equal or any(len(taken[name]) != len(times_s) for name in names):
            continue
        counts = np.diff(np.append(starts, len(times_s)))
        for name in names:
            if name in (*TIPS, *CHANNELS):
                taken[name] = np.add.reduceat(taken[name], starts) / counts
            else:
                taken[name] = taken[name][starts]
        notes.append(
            f"{counted(equal, 'sample')} with the time of the previous sample are averaged"
        )


def _turns(taken: Mapping[str, Array], path: Path) -> Array | None:
    """Return orientations as quaternions, shape (n, 4), or None for a log without orientations."""
    if taken.keys() >= set(QUATERNION):
        quaternions = np.column_stack([taken[name] for name in QUATERNION])
        sizes = np.linalg.norm(quaternions, axis=1, keepdims=True)
        # a shorter quaternion is a zero with rounding, and has no direction
        if not (sizes > 1e-6).all():
            raise refusal(path, "contain unit quaternions", "a zero quaternion", "remove its row")
        return quaternions / sizes
    if taken.keys() >= set(ROTATION_VECTOR):
        vectors = np.column_stack([taken[name] for name in ROTATION_VECTOR])
        return Rotation.from_rotvec(vectors).as_quat()
    return None


PLATEAU = 10
"""Number of consecutive samples at an extreme value that indicates a saturated sensor.

In a channel with noise, so many equal consecutive samples are unlikely.
"""
SHARPER = 5
"""Smallest ratio of a saturated plateau's length to the length of its longer neighbour.

The peak of a signal with coarse steps stays below this ratio.
"""
ROUGH = 0.05
"""Share of samples with a reversal of direction, above which a channel counts as noisy.

A smoother channel has no noise, and may rest at any value without saturation.
"""
BASELINE = 0.5
"""Share of the largest load below which an extreme value counts as a load without contact.

An extreme value is the smallest or the largest value of a channel. Below this limit, an extreme
value is not taken for the end of the sensor's range.
"""
SLOWER = 5.0
"""Ratio of the pose interval to the load interval above which poses are reported as too slow.

The shape of the path between two poses then affects the loads.

With loads at 1 kHz, a block of 5 ms then holds less than one pose.
"""
CORNER_M = 2e-5
"""Accepted error of a straight line between two poses [m]: half an optical tracker's noise."""
SPEED_S = 0.1
"""Time over which the speed of a tool is computed [s]."""


def without_saturation(loads: Array, channels: Sequence[str], notes: list[str]) -> Array:
    """Return the loads with NaN in place of saturated values, and add sentences to `notes`.

    Parameters
    ----------
    loads
        Loads [N, N m], shape (m, channels), NaN where missing.
    channels
        Names of the channels.
    notes
        List to which a sentence on each saturated channel is appended.
    """
    kept = loads.copy()
    for at, name in enumerate(channels):
        unit = name.rpartition("_")[2].replace("Nm", "N m")
        for extreme in _saturated(loads[:, at]):
            full = loads[:, at] == extreme
            kept[full, at] = np.nan
            samples = counted(int(full.sum()), "sample")
            notes.append(f"{samples} of {name} at {extreme:.4g} {unit} left out: saturated")
    return kept


def _saturated(values: Array) -> list[float]:
    """Return the extreme values at which a channel rests so long that the sensor is saturated."""
    known = values[np.isfinite(values)]
    # too short for any plateau
    if len(known) < PLATEAU:
        return []
    turns = np.diff(known)
    # a signal without noise may rest at its extreme without saturation, see `ROUGH`
    if np.mean(turns[1:] * turns[:-1] < 0.0) < ROUGH:
        return []
    starts = np.flatnonzero(np.append(True, turns != 0.0))
    lengths = np.diff(np.append(starts, len(known)))
    around = np.concatenate([[1], lengths, [1]])
    neighbours = np.maximum(around[:-2], around[2:])
    long = (lengths >= PLATEAU) & (lengths >= SHARPER * neighbours)
    plateaus = set(known[starts[long]].tolist())
    largest = float(np.abs(known).max())
    ends = {float(known.min()), float(known.max())}
    return sorted(each for each in ends & plateaus if abs(each) >= BASELINE * largest > 0.0)


def pose_notes(times_s: Array, tips_m: Array, load_period_s: float) -> list[str]:
    """Return sentences on noise in the poses, and on poses sampled too slowly for the loads.

    Parameters
    ----------
    times_s, tips_m
        Times [s], shape (n,), and tips [m], shape (n, 3).
    load_period_s
        Time between two loads [s].
    """
    moved = np.any(np.diff(tips_m, axis=0) != 0.0, axis=1)
    new: Ints = np.flatnonzero(np.append(True, moved))
    # a tool that hardly moves needs no path between its poses
    if len(new) < PLATEAU:
        return []
    times_s = times_s[new]
    tips_m = tips_m[new]
    period_s = float(np.median(np.diff(times_s)))
    notes = []
    # a curve with the second difference d deviates by d / 8 from its chord
    bend_m = float(np.linalg.norm(np.diff(tips_m, 2, axis=0), axis=1).max()) / 8.0
    if period_s > SLOWER * load_period_s and bend_m > CORNER_M:
        notes.append(
            f"poses come every {1e3 * period_s:.3g} ms, loads every {1e3 * load_period_s:.3g} ms. "
            f"The straight path between poses is off by {1e3 * bend_m:.2g} mm at the sharpest "
            "corner. Record poses at a higher rate"
        )
    # third differences of independent noise have sqrt(20) times its standard deviation
    deviations_m = SD_PER_MAD * np.median(np.abs(np.diff(tips_m, 3, axis=0)), axis=0)
    noise_m = float(np.linalg.norm(deviations_m)) / np.sqrt(20.0)
    lag = max(round(SPEED_S / period_s), 1)
    moved_m = np.linalg.norm(tips_m[lag:] - tips_m[:-lag], axis=1)
    fastest_m_s = float((moved_m / (times_s[lag:] - times_s[:-lag])).max(initial=0.0))
    # the difference of two noisy poses has sqrt(2) times the noise of one
    shaken_m_s = np.sqrt(2.0) * noise_m / period_s
    if shaken_m_s > fastest_m_s:
        notes.append(
            f"poses have noise of {1e3 * noise_m:.2g} mm, which gives a speed of "
            f"{1e3 * shaken_m_s:.3g} mm/s between neighbouring poses, but the tool moves at "
            f"{1e3 * fastest_m_s:.3g} mm/s at most. Smooth the poses first"
        )
    return notes
