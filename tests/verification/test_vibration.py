"""Tooth passing above half the tick rate.

Plain sampling turns it into a slow force, ours does not.
"""

import numpy as np
import pytest

from tissue.haptics.loop.vibration import BAND_LIMIT_HZ, Vibration

RATE_HZ, TICKS, MEAN_N, SHARE = 1000.0, 4000, 2.0, 0.2
TIMES_S = np.arange(TICKS) / RATE_HZ


def slow_amplitude(force, below_Hz=100.0):
    """Return the largest amplitude [N] of the force's spectrum between 0 and a frequency.

    The mean is left out.
    """
    spectrum = np.abs(np.fft.rfft(force - force.mean())) * 2.0 / len(force)
    return spectrum[np.fft.rfftfreq(len(force), 1.0 / RATE_HZ) < below_Hz].max()


def rendered(passing_Hz):
    vibration = Vibration(passing_Hz, share=SHARE, step_s=1.0 / RATE_HZ)
    return MEAN_N * (1.0 + np.array([vibration.factor(tick) for tick in range(TICKS)]))


@pytest.mark.parametrize("passing_Hz", [40_003.0, 1005.0, 2997.0])
def test_plain_sampling_aliases_and_ours_does_not(passing_Hz):
    sampled = MEAN_N * (1.0 + SHARE * np.cos(2.0 * np.pi * passing_Hz * TIMES_S))
    print(
        f"\n{passing_Hz:g} Hz: slow force {slow_amplitude(sampled):.3f} N sampled, "
        f"{slow_amplitude(rendered(passing_Hz)):.1e} N rendered"
    )
    assert slow_amplitude(sampled) == pytest.approx(SHARE * MEAN_N, rel=0.01)
    assert slow_amplitude(rendered(passing_Hz)) < 1e-9


def test_mean_and_strength_are_kept():
    force = rendered(40_000.0)
    assert force.mean() == pytest.approx(MEAN_N, rel=1e-12)
    assert np.sqrt(2.0) * force.std() == pytest.approx(SHARE * MEAN_N, rel=1e-9)


def test_slow_passing_keeps_its_own_frequency():
    assert Vibration(33.3, share=0.1, step_s=1e-3).frequency_Hz == 33.3
    assert Vibration(40_000.0, share=0.1, step_s=1e-3).frequency_Hz == BAND_LIMIT_HZ
    assert BAND_LIMIT_HZ < 0.5 * RATE_HZ
