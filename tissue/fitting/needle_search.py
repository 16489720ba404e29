"""The jumps of a needle's log: each where the law with the constants of that log explains it best.

First roughly: of some moments in every stroke, those with which the law explains the log best when its constants are
fitted by least squares. Then exactly: with the constants fitted to the samples away from the jumps, the likelihood of
every moment (`tissue.fitting.needle_moments`), and the fit once more.
"""

from dataclasses import replace
from itertools import combinations

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.fitting.measured import MeasuredLoads
from tissue.fitting.needle import NeedleForward
from tissue.fitting.needle_events import Event, median_jumps, stroke_numbers
from tissue.fitting.needle_moments import moment_densities, moment_of
from tissue.fitting.posterior import Posterior, maximum_posterior, polished
from tissue.fitting.restricted import Restricted
from tissue.fitting.shift import shift_operators
from tissue.fitting.target import OFFSET_S, Target

__all__ = ["with_jumps"]

CLOCKS, SMEARED = 5.0, 2.0
"""Standard deviations of the clocks' offset about a jump that are left out, since samples on the wrong side of a jump
would hold the offset where it is, and poses to either side over which loads are interpolated."""
SHARPEST, EVENLY = 6, 16
"""Moments of a stroke that are tried: its sharpest jumps, and as many spread evenly."""
OF_SEVERAL = 3
"""How many times fewer where a stroke has several jumps, whose moments are tried together."""
APART_S = 0.05
"""Least time between two of the sharpest jumps [s]."""
CLEAR = 10.0
"""Log density that a puncture must add: chance adds the logarithm of the number of moments, 8 of 2,000."""
ROUNDS = 6
"""How often moments are found again with the constants fitted to what they leave."""
SENSITIVITIES = 2
"""How often the noise is found with new sensitivities of the constants."""
SEEN = 1.0
"""Standard deviation of a moment, in samples of the log, up to which the log shows it."""
DIFFERS = 0.2
"""Difference of two laws, in scales of the noise, below which it does not matter which of them holds."""


def with_jumps(plain: NeedleForward, measured: MeasuredLoads) -> tuple[NeedleForward, MeasuredLoads]:
    """The law with the jumps of a log, and the log without the samples over which they are not exact.

    Parameters
    ----------
    plain
        The law along the log's poses, without events.
    measured
        Force along the axis, of one channel.
    """
    block_s, step_s = (float(np.median(np.diff(each))) for each in (measured.times_s, plain.times_s))
    smeared_s = block_s + SMEARED * step_s
    forward, within_s = _roughly(plain, measured), CLOCKS * OFFSET_S + smeared_s
    usable = _usable(forward, measured, 0.0, within_s)
    posterior = _fitted(forward, usable, 0.0)
    at = posterior.target.constants
    within_s = smeared_s + CLOCKS * OFFSET_S * float(np.sqrt(posterior.covariance[at, at]))
    for _ in range(ROUNDS):
        before, offset_s = [each.at_s(plain.times_s) for each in forward.events], posterior.nuisances.offset_s
        forward = _exactly(forward, measured, posterior)
        usable = _usable(forward, measured, offset_s, within_s)
        moved = np.abs(np.array([each.at_s(plain.times_s) for each in forward.events]) - np.array(before))
        if not (moved > step_s / 4.0).any():
            break
        posterior = _fitted(forward, usable, offset_s)
    return forward, usable


def _fitted(forward: NeedleForward, usable: MeasuredLoads, offset_s: float) -> Posterior:
    """The constants near those of least squares; looked for everywhere where no maximum is near."""
    target = Target(forward, usable)
    u = target.start(offset_s)
    for _ in range(SENSITIVITIES):
        u, covariance, converged = polished(Restricted(target, u), u)
    return Posterior(target, u, covariance, converged) if converged else maximum_posterior(forward, usable)


def _usable(forward: NeedleForward, measured: MeasuredLoads, offset_s: float, within_s: float) -> MeasuredLoads:
    """The log without what a jump, a corner or a needle that leaves a hole makes uncertain, and after the poses."""
    times_s = measured.times_s - offset_s
    out = forward.unusable(times_s, within_s) | (times_s > forward.times_s[-1])
    return replace(measured, values=np.where(out[:, None], np.nan, measured.values))


def _roughly(plain: NeedleForward, measured: MeasuredLoads) -> NeedleForward:
    """The law with the jumps that explain the log best of some moments, stroke by stroke."""
    stroke, known = stroke_numbers(plain.travel_m), np.isfinite(measured.values[:, 0])
    jumps = median_jumps(plain.times_s, np.interp(plain.times_s, measured.times_s[known], measured.values[known, 0]))
    forward, number = plain, int(stroke[int(np.argmax(plain.travel_m > 0.0))])
    kinds = ["puncture"] * sum(depth < plain.travel_m[stroke == number].max() for depth in plain.depths_m)
    while kinds:
        here = np.flatnonzero((stroke == number) & (plain.travel_m > 0.0))[:-1]
        until = _until(plain, measured, float(plain.times_s[here[-1]]))
        graded = [_graded(forward, until)] if "puncture" in kinds else []
        for places in _places(plain.times_s, jumps, here, kinds):
            new = tuple(Event(kind, at, seen=False) for kind, at in zip(kinds, places, strict=False))
            graded.append(_graded(replace(forward, events=(*forward.events, *new)), until))
        best = max(graded, key=lambda each: each[0] - CLEAR * len(each[1].events))
        forward = best[1]
        coming = [each for each in forward.expected_events() if stroke[each.sample] > number]
        number = int(stroke[coming[0].sample]) if coming else 0
        kinds = [each.kind for each in coming if stroke[each.sample] == number]
    return replace(forward, known=plain.known)


def _until(plain: NeedleForward, measured: MeasuredLoads, last_s: float) -> MeasuredLoads:
    """The log up to a time [s]."""
    late = measured.times_s > last_s
    return replace(measured, values=np.where(late[:, None], np.nan, measured.values))


def _graded(forward: NeedleForward, measured: MeasuredLoads) -> tuple[float, NeedleForward]:
    """How well a law explains a log with constants by least squares, and the law with these."""
    target = Target(forward, measured)
    u = target.start(0.0)
    found = zip(target.forward.parameters, target.x(u[: target.constants]).tolist(), strict=True)
    return target.value(u), replace(forward, known=forward.known | {each.name: value for each, value in found})


def _places(times_s: Array, jumps: Array, here: Ints, kinds: list[str]) -> list[tuple[int, ...]]:
    """Samples of a stroke to try for its jumps, in order; of punctures fewer, too."""
    divisor = 1 if len(kinds) == 1 else OF_SEVERAL
    size = (-1.0 if kinds[0] != "slip_out" else 1.0) * jumps[here]
    chosen = set(here[np.linspace(0, len(here) - 1, EVENLY // divisor, dtype=np.int64)].tolist())
    for _ in range(SHARPEST // divisor * len(kinds)):
        place = int(here[int(np.argmax(size))])
        chosen.add(place)
        size[np.abs(times_s[here] - times_s[place]) < APART_S] = -np.inf
    fewest = next((at for at, kind in enumerate(kinds) if kind == "puncture"), len(kinds) - 1) + 1
    return [places for count in range(fewest, len(kinds) + 1) for places in combinations(sorted(chosen), count)]


def _exactly(forward: NeedleForward, measured: MeasuredLoads, posterior: Posterior) -> NeedleForward:
    """The law with each event where it is most likely, given the constants of a fit."""
    noise = posterior.nuisances
    x = posterior.target.x(posterior.mean_z)
    block_s = float(np.median(np.diff(measured.times_s)))
    operator, _ = shift_operators(forward.times_s, measured.times_s, noise.offset_s, measured.within_s)
    forward = replace(forward, known=forward.known | dict(zip(posterior.names, x.tolist(), strict=True)))
    for place, event in enumerate(forward.events):
        never, early, first, last = _branches(forward, x, place)
        laws = np.column_stack([operator @ never, operator @ early])
        before, after = (measured.values - laws - noise.bias).T
        densities = moment_densities(before, after, len(measured.within_s), noise)
        times_s = measured.times_s - noise.offset_s
        inside = (times_s >= forward.times_s[first]) & (times_s <= forward.times_s[last])
        if not inside.any():
            continue
        found = moment_of(times_s, measured.within_s, np.where(inside[:, None], densities, -np.inf))
        seen = found.spread_s < SEEN * block_s
        moment_s = found.mean_s if seen else found.early_s
        matters = inside & (np.abs(laws[:, 0] - laws[:, 1]) > DIFFERS * noise.scale[0])
        matters &= (times_s >= found.span_s[0]) & (times_s <= found.span_s[1])
        span_s = found.span_s
        if not seen:
            apart = times_s[matters]
            span_s = (float(apart[0]), float(apart[-1])) if len(apart) else (np.inf, -np.inf)
        sample = int(np.clip(int(np.searchsorted(forward.times_s, moment_s)) - 1, first, last))
        new = Event(event.kind, sample, seen=seen, moment_s=moment_s, span_s=span_s)
        forward = replace(forward, events=(*forward.events[:place], new, *forward.events[place + 1 :]))
    return forward


def _branches(forward: NeedleForward, x: Array, place: int) -> tuple[Array, Array, int, int]:
    """Force without an event, shape (n,), with it as early as can be, and the samples between which it may lie."""
    stroke = stroke_numbers(forward.travel_m)
    events = tuple(replace(each, seen=False, moment_s=None) for each in forward.events)
    here = np.flatnonzero(stroke == stroke[events[place].sample])
    first = max([int(here[0]), *(each.sample + 1 for each in events[:place])])
    last = min([int(here[-1]), *(each.sample for each in events[place + 1 :])])

    def moved(sample: int) -> NeedleForward:
        event = replace(events[place], sample=min(sample, len(stroke) - 2))
        return replace(forward, events=(*events[:place], event, *events[place + 1 :]))

    never = moved(max(last - 1, 0))
    if events[place].kind == "puncture":
        depth = forward.depths_m[sum(each.kind == "puncture" for each in events[:place])]
        met = (never.inserted_m(x) == depth) & (forward.travel_m > 0.0) & (np.arange(len(stroke)) >= first)
        first = int(np.argmax(met)) if met.any() else last
    return never.loads(x)[:, 0], moved(first).loads(x)[:, 0], first, last
