"""Performance metrics of one trial of a study.

The metrics are force error, latency, smoothness, distance from the target, and alignment of two
paths.
"""

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from meshes.paths.toolpath import path_distance

SPARC_CUTOFF_HZ = 10.0
"""Highest frequency of a movement that SPARC uses (Balasubramanian et al. 2015).

Published values range from 5 to 20 Hz.
"""
SPARC_AMPLITUDE = 0.05
"""Fraction of the peak below which SPARC ignores the spectrum (Balasubramanian et al. 2015)."""
SPARC_PADDING = 4
"""Padding level of SPARC (Balasubramanian et al. 2015).

With level p, zero padding makes the resolution of the spectrum 2^p times as fine.
"""
TREMOR_MM = 0.2
"""Distance [mm] that a resting tool may move because of tremor.

The largest amplitude of a simulated hand's tremor in hands.toml is 0.17 mm (three axes).
"""
POINTS = 800
"""Largest number of samples of each path in the dynamic time warping of two paths.

For longer paths, rows between the samples are interpolated.

Memory and computing time grow with the square of this number.
"""


def force_error(force_N: ArrayLike, ideal_N: ArrayLike) -> float:
    """Compute the normalised L2 error ||F - F_ideal|| / ||F_ideal|| over all ticks and components.

    Parameters
    ----------
    force_N, ideal_N
        Force that the device applied, and ideal force [N], each of shape (ticks,) or (ticks, 3).

    Raises
    ------
    InputError
        If a force is not finite, or the ideal force is zero in all ticks.
    """
    force, ideal = _pair(force_N, ideal_N)
    size = float(np.linalg.norm(ideal))
    if size == 0.0:
        raise InputError(
            "ideal_N", "not be zero in all ticks", "no contact", "use a trial with contact"
        )
    return float(np.linalg.norm(force - ideal)) / size


def excess_error(error: float, least_error: float) -> float:
    """Compute the excess of an error over the smallest possible error.

    The excess is sqrt(error^2 - least_error^2), or 0 if `error` is smaller than `least_error`.
    `least_error` is the error that remains on the same device even with a perfectly computed force.
    Because the squares of independent errors add up, the excess is the part of the error that a
    better force could avoid.
    """
    return float(np.sqrt(max(error**2 - least_error**2, 0.0)))


def force_mae_N(force_N: ArrayLike, ideal_N: ArrayLike) -> float:
    """Return the mean norm [N], over ticks, of the error vector of a force.

    The arguments are the same as for :func:`force_error`.
    """
    force, ideal = _pair(force_N, ideal_N)
    return float(np.linalg.norm(force - ideal, axis=1).mean())


def force_rms_N(force_N: ArrayLike, ideal_N: ArrayLike) -> float:
    """Return the root mean square [N], over ticks, of the norm of a force's error vector.

    The arguments are the same as for :func:`force_error`.
    """
    force, ideal = _pair(force_N, ideal_N)
    return float(np.sqrt(((force - ideal) ** 2).sum(axis=1).mean()))


def latency_ms(
    force_N: ArrayLike, ideal_N: ArrayLike, *, tick_s: float, longest_ms: float = 50.0
) -> float:
    """Compute the lag [ms] of the applied force behind the ideal force.

    The lag is the time shift with the highest correlation of both forces. The correlation is
    computed over the overlap of the shifted signals. The maximum is refined by a parabola through
    the correlations at three shifts. The lag is negative if the applied force leads the ideal
    force, for example because of prediction.

    Parameters
    ----------
    force_N, ideal_N
        Force that the device applied, and ideal force [N], each of shape (ticks,) or (ticks, 3).
    tick_s
        Time from tick to tick [s].
    longest_ms
        Largest tested shift in both directions [ms]. The default is twelve times the latency of the
        haptic loop in a study.

    Raises
    ------
    InputError
        If a force is constant, or the best shift lies at an end of the tested range. In the second
        case, a better shift may lie outside the range.
    """
    force, ideal = _pair(force_N, ideal_N)
    reach = round(1e-3 * longest_ms / tick_s)
    if not 1 <= reach < len(force) // 2:
        raise InputError(
            "longest_ms",
            "be at least one tick and less than half of the trial",
            f"{longest_ms:g} for a trial of {1e3 * tick_s * len(force):g} ms",
            "use 50 ms and a longer trial",
        )
    for name, signal in (("force_N", force), ("ideal_N", ideal)):
        if np.ptp(signal, axis=0).max() == 0.0:
            raise InputError(
                name, "vary", "a constant force", "use a trial in which the force changes"
            )
    match = np.array([_correlation(force, ideal, shift) for shift in range(-reach, reach + 1)])
    best = int(match.argmax())
    if best in (0, 2 * reach):
        raise InputError(
            "longest_ms", "exceed the lag", f"{longest_ms:g}", "use a larger longest_ms"
        )
    before, peak, after = match[best - 1 : best + 2]
    curved = before - 2.0 * peak + after
    # vertex of the parabola through three shifts; a flat top has no vertex
    part = 0.5 * (before - after) / curved if curved < 0.0 else 0.0
    return float((best - reach + part) * tick_s * 1e3)


def acceleration_change_m_s2(velocity_mm_s: ArrayLike, *, tick_s: float) -> float:
    """Return the mean norm [m/s^2] of the tick-to-tick change in acceleration.

    A lower value means a smoother motion. The measure is the "smoothness index" of the published
    study, computed by the printed formula: mean |dv[i+1]/dt - dv[i]/dt|. The value is the mean jerk
    multiplied by the duration of a tick, so only trials with the same tick can be compared. The
    study presents higher values as better, although a rougher motion gives a higher value.

    Parameters
    ----------
    velocity_mm_s
        Velocity of the tool [mm/s], shape (ticks,) or (ticks, 3), with at least three ticks.
    tick_s
        Time from tick to tick [s].
    """
    velocity = _signal("velocity_mm_s", velocity_mm_s, at_least=3)
    second = np.diff(velocity, 2, axis=0) / tick_s
    return float(np.linalg.norm(second, axis=1).mean()) * 1e-3


def spectral_arc_length(speed_mm_s: ArrayLike, *, tick_s: float) -> float:
    """Compute the spectral arc length of a movement.

    A value nearer to zero means a smoother movement.

    The measure is SPARC (Balasubramanian et al. 2012, 2015). The result is minus the arc length of
    the normalised magnitude spectrum of the speed. The spectrum is used up to
    :data:`SPARC_CUTOFF_HZ`, between the first and the last frequency with a value of at least
    :data:`SPARC_AMPLITUDE`. The result has no unit. It does not depend on the size of the movement.
    It does not depend on the duration either, as long as the spectrum lies below the cutoff.

    Parameters
    ----------
    speed_mm_s
        Size of the velocity [mm/s], shape (ticks,). The movement starts and ends at rest.
    tick_s
        Time from tick to tick [s].
    """
    speed = _signal("speed_mm_s", speed_mm_s, at_least=3)[:, 0]
    count = 2 ** (int(np.ceil(np.log2(len(speed)))) + SPARC_PADDING)
    frequencies = np.fft.rfftfreq(count, tick_s)
    spectrum = np.abs(np.fft.rfft(speed, count))
    # a tool at rest has no spectrum, and is refused below
    spectrum /= max(float(spectrum.max()), 1e-300)
    loud = np.flatnonzero((frequencies <= SPARC_CUTOFF_HZ) & (spectrum >= SPARC_AMPLITUDE))
    if len(loud) < 2:
        raise InputError(
            "speed_mm_s",
            f"contain at least two frequencies below {SPARC_CUTOFF_HZ:g} Hz",
            len(loud),
            "use a longer trial",
        )
    chosen = slice(loud[0], loud[-1] + 1)
    span = frequencies[chosen][-1] - frequencies[chosen][0]
    steps = np.hypot(np.diff(frequencies[chosen]) / span, np.diff(spectrum[chosen]))
    return -float(steps.sum())


def completion_time_s(time_s: ArrayLike, done: ArrayLike) -> float:
    """Return the time [s] from the first tick to the tick from which the task remains done.

    The result is infinite if the task is not done at the end.

    Parameters
    ----------
    time_s
        Time of every tick [s], shape (ticks,).
    done
        True for ticks in which the condition of the task is met, shape (ticks,).
    """
    times = _signal("time_s", time_s, at_least=1)[:, 0]
    holds = np.asarray(done, dtype=bool)
    if not holds[-1]:
        return float("inf")
    first = np.flatnonzero(~holds).max(initial=-1) + 1
    return float(times[first] - times[0])


def overshoot_mm(depth_mm: ArrayLike, *, target_mm: float) -> float:
    """Compute the overshoot [mm] of the tip beyond its target depth; 0 without overshoot.

    `depth_mm` has shape (ticks,).
    """
    return max(0.0, float(_signal("depth_mm", depth_mm, at_least=1).max()) - target_mm)


def excess_travel_mm(depth_mm: ArrayLike, *, puncture_tick: int) -> float:
    """Compute the largest travel [mm] of the tip beyond its depth at a puncture.

    `depth_mm` has shape (ticks,).
    """
    depth = _signal("depth_mm", depth_mm, at_least=1)[:, 0]
    return float(depth[puncture_tick:].max() - depth[puncture_tick])


def _correlation(force: Array, ideal: Array, shift: int) -> float:
    """Return the correlation of force[t + shift] with ideal[t] over all valid ticks t."""
    late, early = (
        (force[shift:], ideal[: len(ideal) - shift])
        if shift >= 0
        else (force[:shift], ideal[-shift:])
    )
    late = late - late.mean(axis=0)
    early = early - early.mean(axis=0)
    sizes = float(np.linalg.norm(late) * np.linalg.norm(early))
    # a part without any change is the worst match
    return float((late * early).sum()) / sizes if sizes > 0.0 else -1.0


def _signal(name: str, values: ArrayLike, *, at_least: int) -> Array:
    """Return samples as an array of shape (ticks, components); check that all are finite."""
    array = np.asarray(values, dtype=float)
    if array.ndim not in (1, 2) or len(array) < at_least:
        raise InputError(
            name,
            f"have shape (ticks,) or (ticks, components) with at least {at_least} ticks",
            array.shape,
            "pass the columns of a trace",
        )
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array.reshape(len(array), -1)).all(axis=1))[0])
        raise InputError(
            name, "be finite", f"{array[bad]} at tick {bad}", "mark the trial as failed"
        )
    return array.reshape(len(array), -1)


def _pair(force_N: ArrayLike, ideal_N: ArrayLike) -> tuple[Array, Array]:
    """Return both forces as arrays of shape (ticks, components); check that all are finite."""
    return _signal("force_N", force_N, at_least=1), _signal("ideal_N", ideal_N, at_least=1)


def aligned_rows(path: Array, model: Array) -> Ints:
    """Align a path with a model path; return the aligned model row for each row of the path.

    The alignment is computed by dynamic time warping (Sakoe and Chiba 1978), and the returned rows
    never decrease. The alignment is the monotonic alignment with the smallest sum of distances
    between aligned points. It starts at the first points of both paths. It may end before the last
    point of the model path, so that an unfinished path is not counted as a deviation.

    Parameters
    ----------
    path, model
        Points of both paths in the order of time, in any unit, shapes (n, d) and (m, d).

    Returns
    -------
    NDArray
        Rows of the model, from 0 to m - 1, shape (n,).
    """
    from skimage.graph import MCP

    ours, theirs = (
        np.unique(np.linspace(0, len(each) - 1, min(POINTS, len(each))).round().astype(int))
        for each in (path, model)
    )
    cost = np.linalg.norm(path[ours][:, None] - model[theirs][None], axis=2)
    # A step leads to the next point of one path or of both.
    search = MCP(cost, offsets=[(1, 1), (1, 0), (0, 1)])
    total, _ = search.find_costs([(0, 0)])
    met = search.traceback((len(ours) - 1, int(np.argmin(total[-1]))))
    mine, other = np.transpose(met)
    rows = np.bincount(mine, theirs[other]) / np.bincount(mine)
    return np.interp(np.arange(len(path)), ours, rows).round().astype(np.int64)


def deviation_mm(path: Array, model: Array, rows: Ints) -> Array:
    """Return the distance [mm] of each point of a path from the model path, shape (n,).

    The nearest point is searched only in the part of the model path near the aligned row. For
    points that are aligned with `rows[-1]`, the rest of the model path after this row is searched
    too.

    Parameters
    ----------
    path, model
        Points of both paths in the order of time [mm], shapes (n, d) and (m, d).
    rows
        Row of the model that is aligned with each point, from :func:`aligned_rows`, shape (n,).
    """
    reach = 2 * int(np.ceil(max(len(path), len(model)) / POINTS)) + 2
    best = np.full(len(path), np.inf)
    for shift in range(-reach, reach):
        start = np.clip(rows + shift, 0, max(0, len(model) - 2))
        edge = model[np.minimum(start + 1, len(model) - 1)] - model[start]
        length = (edge**2).sum(axis=1)
        along = ((path - model[start]) * edge).sum(axis=1) / np.where(length > 0.0, length, 1.0)
        foot = model[start] + np.clip(along, 0.0, 1.0)[:, None] * edge
        best = np.minimum(best, np.linalg.norm(path - foot, axis=1))
    tail = rows == rows[-1]
    best[tail] = np.minimum(best[tail], path_distance(path[tail], model[rows[-1] :]))
    return best


def followed_ticks(model: Array, rows: Ints) -> Flags:
    """Return True for each point of a path with a corresponding place on the model path.

    The alignment may end before the last row of the model path. If the rest of the model path leads
    farther than `TREMOR_MM` away, points after the first point aligned with the last used row have
    no corresponding place. See :func:`deviation_mm` for the parameters.
    """
    end = rows[-1]
    goes_on = np.linalg.norm(model[end:] - model[end], axis=1).max() > TREMOR_MM
    return (np.arange(len(rows)) <= np.argmax(rows == end)) | (not goes_on)
