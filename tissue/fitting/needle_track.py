"""A needle's law along a log, and how its state depends on the constants."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Ints
from tissue.fitting.needle_events import Event
from tissue.fitting.needle_runs import run_on
from tissue.models.needle.insertion import Insertion
from tissue.models.needle.parameters import NeedleTissue

__all__ = ["NeedleTrack", "followed", "slid_in"]

WHOLE_N = 9e3
"""Puncture force of a membrane that does not break before its event: more than any needle meets."""
STICKS = 0.99
"""Static friction of a shaft that does not break away before its event, over the most that the law allows."""
NONE = np.empty(0)
KEPT, STOPPED, AT_CUT, SLID_IN, CREPT_IN, SLID_OUT, CREPT_OUT = range(7)


@dataclass(frozen=True, eq=False)
class NeedleTrack:
    """What a needle did along a log.

    Attributes
    ----------
    inserted_m, deflection_m
        L and u, shape (n,).
    sliding
        1, -1 or 0, shape (n,).
    cuts
        1 where the tip is at the end of its track, shape (n,).
    holes
        Membranes that are broken and around the shaft, shape (n,).
    how
        How L came about: `KEPT` from before, `STOPPED` at a membrane, by a slide in or out, or by creeping.
    source
        The sample whose slide set L, shape (n,); -1 where L is a depth or zero.
    events
        Those of the run itself, of any kind.
    """

    inserted_m: Array
    deflection_m: Array
    sliding: Ints
    cuts: Ints
    holes: Ints
    how: Ints
    source: Ints
    events: tuple[Event, ...]


def followed(
    tissue: NeedleTissue,
    travel_m: Array,
    speed_m_s: Array,
    events: tuple[Event, ...],
    *,
    free_from: int | None = None,
) -> NeedleTrack:
    """Run `Insertion` along a travel.

    Parameters
    ----------
    tissue
        The constants.
    travel_m, speed_m_s
        Of the tip along the axis, inwards, shape (n,); it starts outside.
    events
        When membranes break and the shaft breaks away: there and not where the law has them.
    free_from
        Sample from which the law itself decides; None for nowhere.
    """
    insertion = Insertion(tissue, travel_m=float(travel_m[0]))
    modes = _modes(tissue, speed_m_s, events)
    if free_from is not None:
        modes = {at: each for at, each in modes.items() if at < free_from} | {max(free_from, 1): tissue}
    depths = [membrane.depth_m for membrane in tissue.membranes]
    lengths, happened = np.zeros(len(travel_m)), []
    sliding, cuts, holes, how, source = (np.zeros(len(travel_m), dtype=np.int64) for _ in range(5))
    source[0] = from_ = cut_from = -1
    ends = _ends(travel_m, np.abs(speed_m_s) >= 0.5 * tissue.friction.stick_band_m_s, modes)
    sample = 1
    while sample < len(travel_m):
        if sample in modes:
            insertion.tissue = modes[sample]
        before, cut, broken, was = insertion.inserted_m, insertion.cut_m, insertion.punctured, insertion.sliding
        insertion.advance(float(travel_m[sample]), float(speed_m_s[sample]))
        length, now = insertion.inserted_m, insertion.sliding
        if length == before:
            came = KEPT
        elif length == 0.0 or length in depths:
            came, from_ = STOPPED, -1
        elif length == cut and length > before:
            came, from_ = AT_CUT, cut_from
        else:
            came = (SLID_IN if now > 0 else CREPT_IN) if length > before else SLID_OUT if now < 0 else CREPT_OUT
            from_ = sample
        if insertion.punctured > broken:
            happened.append(Event("puncture", sample - 1))
        elif now != 0 and was == 0 and before > 0.0:
            happened.append(Event("slip_in" if now > 0 else "slip_out", sample - 1))
        goes_on = (came == KEPT and now == 0) or came in (SLID_IN, SLID_OUT)
        run = run_on(insertion, travel_m[sample + 1 : ends[sample + 1]]) if goes_on else NONE
        here = slice(sample, sample + 1 + len(run))
        lengths[sample], lengths[sample + 1 : here.stop] = length, run
        sliding[here], how[here] = now, came
        cuts[here] = insertion.inserted_m == insertion.cut_m
        holes[here] = sum(depth <= length for depth in depths[: insertion.punctured])
        source[here] = np.arange(sample, here.stop) if came in (SLID_IN, SLID_OUT) else from_
        from_, sample = int(source[here.stop - 1]), here.stop
        if insertion.cut_m > cut:
            cut_from = from_
    deflections = np.where(lengths > 0.0, travel_m - lengths, np.maximum(travel_m, 0.0))
    return NeedleTrack(lengths, deflections, sliding, cuts, holes, how, source, tuple(happened))


def _ends(travel_m: Array, quick: NDArray[np.bool_], modes: dict[int, NeedleTissue]) -> Ints:
    """The next sample at which a motion alike ends, shape (n + 1,): it turns, rests or the tissue changes."""
    alike = np.sign(np.diff(travel_m, prepend=travel_m[0])) + 4.0 * quick
    breaks = np.union1d(np.flatnonzero(np.diff(alike) != 0.0) + 1, np.array(list(modes), dtype=np.int64))
    breaks = np.append(breaks, len(travel_m))
    return np.asarray(breaks[np.minimum(np.searchsorted(breaks, np.arange(len(travel_m) + 1)), len(breaks) - 1)])


def slid_in(track: NeedleTrack, by_length: Array) -> tuple[Array, Array]:
    """Share of the last sample's motion over which the shaft slid inwards, shape (n,), and its slopes, (n, 11 + 2 m).

    It lies between 0 and 1 where the tip meets a membrane between two samples: its drag ends there, at a travel that
    depends on the constants, and a drag that ended a whole sample earlier would be a step in them.
    """
    share, slopes, length = np.where(track.sliding > 0, 1.0, 0.0), np.zeros_like(by_length), track.inserted_m
    for k in (
        np.flatnonzero((track.how[2:] == STOPPED) & (track.how[1:-1] == SLID_IN) & (track.how[:-2] == SLID_IN)) + 2
    ):
        went, last = length[k] - length[k - 1], length[k - 1] - length[k - 2]
        by_last = by_length[k - 1] - by_length[k - 2]
        share[k] = min(went / last, 1.0)
        if went < last:
            slopes[k] = -by_length[k - 1] / last - went / last**2 * by_last
    return share, slopes


def _modes(tissue: NeedleTissue, speed_m_s: Array, events: tuple[Event, ...]) -> dict[int, NeedleTissue]:
    """The tissue from a sample on: whole and sticking before an event, giving in at it."""
    whole = replace(tissue, membranes=tuple(replace(each, puncture_N=WHOLE_N) for each in tissue.membranes))
    broken = replace(tissue, membranes=tuple(replace(each, puncture_N=1e-12) for each in tissue.membranes))
    slow = np.flatnonzero(np.abs(speed_m_s) < 0.5 * tissue.friction.stick_band_m_s)
    turns = np.flatnonzero(np.diff(np.sign(speed_m_s)) != 0.0) + 1
    rests = np.union1d(slow, turns)
    modes = {1: whole}
    for event in sorted(events, key=lambda each: each.sample):
        if event.kind == "puncture":
            modes |= {event.sample + 1: broken, event.sample + 2: whole}
            continue
        side = event.kind.removeprefix("slip_")
        begun = rests[rests <= event.sample]
        sticks = {f"static_{side}_N_m": STICKS * tissue.linear_N_m}
        slides = {f"static_{side}_N_m": getattr(tissue.friction, f"sliding_{side}_N_m")}
        coming = rests[rests > event.sample]
        modes |= {
            max(int(begun[-1]) if len(begun) else 1, 1): replace(whole, friction=replace(tissue.friction, **sticks)),
            event.sample + 1: replace(whole, friction=replace(tissue.friction, **slides)),
        }
        if len(coming):
            modes.setdefault(max(int(coming[0]), event.sample + 2), whole)
    return modes
