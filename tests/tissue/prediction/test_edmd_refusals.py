"""Data and options that no operator can be learnt from: each is refused with its remedy."""

import numpy as np
import pytest
from koopman_systems import duffing, record

from tissue import InputError
from tissue.prediction.edmd.dictionary import Delays, DictionarySum, Identity
from tissue.prediction.edmd.dictionary_file import from_plain
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.episodes import Episode
from tissue.prediction.edmd.gap_products import GapProducts
from tissue.prediction.edmd.polynomials import Polynomials
from tissue.prediction.edmd.radial import Gaussians, ThinPlates
from tissue.prediction.edmd.validation import choose, horizon_errors

CENTRES = ((0.1, -0.2), (0.5, 0.4), (-0.7, 0.0))


def swings(rng, count=10, rows=120, driven=True):
    inputs = rng.normal(size=(count, rows)) if driven else np.zeros((count, rows))
    return record(duffing, rng.uniform(-1.0, 1.0, (count, 2)), inputs, 0.02)


def row(values, step=1e-3, inputs=None):
    return Episode(np.asarray(values, dtype=float), inputs, step)


SWING = record(duffing, np.random.default_rng(0).uniform(-1, 1, (2, 2)), np.zeros((2, 60)), 1e-3)
BAD = {
    "none": (Edmd(Identity()), [], "episodes must hold at least one episode, got none: record one"),
    "not finite": (
        Edmd(Identity()),
        [row([[0.0, 1.0], [np.nan, 2.0], [1.0, 0.0]])],
        "states of episode 0 must be finite, got nan in row 1, column 0: cut the episode there",
    ),
    "infinite input": (
        Edmd(Identity()),
        [row(SWING[0].states, inputs=np.full((60, 1), np.inf))],
        "inputs of episode 0 must be finite, got inf in row 0, column 0: cut the episode there",
    ),
    "constant": (
        Edmd(Identity()),
        [row(np.column_stack([SWING[0].states, np.full(60, 0.3)]))],
        "column 2 of states must vary, got 0.3 throughout: leave it out",
    ),
    "constant input": (
        Edmd(Identity()),
        [row(SWING[0].states, inputs=np.full((60, 1), 0.5))],
        "column 0 of inputs must vary, got 0.5 throughout: leave it out",
    ),
    "collinear": (
        Edmd(Identity()),
        [row(np.column_stack([SWING[0].states, SWING[0].states[:, 0] * 3.0 + 1.0]))],
        "observables and inputs must be independent, got number [02] as a combination of the others",
    ),
    "too short": (
        Edmd(Delays(5)),
        [SWING[0], row(SWING[0].states[:6])],
        "episode 1 must have at least 7 rows for 5 delays, got 6: leave it out or take fewer delays",
    ),
    "mixed rates": (
        Edmd(Identity()),
        [SWING[0], row(SWING[0].states, step=2e-3)],
        "step_s must be the same in all episodes, got 0.001 in 0 and 0.002 in 1: resample them to one rate",
    ),
    "mixed columns": (
        Edmd(Identity()),
        [SWING[0], row(SWING[0].states[:, :1])],
        r"the same columns of states and inputs, got \(2, 0\) in 0 and \(1, 0\) in 1",
    ),
    "inputs of another length": (
        Edmd(Identity()),
        [row(SWING[0].states, inputs=np.zeros((59, 1)))],
        "inputs of episode 0 must have one row for each of 60 states, got 59",
    ),
    "text": (Edmd(Identity()), [Episode("abc", None, 1e-3)], "states of episode 0 must be a table of numbers, got str"),
    "one row": (Edmd(Identity()), [Episode(np.zeros(4), None, 1e-3)], r"must have shape \(rows, columns\), got \(4,\)"),
    "no step": (Edmd(Identity()), [row(SWING[0].states, step=0.0)], "step_s of episode 0 must be positive"),
    "column": (
        Edmd(Polynomials(2, columns=(2,))),
        SWING,
        r"columns must be in \[0, 1\], got 2: the state has 2 entries",
    ),
    "middle": (Edmd(Polynomials(2, middle=(1.0,))), SWING, "middle must be one number for each of 2 entries, got 1"),
    "centres": (Edmd(Gaussians(((1.0,),))), SWING, "centres must have 2 columns as the state has, got 1"),
    "gap": (Edmd(GapProducts((0.0, 0.0, 1.0))), SWING, r"columns must be in \[0, 1\], got 2"),
    "few": (
        Edmd(Polynomials(4)),
        [row(SWING[0].states[:9])],
        "episodes must hold at least 15 samples, got 8: record more, or set ridge=1e-6",
    ),
    "overflow": (
        Edmd(Polynomials(9)),
        [row(1e40 * SWING[0].states)],
        "observables must be finite on all states, got overflow",
    ),
    "rank": (Edmd(Identity(), rank=9), SWING, r"rank must be in \[1, 3\]"),
}


@pytest.mark.parametrize(("edmd", "episodes", "sentence"), BAD.values(), ids=BAD)
def test_bad_data_are_refused_with_the_remedy(edmd, episodes, sentence):
    with pytest.raises(InputError, match=sentence):
        edmd.fit(episodes)


def test_collinear_data_can_be_had_with_ridge_or_rank():
    episodes = [row(np.column_stack([e.states, e.states[:, 0] * 3.0 + 1.0])) for e in SWING]
    for edmd in (Edmd(Identity(), ridge=1e-10), Edmd(Identity(), rank=3)):
        found = edmd.fit(episodes)
        assert horizon_errors(found, episodes, 1).relative[0] < 0.01


OTHER_BAD = {
    "ridge": (lambda: Edmd(Identity(), ridge=-1.0), "ridge must be at least 0"),
    "cap": (lambda: Edmd(Identity(), cap=0.0), "cap must be positive"),
    "order": (lambda: Polynomials(1), "order must be a whole number of at least 2, got 1"),
    "scale": (lambda: Polynomials(2, scales=(0.0,)), "scales must be positive"),
    "lags": (lambda: Delays(-1), "lags must be a whole number of at least 0"),
    "delays of delays": (lambda: Delays(1, Delays(2)), "inner must have no delays, got 2 lags"),
    "delays in a sum": (
        lambda: DictionarySum((Delays(2),)),
        "parts must have no delays, got 2 lags: put Delays around the sum",
    ),
    "centres": (lambda: Gaussians(()), "centres must be a finite table"),
    "width": (lambda: Gaussians(CENTRES, width=0.0), "width must be positive"),
    "radial scales": (lambda: ThinPlates(CENTRES, scales=(1.0,)), "scales must be 2 positive numbers"),
    "gap": (lambda: GapProducts((0.0,)), "normal must be finite and not zero"),
    "too many centres": (
        lambda: Gaussians.from_states(SWING[0].states[:3], 4, np.random.default_rng(0)),
        r"count must be in \[1, 3\], the number of different states, got 4",
    ),
    "no rates": (
        lambda: Edmd(Identity()).fit_generator([row(SWING[0].states)]),
        "rates of episode 0 must have the shape",
    ),
    "no candidates": (lambda: choose({}, SWING, horizon=1), "candidates must hold at least one"),
    "folds": (lambda: choose({"it": Edmd(Identity())}, SWING, horizon=1, folds=3), r"folds must be in \[2, 2\]"),
    "horizon": (lambda: horizon_errors(Edmd(Identity()).fit(SWING), SWING, 60), "longer than 60 rows"),
    "other inputs": (
        lambda: horizon_errors(Edmd(Identity()).fit(SWING), swings(np.random.default_rng(0)), 1),
        "must have 2 columns of states and 0 of inputs, as the operator, got 2 and 1",
    ),
    "not finite": (
        lambda: horizon_errors(Edmd(Identity()).fit(SWING), [row(np.full((9, 2), np.nan))], 1),
        "states of episode 0 must be finite",
    ),
    "kind": (lambda: from_plain({"kind": "os.system"}), "kind must be one of Identity, Polynomials"),
    "field": (lambda: from_plain({"kind": "Polynomials", "orders": 2}), "must have the fields of this version"),
}


@pytest.mark.parametrize(("make", "sentence"), OTHER_BAD.values(), ids=OTHER_BAD)
def test_bad_options_are_refused(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


def test_bad_calls_of_an_operator_are_refused():
    operator = Edmd(Delays(1)).fit(swings(np.random.default_rng(0)))
    state, push = np.zeros((2, 2)), np.zeros((3, 1))
    for call, sentence in (
        (lambda: operator.predict(state[0], push, 3), r"state must have shape \(2, 2\), oldest row first"),
        (lambda: operator.predict(state, None, 3), "inputs must have 1 columns, got None"),
        (lambda: operator.predict(state, push[:2], 3), r"inputs must have shape \(3, 1\) or \(1,\)"),
        (lambda: operator.predict(state, push, 0), "horizon must be at least 1 step, got 0"),
    ):
        with pytest.raises(InputError, match=sentence):
            call()


def test_an_operator_without_a_logarithm_is_refused():
    flips = [row([[(-0.5) ** k * a] for k in range(9)]) for a in (1.0, 2.0)]
    with pytest.raises(InputError, match="eigenvalues must be neither zero nor negative to have a logarithm"):
        Edmd(Identity()).fit(flips).generator()
