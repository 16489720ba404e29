"""Vibration that a device plays: its place, its size, and its effect on the loop."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hand_steps import STEP_S, held, meet

from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.hand.hand import hand_parameters
from tissue.haptics.hand_measures import PLAYED_FORCE, RAW_FORCE
from tissue.haptics.loop.critical_stiffness import (
    NARROW_STEPS,
    STEPS,
    _steps,
    critical_stiffness_N_m,
    in_hands,
)
from tissue.haptics.loop.sampled_loop import spectral_radius
from tissue.haptics.loop.stability_map import growth_while_running
from tissue.haptics.loop.vibration import ENVELOPE_S, PlayedForce, PlayedVibration, Vibration
from tissue.models.tissue_model import WallModel

SHARE = 0.2


def spectrum(force):
    """Amplitudes [N] by frequency [Hz] of a second of force."""
    return np.abs(np.fft.rfft(force - force.mean())) * 2.0 / len(force)


@pytest.mark.parametrize(("passing_Hz", "at_Hz"), [(40_000.0, 250), (1000.0, 250), (60.0, 60)])
def test_a_steady_force_vibrates_at_one_frequency_below_the_band_s_limit(passing_Hz, at_Hz):
    vibration = PlayedVibration(Vibration(passing_Hz, share=SHARE, step_s=STEP_S), limit_N=3.3)
    force = np.array([0.6, 0.0, 0.8])
    added = np.array([vibration.step(force) for _ in range(2000)])[1000:]
    along = added @ force
    np.testing.assert_allclose(added, along[:, None] * force, atol=1e-12)
    found = spectrum(along)
    assert found[at_Hz] == pytest.approx(SHARE, rel=1e-6) and np.delete(found, at_Hz).max() < 1e-6


def test_it_leaves_the_sum_within_the_device_s_limit_and_begins_anew_after_a_pause():
    vibration = PlayedVibration(Vibration(1000.0, share=1.0, step_s=STEP_S), limit_N=1.0)
    force = np.array([0.0, 0.0, 0.9])
    sums = np.array([force + vibration.step(force) for _ in range(500)])
    assert np.abs(sums).max() <= 1.0 + 1e-12 and sums[-50:].max() == pytest.approx(1.0)
    vibration.pause()
    assert np.abs(vibration.step(force)).max() <= 0.9 * STEP_S / ENVELOPE_S


def test_only_the_device_s_force_holds_it():
    """Only the device's force holds the vibration.

    On a wall with the device held at a depth, the played force less the vibration's columns is the
    force without vibration.
    """
    runs = []
    for share in (0.0, SHARE):
        motion = held(coupling__force_scale=1.0)
        if share:
            passing = Vibration(1000.0, share=share, step_s=STEP_S)
            teeth = PlayedVibration(passing, limit_N=3.3)
            motion._played = PlayedForce(device_parameters("touch").force_limit_N, vibration=teeth)
        motion.device = RecordedDevice(
            np.array([0.0, 0.2, 1.5]), np.array([[0, 0, 0.02], [0, 0, -2e-3], [0, 0, -2e-3]])
        )
        runs.append((meet(motion, WallModel(1e4, radius_m=5e-3), 1.2)[1], motion.measure_names))
    (still, _), (shaken, names) = runs
    first = names.index("vibration_x_N")
    np.testing.assert_allclose(shaken[300:, RAW_FORCE], still[300:, RAW_FORCE], atol=1e-12)
    added = shaken[300:, first : first + 3]
    assert np.abs(added).max() == pytest.approx(SHARE * still[-1, PLAYED_FORCE][2], rel=0.02)
    np.testing.assert_allclose(
        shaken[300:, PLAYED_FORCE] - added, still[300:, PLAYED_FORCE], atol=1e-9
    )


HELD = replace(
    in_hands(
        device_parameters("touch").loop(1.0, filter_s=1e-3),
        [hand_parameters("intermediate").grip[:3]],
    )[0],
    velocity_memory=0.85,
)
LOOPS = {
    "held": HELD,
    "let go": device_parameters("touch").loop(1.0, filter_s=1e-3),
    "late and slow": replace(HELD, delay_s=2.3e-3, model_ticks=3),
}


@pytest.mark.parametrize("loop", LOOPS.values(), ids=LOOPS)
def test_a_share_of_nothing_leaves_the_judged_loop_as_it_is(loop):
    for frequency in (250.0, 100.0 / 3.0, 37.31):
        still = replace(loop, vibration=Vibration(frequency, share=0.0, step_s=STEP_S))
        for stiffness in (10.0, 100.0, 1000.0, 5000.0):
            radii = [spectral_radius(each.with_stiffness(stiffness)) for each in (still, loop)]
            assert radii[0] == pytest.approx(radii[1], abs=1e-12)
        assert critical_stiffness_N_m(still) == pytest.approx(
            critical_stiffness_N_m(loop), rel=1e-9
        )


CASES = list(product(LOOPS, (250.0, 100.0 / 3.0, 8.0), (2.0,)))
QUICK = [
    ("held", 250.0, 0.5),
    ("let go", 8.0, 0.5),
    ("late and slow", 100.0 / 3.0, 0.5),
]


@pytest.mark.parametrize(
    ("name", "frequency_Hz", "share"),
    [*QUICK, *(pytest.param(*case, marks=pytest.mark.slow) for case in CASES)],
)
def test_a_run_with_it_fades_below_the_judged_stiffness_and_grows_above(name, frequency_Hz, share):
    loop = replace(LOOPS[name], vibration=Vibration(frequency_Hz, share=share, step_s=STEP_S))
    around = critical_stiffness_N_m(loop) * np.array([0.97, 1.03])
    below, above = growth_while_running([loop, loop], around, ticks=8000)
    assert below < 1.0 < above


def test_where_the_loop_rings_at_half_of_its_frequency_it_takes_stiffness():
    """Vibration takes stiffness where the loop rings at half of its frequency.

    This is parametric resonance: held, the loop rings at 19 Hz at its critical stiffness; far from
    38 Hz little changes.
    """
    critical = critical_stiffness_N_m(HELD)
    with_it = {
        frequency: critical_stiffness_N_m(
            replace(HELD, vibration=Vibration(frequency, share=1.0, step_s=STEP_S))
        )
        for frequency in (250.0, 100.0, 40.0, 37.5)
    }
    assert all(with_it[far] == pytest.approx(critical, rel=1e-3) for far in (250.0, 100.0))
    assert with_it[40.0] == pytest.approx(0.947 * critical, rel=0.01)
    assert with_it[37.5] == pytest.approx(0.820 * critical, rel=0.01)


@pytest.mark.parametrize(
    ("frequency_Hz", "ticks", "judged_Hz"),
    [(250.0, 4, 250.0), (37.31, 134, 5e3 / 134), (3.0, 200, 5.0)],
)
def test_a_long_period_is_judged_by_the_nearest_short_one(frequency_Hz, ticks, judged_Hz):
    factors = Vibration(frequency_Hz, share=SHARE, step_s=STEP_S).period()
    assert factors.shape == (1, ticks)
    np.testing.assert_allclose(
        factors[0],
        [Vibration(judged_Hz, share=SHARE, step_s=STEP_S).factor(tick) for tick in range(ticks)],
        atol=1e-12,
    )


def test_the_search_is_finer_from_a_quarter_of_the_vibration_on():
    """The mass rings at f / 4 with the stiffness (m + m_hand) (pi f / 2)^2, hand included."""
    loop = device_parameters("touch").loop(800.0)
    loop = replace(loop, vibration=Vibration(100.0, share=0.1, step_s=1e-3))
    rings_N_m = (loop.mass_kg + loop.hand_mass_kg) * (50.0 * np.pi) ** 2
    stiffness_N_m = rings_N_m - loop.hand_stiffness_N_m
    assert _steps(0.99 * stiffness_N_m, loop) == STEPS
    assert _steps(1.01 * stiffness_N_m, loop) == NARROW_STEPS
