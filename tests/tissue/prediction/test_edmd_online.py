"""Online learning: recursive least squares against the fit of all data.

The tests cover change, rest, and wild samples.
"""

import numpy as np
import pytest
from koopman_systems import duffing, record

from tissue import InputError
from tissue.prediction.edmd.dictionary import Identity, Polynomials
from tissue.prediction.edmd.edmd import Edmd
from tissue.prediction.edmd.online import Online


def swings(rng, count=8, field=duffing):
    return record(field, rng.uniform(-1.0, 1.0, (count, 2)), rng.normal(size=(count, 150)), 0.02)


def learn(online, episodes, lift):
    """Give every step; the errors before learning."""
    errors = []
    for each in episodes:
        lifted = lift(each.states)
        errors += [
            online.update(lifted[k], each.inputs[k], lifted[k + 1]) for k in range(len(lifted) - 1)
        ]
    return np.array(errors)


@pytest.mark.parametrize("offset", [True, False], ids=["offset", "bare"])
def test_without_forgetting_it_is_the_fit_of_all_data(offset):
    episodes = swings(np.random.default_rng(0))
    edmd = Edmd(Polynomials(2), cap=None, offset=offset)
    online = Online(edmd.fit(episodes[:4]), forgetting=1.0, gain_limit=1e5)
    learn(online, episodes[4:], Polynomials(2).lift)
    found, all_of_them = online.operator(cap=None), edmd.fit(episodes)
    # Where it starts from counts as one sample of size 1 / (4 gain_limit²).
    for one, other in (
        (found.A, all_of_them.A),
        (found.B, all_of_them.B),
        (found.offset, all_of_them.offset),
    ):
        assert one == pytest.approx(other, abs=1e-8)


def spring(states, inputs=0.0, stiffness=1.0):
    """A damped linear oscillator."""
    place, speed = states[..., 0], states[..., 1]
    return np.stack([speed, -0.5 * speed - stiffness * place + inputs], axis=-1)


def test_a_changed_system_is_learnt_within_some_memories():
    rng = np.random.default_rng(1)
    start = Edmd(Identity()).fit(swings(rng, field=spring))
    online = Online(start, forgetting=0.98)
    changed = swings(rng, 8, lambda states, inputs=0.0: spring(states, inputs, 3.0))
    errors = learn(online, changed, Identity().lift)
    truth = Edmd(Identity()).fit(changed)
    # The memory is 50 samples: eight of them leave e^-8 of what was known before.
    assert errors[400:].mean() < 1e-3 * errors[:10].mean()
    assert np.abs(online.operator().A - truth.A).max() < 1e-3 * np.abs(start.A - truth.A).max()


def gain_bound(online):
    """Return the largest gain that any next sample could have now.

    It is half the root of the covariance's largest eigenvalue.
    """
    return 0.5 * float(np.sqrt(np.linalg.eigvalsh(online._covariance)[-1] / online._forgetting))


@pytest.mark.parametrize("forgetting", [0.9, 0.99, 0.999])
@pytest.mark.parametrize("limit", [0.1, 1.0, 10.0])
def test_the_gain_stays_bounded_at_rest(forgetting, limit):
    """The gain stays bounded at rest.

    Nothing is excited there: plain forgetting would multiply the covariance by 1 / forgetting every
    sample.
    """
    rng = np.random.default_rng(2)
    operator = Edmd(Polynomials(2)).fit(swings(rng))
    online, rest = (
        Online(operator, forgetting=forgetting, gain_limit=limit),
        operator.dictionary.lift(np.zeros(2)),
    )
    largest = gain_bound(online)
    for tick in range(3000):
        online.update(rest, np.zeros(1), rest)
        if tick % 50 == 0:
            largest = max(largest, gain_bound(online))
    assert largest <= limit * (1.0 + 1e-9)
    assert forgetting**-3000 > 20.0
    # It learnt that rest stays rest, and kept what it knew of the rest: the surprise after it
    # throws nothing away.
    found = online.operator(cap=None)
    assert found.advance(rest, np.zeros(1)) == pytest.approx(rest, abs=1e-3)


@pytest.mark.parametrize("seed", range(3))
def test_the_gain_stays_bounded_under_anything(seed):
    rng = np.random.default_rng(seed)
    operator = Edmd(Polynomials(2)).fit(swings(rng))
    online = Online(operator, forgetting=0.95, gain_limit=0.5)
    for tick in range(1500):
        burst = 10.0 ** rng.uniform(-6, 2) if rng.random() < 0.1 else 1e-3
        lifted = operator.middle + burst * operator.scale * rng.normal(size=5)
        online.update(
            lifted, burst * rng.normal(size=1), operator.middle + 1e-3 * rng.normal(size=5)
        )
        if tick % 50 == 0:
            assert gain_bound(online) <= 0.5 * (1.0 + 1e-9)


def test_a_sample_that_is_not_finite_teaches_nothing():
    operator = Edmd(Identity()).fit(swings(np.random.default_rng(3)))
    online = Online(operator)
    before = online.operator(cap=None).A
    good = np.array([0.1, 0.2])
    for lifted, after in ((np.array([np.nan, 0.0]), good), (good, np.array([0.0, np.inf]))):
        assert np.isnan(online.update(lifted, np.zeros(1), after))
    assert np.array_equal(online.operator(cap=None).A, before)
    assert np.isfinite(online.update(good, np.zeros(1), good))


def test_it_starts_as_the_operator_it_is_given():
    operator = Edmd(Polynomials(3)).fit(swings(np.random.default_rng(4)))
    found = Online(operator).operator()
    for name in ("A", "B", "offset"):
        assert getattr(found, name) == pytest.approx(getattr(operator, name), abs=1e-12)


def test_bad_options_are_refused():
    operator = Edmd(Identity()).fit(swings(np.random.default_rng(5)))
    with pytest.raises(InputError, match=r"forgetting must be in \[0.5, 1\], got 1.1: use 0.999"):
        Online(operator, forgetting=1.1)
    with pytest.raises(InputError, match="gain_limit must be positive and finite, got 0"):
        Online(operator, gain_limit=0.0)


@pytest.mark.parametrize("forgetting", [0.9, 0.98])
def test_what_was_known_weighs_as_one_memory_of_samples(forgetting):
    """Earlier knowledge has the weight of one memory of samples.

    The reference is weighted least squares, written out: the fit's own samples count as 1 / (1 -
    forgetting) samples of their kind. A new sample k steps ago has the weight forgetting^k. The
    units are the fit's means and deviations, and the gain is not bounded.
    """
    rng = np.random.default_rng(5)
    known = swings(rng, 6)
    fresh = record(duffing, rng.uniform(-1.0, 1.0, (1, 2)), rng.normal(size=(1, 13)), 0.02)[0]
    start = Edmd(Identity(), cap=None, offset=True).fit(known)
    online = Online(start, forgetting=forgetting, gain_limit=1e5)
    learn(online, [fresh], Identity().lift)

    def rows(episode):
        given = (np.hstack([episode.states[:-1], episode.inputs[:-1]]) - middle) / scale
        after = (episode.states[1:] - start.middle) / start.scale
        return np.column_stack([given, np.ones(len(given))]), after

    middle = np.concatenate([start.middle, start.input_middle])
    scale = np.concatenate([start.scale, start.input_scale])
    parts = [rows(each) for each in known]
    given, after = (np.vstack(each) for each in zip(*parts, strict=True))
    before = np.linalg.lstsq(given, after, rcond=None)[0]
    memory = round(1.0 / (1.0 - forgetting)) / len(given)
    new, seen = rows(fresh)
    weights = forgetting ** np.arange(len(new) - 1, -1, -1.0)
    old = forgetting ** len(new) * memory * given.T @ given
    wanted = np.linalg.solve(
        old + (new * weights[:, None]).T @ new, old @ before + (new * weights[:, None]).T @ seen
    )
    found = online.operator(cap=None)
    linear = wanted[:-1].T * start.scale[:, None] / scale
    of_states, of_inputs = np.split(linear, [len(start.scale)], axis=1)
    np.testing.assert_allclose(found.A, of_states, atol=1e-7)
    np.testing.assert_allclose(found.B, of_inputs, atol=1e-7)
    constant = wanted[-1] * start.scale + start.middle - linear @ middle
    assert found.offset == pytest.approx(constant, abs=1e-7)
    assert np.abs(found.A - start.A).max() > 1e-4
