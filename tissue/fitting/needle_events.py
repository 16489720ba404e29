"""When a needle's log jumps: punctures, and the moments at which a shaft at rest breaks away."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array

__all__ = ["Event", "found_events", "near_events"]

WINDOW_S = 0.02
"""Time on either side of a sample over which the force is averaged to see whether it jumps [s]."""
UNSEEN = 0.6
"""Share of the time since the motion turned round within which a breaking away that is not seen may lie."""
CLEAR = 6.0
"""Size of a jump over the noise of such an average from which it is taken for one."""


@dataclass(frozen=True)
class Event:
    """A jump of the force between two samples.

    Attributes
    ----------
    kind
        ``puncture``, or ``slip_in`` and ``slip_out`` where the shaft breaks away.
    sample
        The last one before it.
    seen
        Whether the log shows it; otherwise it lies where the law expects it.
    """

    kind: str
    sample: int
    seen: bool = True


def found_events(
    times_s: Array, travel_m: Array, force_N: Array, expected: tuple[Event, ...], law_N: Array
) -> tuple[Event, ...]:
    """Where a log has the jumps that a needle's law lets expect, in order of time.

    A puncture that is not clear is left out; a breaking away that is not, since friction drops by no more than speed
    adds, keeps its expected place and is marked as not seen.

    In each stroke (a time of motion in one direction) as many of the sharpest falls of the force are taken as are
    expected there; where the shaft breaks away outwards the first rise, since a later one is a hole that it leaves, and
    only where the law itself rises clearly.

    Parameters
    ----------
    times_s, travel_m, force_N
        Of the log, shape (n,); the force along the needle's axis, positive against insertion.
    expected, law_N
        The events of a run of the law along the same travel, and its force, shape (n,).
    """
    step = float(np.median(np.diff(times_s)))
    width = max(round(WINDOW_S / step), 2)
    jump = _jumps(force_N, width)
    noise = 1.4826 * float(np.median(np.abs(jump - np.median(jump))))
    stroke, law = _strokes(travel_m), _jumps(law_N, width)
    found: list[Event] = []
    for number in sorted({int(stroke[event.sample]) for event in expected}):
        here = [event for event in expected if stroke[event.sample] == number]
        sign = 1.0 if here[0].kind == "slip_out" else -1.0
        size = np.where(stroke == number, sign * jump, -np.inf)
        if sign > 0.0 and float(np.max(law[here[0].sample - width : here[0].sample + width])) < CLEAR * noise:
            size[:] = -np.inf
        places: list[int] = []
        for _ in here[:1] if sign > 0.0 else here:
            if sign > 0.0:
                first = int(np.argmax(size >= CLEAR * noise))
                size[first + 2 * width :] = -np.inf
            place = int(np.argmax(size))
            if size[place] < CLEAR * noise:
                found += [replace(event, seen=False) for event in here[len(places) :] if event.kind != "puncture"]
                break
            near = slice(max(place - width, 0), place + width)
            places.append(near.start + int(np.argmax(sign * np.diff(force_N[near.start : near.stop + 1]))))
            size[max(place - 2 * width, 0) : place + 2 * width + 1] = -np.inf
        found += [Event(event.kind, place) for event, place in zip(here, sorted(places), strict=False)]
    return tuple(sorted(found, key=lambda event: event.sample))


def near_events(
    times_s: Array, travel_m: Array, wanted_s: Array, events: tuple[Event, ...], within_s: float
) -> NDArray[np.bool_]:
    """Which times [s] lie within a time of an event, shape of `wanted_s`: where a clock's offset would smear a jump."""
    close = np.zeros(np.shape(wanted_s), dtype=bool)
    for event in events:
        middle = 0.5 * (times_s[event.sample] + times_s[event.sample + 1])
        close |= np.abs(wanted_s - middle) <= within_s
        if not event.seen:
            turn = _strokes(travel_m)
            rest = middle - times_s[int(np.argmax(turn == turn[event.sample]))]
            close |= np.abs(wanted_s - middle) <= UNSEEN * rest
    return close


def _jumps(force_N: Array, width: int) -> Array:
    """Mean of the samples after each less that of those up to it, less what the slope does there, shape (n,)."""
    padded = np.concatenate([np.full(2 * width, force_N[0]), force_N, np.full(2 * width, force_N[-1])])
    sums = np.concatenate([[0.0], np.cumsum(padded)])
    mean = (sums[width:] - sums[:-width]) / width
    at = np.arange(len(force_N)) + width + 1
    before, after = mean[at], mean[at + width]
    slope = 0.5 * (before - mean[at - width] + mean[np.minimum(at + 2 * width, len(mean) - 1)] - after)
    jumps: Array = after - before - slope
    return jumps


def _strokes(travel_m: Array) -> Array:
    """Number of the stroke that each sample begins, shape (n,): it rises wherever the motion turns round."""
    turn = np.sign(np.diff(travel_m, append=travel_m[-1]))
    for sample in range(1, len(turn)):
        if turn[sample] == 0.0:
            turn[sample] = turn[sample - 1]
    return np.concatenate([[0], np.cumsum(np.diff(turn) != 0.0)])
