"""Prony series against closed forms.

The exponential step is compared with the integral that it stands for.
"""

import numpy as np
import pytest
from prony_series import modulus_of, relaxation_of

from meshes.base.errors import InputError
from tissue.materials.prony import HereditaryIntegral, Prony

SERIES = Prony(g=(0.3, 0.3), tau_s=(0.5, 10.0))
"""The worked example that the published values below belong to."""


def test_relaxation():
    """Values to 1e-4, as tabulated with six digits."""
    expected = (0.942634, 0.712052, 0.510364, 0.400014)
    np.testing.assert_allclose(modulus_of(SERIES, [0.1, 1.0, 10.0, 100.0]), expected, atol=1e-6)


def respond(spectrum, inputs, step_s):
    """Response to an input given at every step's end, starting from rest."""
    state = HereditaryIntegral(spectrum, (1,), step_s=step_s)
    found = []
    for value in inputs:
        found.append(state.instant_factor * value + state.history[0])
        state.advance(np.array([value]))
    return np.array(found)


@pytest.mark.parametrize("step_s", [0.5, 0.01, 1e-3])
def test_ramp_and_hold(step_s):
    """Ramp of 1 s, then hold: exact at any step, since the strain is linear within each."""
    time = step_s * np.arange(1, round(10.0 / step_s) + 1)
    stress = respond(relaxation_of(SERIES), np.minimum(time, 1.0), step_s)
    picked = stress[[round(t / step_s) - 1 for t in (0.5, 1.0, 2.0, 10.0)]]
    np.testing.assert_allclose(picked, (0.441130, 0.815187, 0.675873, 0.516071), atol=1e-6)


def test_dynamic_moduli_from_the_stepped_integral():
    """A sine settles to the storage modulus in phase and the loss modulus in quadrature."""
    step, omega = 2.0 * np.pi / 2000, 1.0
    time = step * np.arange(1, 2000 * 25 + 1)
    stress = respond(relaxation_of(SERIES), np.sin(omega * time), step)[-2000:]
    turn = omega * time[-2000:]
    found = 2.0 * np.mean(stress * np.sin(turn)), 2.0 * np.mean(stress * np.cos(turn))
    # second order: step^2 / 12 is 1e-6
    np.testing.assert_allclose(found, (0.757030, 0.149703), atol=2e-6)


@pytest.mark.parametrize("seed", range(8))
def test_creep_is_the_inverse_of_relaxation(seed):
    """Creep is the inverse of relaxation.

    For random series over six decades the amplitudes, the interlaced times, and the product of the
    transforms are checked.
    """
    random = np.random.default_rng(seed)
    count = int(random.integers(1, 6))
    share = random.dirichlet(np.ones(count + 1))[:-1]
    series = Prony(tuple(share), tuple(np.sort(10.0 ** random.uniform(-3.0, 3.0, count))))
    creep = series.retardation
    assert (creep.amplitude > 0.0).all()
    assert 1.0 + creep.amplitude.sum() == pytest.approx(1.0 / (1.0 - sum(series.g)), rel=1e-9)
    times = np.sort(creep.time_s)
    assert (times > series.tau_s).all() and (times[:-1] < series.tau_s[1:]).all()
    for p in 10.0 ** random.uniform(-4.0, 4.0, 10):
        relaxing = 1.0 - np.sum(np.array(series.g) / (1.0 + p * np.array(series.tau_s)))
        creeping = 1.0 + np.sum(creep.amplitude / (1.0 + p * creep.time_s))
        assert relaxing * creeping == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("g", "tau_s", "words"),
    [
        ((0.3,), (1.0, 2.0), "one time for each"),
        ((), (), "at least one"),
        ((0.5, 0.5), (1.0, 2.0), "sum to less than 1"),
        ((-0.1,), (1.0,), r"g\[0\] must be positive"),
        ((0.1, float("nan")), (1.0, 2.0), r"g\[1\] must be positive"),
        ((0.1,), (0.0,), r"tau_s\[0\] must be positive"),
    ],
)
def test_bad_series(g, tau_s, words):
    """Refused where it enters."""
    with pytest.raises(InputError, match=words):
        Prony(g, tau_s)
