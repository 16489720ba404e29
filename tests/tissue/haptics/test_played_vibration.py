"""The vibration that a device plays: where it lies, how great it is, and what it does to the loop."""

from dataclasses import replace

import numpy as np
import pytest
from hand_steps import STEP_S, held, meet

from tissue.haptics.device.device import device_parameters
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.device.simulated import SimulatedDevice
from tissue.haptics.hand.hand import Hand, hand_parameters
from tissue.haptics.hand.minimum_jerk import waypoints
from tissue.haptics.hand_measures import PLAYED_FORCE, RAW_FORCE
from tissue.haptics.hand_motion import HandMotion
from tissue.haptics.loop.critical_stiffness import judge
from tissue.haptics.proxy.held_tool import PressingTool
from tissue.haptics.renderer import renderer
from tissue.haptics.vibration import ENVELOPE_S, PlayedVibration, Vibration
from tissue.models.wall import WallModel
from tissue.motion.motion import FollowPath

SHARE = 0.2


def spectrum(force):
    """Amplitudes [N] by frequency [Hz] of a second of force."""
    return np.abs(np.fft.rfft(force - force.mean())) * 2.0 / len(force)


@pytest.mark.parametrize(("passing_Hz", "at_Hz"), [(40_000.0, 250), (1000.0, 250), (60.0, 60)])
def test_a_steady_force_vibrates_at_one_frequency_below_the_band_s_limit(passing_Hz, at_Hz):
    vibration = PlayedVibration(Vibration(passing_Hz, share=SHARE, step_s=STEP_S), limit_N=3.3, step_s=STEP_S)
    force = np.array([0.6, 0.0, 0.8])
    added = np.array([vibration.step(force) for _ in range(2000)])[1000:]
    along = added @ force
    np.testing.assert_allclose(added, along[:, None] * force, atol=1e-12)
    found = spectrum(along)
    assert found[at_Hz] == pytest.approx(SHARE, rel=1e-6) and np.delete(found, at_Hz).max() < 1e-6


def test_it_leaves_the_sum_within_the_device_s_limit_and_begins_anew_after_a_pause():
    vibration = PlayedVibration(Vibration(1000.0, share=1.0, step_s=STEP_S), limit_N=1.0, step_s=STEP_S)
    force = np.array([0.0, 0.0, 0.9])
    sums = np.array([force + vibration.step(force) for _ in range(500)])
    assert np.abs(sums).max() <= 1.0 + 1e-12 and sums[-50:].max() == pytest.approx(1.0)
    vibration.pause()
    assert np.abs(vibration.step(force)).max() <= 0.9 * STEP_S / ENVELOPE_S


def test_only_the_device_s_force_holds_it():
    """A wall, the device held at a depth: the played force less the vibration's columns is the force without it."""
    runs = []
    for share in (0.0, SHARE):
        motion = held(coupling__force_scale=1.0)
        if share:
            passing = Vibration(1000.0, share=share, step_s=STEP_S)
            motion._vibration = PlayedVibration(passing, limit_N=3.3, step_s=STEP_S)
        motion.device = RecordedDevice(
            np.array([0.0, 0.2, 1.5]), np.array([[0, 0, 0.02], [0, 0, -2e-3], [0, 0, -2e-3]])
        )
        runs.append((meet(motion, WallModel(1e4, radius_m=5e-3), 1.2)[1], motion.measure_names))
    (still, _), (shaken, names) = runs
    first = names.index("vibration_x_N")
    np.testing.assert_allclose(shaken[300:, RAW_FORCE], still[300:, RAW_FORCE], atol=1e-12)
    added = shaken[300:, first : first + 3]
    assert np.abs(added).max() == pytest.approx(SHARE * still[-1, PLAYED_FORCE][2], rel=0.02)
    np.testing.assert_allclose(shaken[300:, PLAYED_FORCE] - added, still[300:, PLAYED_FORCE], atol=1e-9)


def test_at_its_greatest_it_does_not_destabilise_a_loop_at_95_per_cent_of_the_critical_stiffness():
    """A small gain of the change that comes back: share / sqrt(1 + (2 pi f tau)^2) at 250 Hz, where the hand's mass
    yields a thousandth of what it does at its ringing; the ripple below 100 Hz settles as it does without."""
    limits = replace(device_parameters("touch"), friction_N=0.0, encoder_step_m=0.0)
    quiet = dict.fromkeys(("endpoint_noise", "force_noise", "tremor_m", "reflex_share"), 0.0)
    person = replace(hand_parameters("expert"), **quiet)
    critical = judge(limits.loop(1.0, filter_s=1e-3), [person.grip[:3]]).critical_N_m
    stiffness = 1.0 / (1.0 / (0.95 * critical) - 1.0 / 2e4)
    line = np.array([[0.0, 0.0, 1e-3], [0.0, 0.0, -5e-3]])
    loop, settled = limits.loop(stiffness, filter_s=1e-3), []
    for share in (0.0, 1.0):
        hand = Hand(person, waypoints(np.array([0.0, 0.1]), line), rng=np.random.default_rng(0))
        teeth = PlayedVibration(Vibration(1000.0, share=share, step_s=STEP_S), limit_N=3.3, slew_N=0.66, step_s=STEP_S)
        motion = HandMotion(
            SimulatedDevice(limits, hand, position_m=(0.0, 0.0, 1e-3)),
            PressingTool(stiffness, line[0]),
            renderer("proxy", loop),
            scripted=FollowPath(line, feed_m_s=0.06, axis=(0.0, 0.0, 1.0)),
            limits=limits,
            loop=loop,
            margin=0.05,
            vibration=teeth,
        )
        _, measures, _ = meet(motion, WallModel(2e4, radius_m=5e-3), 2.4)
        slow = [spectrum(measures[at : at + 400, RAW_FORCE][:, 2])[:40].max() for at in (1000, 1900)]
        settled.append(slow[1] / slow[0])
    assert settled[0] < 0.7 and settled[1] < 0.7 and settled[1] == pytest.approx(settled[0], rel=0.05)
