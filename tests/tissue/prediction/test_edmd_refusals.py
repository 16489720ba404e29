"""Data and options that no operator can be learnt from: each is refused with its remedy."""

import numpy as np
import pytest
from koopman_systems import duffing, record

from tissue import InputError
from tissue.prediction.edmd.dictionary import Delays, Gaussians, Identity, Polynomials
from tissue.prediction.edmd.edmd import Edmd, Episode, horizon_errors
from tissue.prediction.edmd.predictor_file import from_plain

CENTRES = ((0.1, -0.2), (0.5, 0.4), (-0.7, 0.0))


def swings(rng, count=10, rows=120, driven=True):
    inputs = rng.normal(size=(count, rows)) if driven else np.zeros((count, rows))
    return record(duffing, rng.uniform(-1.0, 1.0, (count, 2)), inputs, 0.02)


def row(values, step=1e-3, inputs=None):
    return Episode(np.asarray(values, dtype=float), inputs, step)


SWING = record(duffing, np.random.default_rng(0).uniform(-1, 1, (2, 2)), np.zeros((2, 60)), 1e-3)
BAD = {
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
        (
            "observables and inputs must be independent, got number [02] as a combination of the "
            "others"
        ),
    ),
    "too short": (
        Edmd(Delays(5)),
        [SWING[0], row(SWING[0].states[:6])],
        (
            "episode 1 must have at least 7 rows for 5 delays, got 6: leave it out or take fewer "
            "delays"
        ),
    ),
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
    "cap": (lambda: Edmd(Identity(), cap=0.0), "cap must be positive"),
    "too many centres": (
        lambda: Gaussians.from_states(SWING[0].states[:3], 4, np.random.default_rng(0)),
        r"count must be in \[1, 3\], the number of different states, got 4",
    ),
    "horizon": (
        lambda: horizon_errors(Edmd(Identity()).fit(SWING), SWING, 60),
        "longer than 60 rows",
    ),
    "not finite": (
        lambda: horizon_errors(Edmd(Identity()).fit(SWING), [row(np.full((9, 2), np.nan))], 1),
        "states of episode 0 must be finite",
    ),
    "kind": (
        lambda: from_plain({"kind": "os.system"}),
        "kind must be one of Identity, Polynomials",
    ),
    "field": (
        lambda: from_plain({"kind": "Polynomials", "orders": 2}),
        "must have the fields of this version",
    ),
}


@pytest.mark.parametrize(("make", "sentence"), OTHER_BAD.values(), ids=OTHER_BAD)
def test_bad_options_are_refused(make, sentence):
    with pytest.raises(InputError, match=sentence):
        make()


def test_no_step_ahead_is_refused():
    operator = Edmd(Identity()).fit(SWING)
    with pytest.raises(InputError, match="horizon must be at least 1 step, got 0"):
        operator.predict(np.zeros(2), None, 0)


def test_an_operator_without_a_logarithm_is_refused():
    flips = [row([[(-0.5) ** k * a] for k in range(9)]) for a in (1.0, 2.0)]
    with pytest.raises(
        InputError, match="eigenvalues must be neither zero nor negative to have a logarithm"
    ):
        Edmd(Identity()).fit(flips).generator()
