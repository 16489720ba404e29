"""People who discriminate stimuli: null data, and what a mapping can and cannot do."""

import numpy as np
import pytest

from tissue.evaluation.calibration.observers import (
    SimulatedObservers,
    Stimulus,
    calibrated_commands,
    gain_of,
    share_right,
)
from tissue.perception.laws import D_PRIME_75, correct_of_d_prime
from tissue.perception.observer import reference_observer


def people(count, **given):
    """People like the reference observer, without lapses."""
    usual = {
        "alpha": 1.0,
        "beta": reference_observer().beta,
        "kappa": 0.07,
        "offset_N": 0.2,
        "lapse": 0.0,
        "sigma": 0.2,
    }
    return SimulatedObservers(
        **{name: np.full(count, given.get(name, value)) for name, value in usual.items()}
    )


def test_an_observer_like_the_reference_gains_nothing():
    """An observer like the reference gains nothing.

    If it is known exactly, not one answer changes; calibrated by numbers, the interval of the
    change holds zero.
    """
    rng, crowd = np.random.default_rng(2), people(100)
    stimuli = Stimulus(1.0, 0.05), Stimulus(1.1, 0.05)
    plain = share_right(crowd, *stimuli, seed=1)
    assert (
        share_right(crowd, *stimuli, seed=1, commands=calibrated_commands(crowd, rng, numbers=0))
        == plain
    ).all()
    gain = gain_of(
        plain, share_right(crowd, *stimuli, seed=1, commands=calibrated_commands(crowd, rng)), rng
    )
    assert gain.low < 0.0 < gain.high and abs(gain.value) < 1.0


def test_shares_follow_from_the_distance():
    """Shares follow from the distance.

    Without scatter they are Phi(d'/sqrt 2); with scatter e before the mapping they use d' / sqrt(1
    + e^2); 40,000 answers.
    """
    crowd, threshold = people(400), 0.07 * 1.2
    for scatter in (0.0, 0.1):
        share = share_right(crowd, Stimulus(1.0, scatter), Stimulus(1.1, scatter), seed=1).mean()
        distance = D_PRIME_75 * 0.1 / threshold
        felt_scatter = D_PRIME_75 * scatter / threshold
        # thresholds are taken at the smaller force, so that scatter counts a little more than to
        # first order
        assert share == pytest.approx(
            float(correct_of_d_prime(distance / np.hypot(1.0, felt_scatter))), abs=0.02
        )


def test_a_mapping_cannot_help_against_scatter():
    """A mapping cannot help against scatter of the force.

    Where the scatter decides, no exponent changes the answers. Where the person's noise decides,
    every exponent does.
    """
    rng = np.random.default_rng(3)
    for beta, sign in ((1.1, 1.0), (2.3, -1.0)):
        crowd = people(100, beta=beta)
        commands = calibrated_commands(crowd, rng, numbers=0)
        changes = []
        for scatter in (0.0, 0.5):
            stimuli = Stimulus(1.0, scatter), Stimulus(1.0 + 0.1 + scatter, scatter)
            before, after = (
                share_right(crowd, *stimuli, seed=4, commands=each).mean()
                for each in (None, commands)
            )
            changes.append(after - before)
        assert sign * changes[0] > 0.02 and abs(changes[1]) < 0.3 * abs(changes[0])
