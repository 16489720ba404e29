"""Samples of a needle's log in which its state stays what it is, sliding or sticking, all at once.

`tissue.models.needle.insertion.Insertion` decides sample by sample when a needle begins to slide, meets a membrane or
turns round. Between such moments the balance has a closed form, which is evaluated here for many samples together.
"""

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from tissue.models.needle.insertion import Insertion

__all__ = ["LEAST", "run_on"]

LEAST, MOST = 4, 512
"""Samples of a run below which nothing is gained, and most that are looked at together."""


def run_on(insertion: Insertion, travel_m: Array) -> Array:
    """Inserted lengths while the needle goes on as it does, shape (k,), k at most that of `travel_m`; moves the state.

    Parameters
    ----------
    insertion
        The state, sliding or sticking; one that creeps, or that has just met what stops it, gives none.
    travel_m
        Travels to come, shape (n,), all in one direction: inwards (or at rest) or outwards, and if the shaft slides all
        of them quick enough for sliding.
    """
    coming = travel_m[:MOST]
    if len(coming) < LEAST or (insertion.inserted_m == 0.0 and coming[0] <= 0.0):
        return np.empty(0)
    inwards = coming[0] >= insertion.travel_m
    if insertion.sliding == 0:
        lengths = _sticking(insertion, coming, inwards)
    elif insertion.sliding > 0:
        lengths = _sliding_in(insertion, coming) if inwards else np.empty(0)
    else:
        lengths = np.empty(0) if inwards else _sliding_out(insertion, coming)
    if len(lengths):
        cutting = insertion.inserted_m == insertion.cut_m
        insertion.inserted_m = float(lengths[-1])
        insertion.travel_m = float(coming[len(lengths) - 1])
        insertion.deflection_m = insertion.travel_m - insertion.inserted_m
        if cutting and insertion.sliding > 0:
            insertion.cut_m = insertion.inserted_m
    return lengths


def _sticking(state: Insertion, travel_m: Array, inwards: bool) -> Array:
    tissue, length = state.tissue, state.inserted_m
    friction = tissue.friction
    u = travel_m - length
    pull = (tissue.linear_N_m + tissue.quadratic_N_m2 * np.abs(u)) * u
    if inwards:
        tip = tissue.cutting_N if length == state.cut_m else 0.0
        if state.blocked:
            tip = tissue.membranes[state.punctured].puncture_N
        gives = pull > tip + _hold_N(state, inwards=True) + friction.static_in_N_m * length
    else:
        gives = pull < -(_hold_N(state, inwards=False) + friction.static_out_N_m * length)
    return np.full(_first(gives | (travel_m <= 0.0) & (length == 0.0)), length)


def _sliding_in(state: Insertion, travel_m: Array) -> Array:
    tissue, length = state.tissue, state.inserted_m
    tip = tissue.cutting_N if length == state.cut_m else 0.0
    c, held = tissue.friction.sliding_in_N_m, tip + _hold_N(state, inwards=True)
    stops = [each.depth_m for each in tissue.membranes if each.depth_m > length]
    if length < state.cut_m:
        stops.append(state.cut_m)
    lengths = travel_m - _root(tissue.quadratic_N_m2, tissue.linear_N_m + c, held + c * travel_m)
    return lengths[: _first((lengths <= length) | (lengths >= min(stops, default=np.inf)) | state.blocked)]


def _sliding_out(state: Insertion, travel_m: Array) -> Array:
    tissue, length = state.tissue, state.inserted_m
    c, held = tissue.friction.sliding_out_N_m, _hold_N(state, inwards=False)
    stop = max((each.depth_m for each in tissue.membranes if each.depth_m < length), default=0.0)
    lengths = travel_m + _root(tissue.quadratic_N_m2, tissue.linear_N_m - c, held + c * travel_m)
    return lengths[: _first((lengths >= length) | (lengths <= stop))]


def _hold_N(state: Insertion, *, inwards: bool) -> float:
    """What the edges of the holes around the shaft hold [N], as `Insertion` has it."""
    broken, length = state.tissue.membranes[: state.punctured], state.inserted_m
    return sum(each.hold_N for each in broken if each.depth_m < length or (inwards and each.depth_m == length))


def _root(a: float, b: float, c: Array) -> Array:
    """`tissue.models.needle.parameters.positive_root` of many, shape (n,)."""
    c = np.maximum(c, 0.0)
    return np.asarray(2.0 * c / (b + np.sqrt(b * b + 4.0 * a * c)))


def _first(ends: NDArray[np.bool_]) -> int:
    """Place of the first true one, or the number of all."""
    return int(np.argmax(ends)) if ends.any() else len(ends)
