"""What a log shows of its instruments: saturated sensors, coarse steps, slow poses and noisy ones."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import counted

__all__ = ["pose_notes", "without_saturation"]

PLATEAU = 10
"""Samples in a row at a channel's extreme from which a sensor is taken as saturated."""
SHARPER = 5
"""How many times longer than the equal values before and after it such a row is: a peak in coarse steps is not."""
ROUGH = 0.05
"""Share of samples at which a measured channel turns back; one that is smoother has no noise, and may rest anywhere."""
BASELINE = 0.5
"""Share of the greatest load below which an extreme is where nothing touches the tool, not the end of a range."""
SLOWER = 5.0
"""Times between two poses in those between two loads from which a path between poses matters."""
CORNER_M = 2e-5
"""How far a straight line between two poses may be off, half the noise of an optical tracker [m]."""
SPEED_S = 0.1
"""Time over which a tool's own speed is taken [s]."""


def without_saturation(loads: Array, channels: tuple[str, ...]) -> tuple[Array, list[str]]:
    """Loads without what saturated sensors gave, shape (m, channels), and sentences on that and on coarse steps.

    Parameters
    ----------
    loads
        Loads [N, N m], shape (m, channels), NaN where missing.
    channels
        Their names.
    """
    kept, notes = loads.copy(), []
    for at, name in enumerate(channels):
        values, unit = loads[:, at], name.rpartition("_")[2].replace("Nm", "N m")
        for extreme in _saturated(values):
            full = values == extreme
            kept[full, at] = np.nan
            notes.append(f"{counted(int(full.sum()), 'sample')} of {name} at {extreme:.4g} {unit} left out: saturated")
        if (step := _coarse_step(values)) > 0.0:
            notes.append(
                f"{name} comes in steps of {step:.3g} {unit}, coarser than its noise: their error of "
                f"{step / np.sqrt(12.0):.2g} {unit} is part of the noise that is fitted"
            )
    return kept, notes


def pose_notes(times_s: Array, tips_m: Array, load_period_s: float) -> list[str]:
    """Sentences on poses that come too slowly for the loads, and on noise in them.

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
    times_s, tips_m = times_s[new], tips_m[new]
    period_s, notes = float(np.median(np.diff(times_s))), []
    bend_m = float(np.linalg.norm(np.diff(tips_m, 2, axis=0), axis=1).max()) / 8.0
    noise_m = float(np.linalg.norm(1.4826 * np.median(np.abs(np.diff(tips_m, 3, axis=0)), axis=0))) / np.sqrt(20.0)
    if period_s > SLOWER * load_period_s and bend_m > CORNER_M:
        notes.append(
            f"poses come every {1e3 * period_s:.3g} ms, loads every {1e3 * load_period_s:.3g} ms: the straight path "
            f"between poses is off by {1e3 * bend_m:.2g} mm at the sharpest corner, log them faster"
        )
    lag = max(round(SPEED_S / period_s), 1)
    moved_m = np.linalg.norm(tips_m[lag:] - tips_m[:-lag], axis=1)
    fastest_m_s = float((moved_m / (times_s[lag:] - times_s[:-lag])).max(initial=0.0))
    if (shaken_m_s := np.sqrt(2.0) * noise_m / period_s) > fastest_m_s:
        notes.append(
            f"poses have noise of {1e3 * noise_m:.2g} mm, which is a speed of {1e3 * shaken_m_s:.3g} mm/s from one to "
            f"the next where the tool moves at {1e3 * fastest_m_s:.3g} mm/s at most: smooth them first"
        )
    return notes


def _saturated(values: Array) -> list[float]:
    """Values at which a channel stays."""
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
    """Step in which a channel comes where that hides its noise; 0 where not."""
    known = values[np.isfinite(values)]
    levels = np.unique(known)
    if len(levels) < 3 or np.median(np.abs(np.diff(known))) > 0.0:
        return 0.0
    gaps = np.diff(levels)
    step = float(gaps[gaps > 1e-9 * np.abs(levels).max()].min(initial=np.inf))
    shares = gaps / step
    return step if bool((np.abs(shares - np.round(shares)) < 0.05).all()) else 0.0


def _rows(values: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where rows of equal values begin, and how long they are."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0.0) + 1])
    return starts, np.diff(np.concatenate([starts, [len(values)]]))
