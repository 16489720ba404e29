"""Transients of events: when one is played, its band, its mean, its limits."""

import numpy as np
import pytest

from tissue import load_scene, simulate
from tissue.haptics.loop.vibration import CUE_HZ, Cues, TouchEvents
from tissue.models.tissue_model import Response

TICK = 1e-3
FREE, SOFT, HARD = ([0.0, 0.0], [1e-6, 0.0], [1e-6, 2e-6])


def events(*spans):
    """Ticks at which events begin, for areas by layer over numbers of ticks."""
    seen = TouchEvents()
    areas = [area for area, ticks in spans for _ in range(ticks)]
    return [tick for tick, area in enumerate(areas) if seen.step(np.array(area))]


def test_a_first_contact_counts_and_a_bounce_does_not():
    assert events((FREE, 50), (SOFT, 100), (FREE, 20), (SOFT, 200)) == [50]
    assert events((FREE, 50), (SOFT, 200), (FREE, 150), (SOFT, 50)) == [50, 400]


def test_another_layer_counts_once_it_has_stayed_a_hundredth_of_a_second():
    assert events((SOFT, 200), (HARD, 100)) == [0, 209]
    assert events((SOFT, 200), (HARD, 5), (SOFT, 100)) == [0]


def test_a_puncture_comes_at_least_a_tenth_of_a_second_after_the_touch():
    assert events((SOFT, 50), (HARD, 200)) == [0]  # the layer is taken note of and not played
    assert events((SOFT, 150), (HARD, 200)) == [0, 159]


def played(amplitude_N=0.3, force=(0.0, 0.0, 1.0), limit_N=3.3, slew_N=10.0):
    cues, response = (
        Cues(amplitude_N, limit_N=limit_N, slew_N=slew_N),
        Response.empty(2),
    )
    response.engaged_m2[:] = SOFT
    return np.array([cues.step(np.array(force), response) for _ in range(100)])


def test_a_transient_lies_in_its_band_along_the_force_and_has_no_mean():
    burst = played(force=(0.0, 3.0, 4.0), limit_N=100.0)
    np.testing.assert_allclose(burst[:, 0], 0.0)
    np.testing.assert_allclose(burst[:, 1] / 3.0, burst[:, 2] / 4.0, atol=1e-15)
    along = np.linalg.norm(burst, axis=1)
    assert along.max() == pytest.approx(0.3, rel=0.1) and (along[40:] == 0.0).all()
    assert abs(burst.sum(axis=0)).max() < 1e-12
    power = np.abs(np.fft.rfft(burst[:, 2], 4000)) ** 2
    frequency = np.fft.rfftfreq(4000, TICK)
    near = np.abs(frequency - CUE_HZ) < 60.0
    assert power[near].sum() > 0.98 * power.sum()


def test_it_fits_the_device():
    assert np.abs(played(force=(0.0, 0.0, 3.2))[:, 2]).max() <= 0.1 + 1e-12  # 3.2 of 3.3 N are used
    steps = np.diff(played(amplitude_N=1.0, slew_N=0.2)[:, 2])
    assert np.abs(steps).max() <= 0.1 + 1e-12


@pytest.mark.parametrize(("name", "count"), [("needle", 4), ("wall", 1)])
@pytest.mark.slow
def test_a_run_plays_one_for_each_event(name, count):
    """A run plays one cue for each event.

    The needle touches, passes the capsule, touches the vessel wall and passes it; the wall is
    touched.
    """
    trace = simulate(load_scene(name, {"device": "touch", "output.cue_N": 0.3})).trace
    cue = trace.vectors("cue", "N")
    there = np.linalg.norm(cue, axis=1) > 0.0
    assert np.count_nonzero(np.diff(there.astype(int)) == 1) == count
