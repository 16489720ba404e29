"""Predictors on a given path, against written-out spring, tissue law and surface.

Lines through forces are tested, too.
"""

from math import inf

import numpy as np
import pytest

from tissue.prediction.koopman import RELEASED, Koopman
from tissue.prediction.look_ahead import LookAhead
from tissue.prediction.predictor import Contact

SPRING = 400.0
"""Stiffness of the coupling [N/m]."""
STEP_M = 1e-4


class GivenPath:
    """Device that moves on by a given step a tick, with a given stretch."""

    trusted = True

    def __init__(self, step_m=(0.0, 0.0, 0.0), stretch_m=(0.0, 0.0, 0.0)):
        self.step_m, self.stretch = (
            np.asarray(step_m, dtype=float),
            np.asarray(stretch_m, dtype=float),
        )

    def observe(self, position_m, stretch_m, filtered_m=None):
        self.seen = position_m.copy(), stretch_m.copy()

    def displacement_m(self, ticks):
        return ticks * self.step_m

    def stretch_m(self, ticks):
        return self.stretch * ticks

    def pause(self):
        """Nothing is kept."""


def touched_and_left(share=0.5):
    """Return a predictor after a press of 2 mm on a tissue at z = 0.

    The tissue takes `share` of the spring's stiffness.
    """
    koopman = Koopman(GivenPath((0.0, 0.0, -STEP_M)))
    koopman.meet(Contact(SPRING, np.zeros(3), np.zeros(3)))
    down = [2e-4, 1e-4, -1e-9, *(-STEP_M * np.arange(1, 21))]
    for z in [*down, *reversed(down)]:
        koopman.observe(
            np.array([0.0, 0.0, z]),
            np.zeros(3),
            np.array([0.0, 0.0, share * SPRING * max(-z, 0.0)]),
        )
    return koopman


def free(koopman, ticks, z=3e-4):
    for _ in range(ticks):
        koopman.observe(np.array([0.0, 0.0, z]), np.zeros(3), np.zeros(3))


@pytest.mark.parametrize("share", [0.3, 0.8])
def test_a_device_that_comes_back_meets_the_surface_where_it_left_it(share):
    """From 0.3 mm above, 0.1 mm a tick: nothing in 3 ticks, and share times k times 0.2 mm in 5."""
    koopman = touched_and_left(share)
    free(koopman, RELEASED)
    assert koopman.predict(2.5).tolist() == [0.0, 0.0, 0.0]
    assert koopman.predict(5.0) == pytest.approx(
        np.array([0.0, 0.0, share * SPRING * 2e-4]), rel=1e-5
    )
    assert koopman.predict(8.0) == pytest.approx(
        np.array([0.0, 0.0, share * SPRING * 5e-4]), rel=1e-5
    )


def test_a_gap_shorter_than_a_release_leaves_no_surface():
    koopman = touched_and_left()
    free(koopman, RELEASED - 4)  # two ticks above the surface were free already
    assert koopman.predict(8.0).tolist() == [0.0, 0.0, 0.0]
    free(koopman, 3)
    assert koopman.predict(8.0)[2] > 0.0


def test_ticks_without_a_force_count_as_free_too():
    koopman = touched_and_left()
    for _ in range(RELEASED):
        koopman.observe(np.array([0.0, 0.0, 3e-4]), np.zeros(3), None)
    assert koopman.predict(5.0)[2] == pytest.approx(0.5 * SPRING * 2e-4, rel=1e-5)


def test_a_tissue_that_lets_go_deeper_than_it_was_met_has_been_cut():
    koopman = Koopman(GivenPath((0.0, 0.0, -STEP_M)))
    koopman.meet(Contact(SPRING, np.zeros(3), np.zeros(3)))
    for z in -STEP_M * np.arange(0, 15.0):  # met at 0.1 mm, gone at 1 mm
        force = 0.5 * SPRING * -z if z > -1e-3 else 0.0
        koopman.observe(np.array([0.0, 0.0, z]), np.zeros(3), np.array([0.0, 0.0, force]))
    free(koopman, RELEASED)
    assert koopman.predict(30.0).tolist() == [0.0, 0.0, 0.0]


def test_between_answers_the_contact_is_that_share_of_the_spring():
    """Between answers the contact is that share of the spring.

    Pressed to 2 mm with half the spring's stiffness, a further 0.1 mm without an answer adds k / 2
    times that.
    """
    koopman = Koopman(GivenPath(stretch_m=(0.0, 0.0, 1e-3)))
    koopman.meet(Contact(SPRING, np.zeros(3), np.zeros(3)))
    for z in [1e-4, -1e-9, *(-STEP_M * np.arange(1, 21))]:
        koopman.observe(
            np.array([0.0, 0.0, z]), np.zeros(3), np.array([0.0, 0.0, 0.5 * SPRING * max(-z, 0.0)])
        )
    assert koopman.residual_N == pytest.approx(abs(0.5 * SPRING * 2e-3 - SPRING * 1e-3), abs=1e-12)
    koopman.observe(np.array([0.0, 0.0, -2.1e-3]), np.zeros(3), None)
    assert koopman.predict(0.0)[2] == pytest.approx(0.5 * SPRING * 2.1e-3, rel=1e-5)
    assert koopman.path.seen[1][2] == pytest.approx(0.5 * 2.1e-3, rel=1e-5)
    assert koopman.predict(2.0) == pytest.approx(np.array([0.0, 0.0, SPRING * 2e-3]))


def law_of(rng):
    """A tissue's slope that is stiffer along one axis than along the others, not symmetric."""
    return SPRING * (np.diag([0.5, 1.0, 3.0]) + 0.1 * rng.normal(size=(3, 3)))


@pytest.mark.parametrize("seed", range(3))
def test_a_contact_is_balanced_at_the_end_of_the_path(seed):
    """A contact is balanced at the end of the path.

    k (x - p) + f - K (p - p0) = 0 is solved by NumPy for the tip p; the device then feels k (p -
    x).
    """
    rng = np.random.default_rng(seed)
    stiffness, step = law_of(rng), rng.normal(size=3) * 2e-5
    tip, force = rng.normal(size=3) * 1e-2, np.array([0.2, -0.1, 1.5])
    device = tip - force / SPRING
    predictor = LookAhead(GivenPath(step))
    predictor.meet(Contact(SPRING, tip, force, stiffness))
    predictor.observe(device, np.zeros(3), force)
    for ticks in (1.0, 4.5):
        there = device + ticks * step
        moved = np.linalg.solve(
            SPRING * np.eye(3) + stiffness, SPRING * there + force + stiffness @ tip
        )
        assert predictor.predict(ticks) == pytest.approx(SPRING * (moved - there), rel=1e-9)
    # What the damper of the coupling adds now, it adds there.
    damper = np.array([0.05, 0.02, -0.04])
    predictor.observe(device, np.zeros(3), force + damper)
    assert predictor.predict(4.5) == pytest.approx(SPRING * (moved - there) + damper, rel=1e-9)


def test_a_tissue_that_would_pull_has_let_go():
    predictor = LookAhead(GivenPath((0.0, 0.0, 1e-4)))
    force = np.array([0.0, 0.0, 0.1])
    predictor.meet(Contact(SPRING, np.zeros(3), force, SPRING * np.eye(3)))
    predictor.observe(-force / SPRING, np.zeros(3), force)
    # The force falls by k / 2 for each metre: 0.1 N are gone after 0.5 mm, five ticks.
    assert predictor.predict(4.0)[2] == pytest.approx(0.1 - 0.5 * SPRING * 4e-4)
    assert predictor.predict(6.0).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("stiffness", [0.25 * SPRING, 25.0 * SPRING, np.inf])
def test_a_free_tool_comes_to_the_surface_by_its_gap(stiffness):
    """A free tool reaches the surface after its gap.

    The gap is 0.25 mm at 0.1 mm a tick. The surface is in series with the spring.
    """
    predictor = LookAhead(GivenPath((0.0, 0.0, -1e-4)))
    normal = np.array([0.0, 0.0, 1.0])
    predictor.meet(Contact(SPRING, np.zeros(3), np.zeros(3), None, 2.5e-4, normal, stiffness))
    predictor.observe(np.zeros(3), np.zeros(3), np.zeros(3))
    assert predictor.predict(2.0).tolist() == [0.0, 0.0, 0.0]
    wanted = 1.5e-4 / (1.0 / SPRING + 1.0 / stiffness)
    assert predictor.predict(4.0) == pytest.approx(wanted * normal, rel=1e-9)


def test_a_young_contact_without_a_slope_is_pressed_further():
    """The surface's weight falls to 0 in the time of the prediction, and the stretch remains."""
    up = np.array([0.0, 0.0, 1.0])
    step = np.array([0.0, 0.0, -1e-4])
    stretched = np.array([0.0, 0.0, 5e-5])
    predictor = LookAhead(GivenPath(step, stretched), slopes="none")
    felt = np.array([0.0, 0.0, 0.3])
    contact = Contact(SPRING, felt / SPRING, felt, None, inf, up, SPRING)
    pressed = felt + 0.5 * SPRING * 4.0 * 1e-4 * up  # two equal springs in series
    followed = SPRING * 4.0 * stretched
    for age in range(1, 8):
        predictor.meet(contact)
        predictor.observe(np.zeros(3), np.zeros(3), felt)
        weight = max(1.0 - age / 5.0, 0.0)
        wanted = weight * pressed + (1.0 - weight) * followed
        assert predictor.predict(4.0) == pytest.approx(wanted)
    predictor.meet(Contact(SPRING, np.zeros(3), np.zeros(3), None, 1e-3, up, SPRING))
    predictor.observe(np.zeros(3), np.zeros(3), np.zeros(3))
    predictor.meet(contact)
    predictor.observe(np.zeros(3), np.zeros(3), felt)
    assert predictor.predict(4.0) == pytest.approx(0.8 * pressed + 0.2 * followed)


@pytest.mark.parametrize("ticks", [1.0, 4.0, 6.25])
def test_the_force_of_a_tool_that_cuts_is_the_predicted_stretch(ticks):
    """A tool that cuts has the predicted stretch, and no force while it is free."""
    stretched = np.array([0.0, 1e-4, 2e-4])
    device = np.array([0.01, -0.02, 0.03])
    predictor = LookAhead(GivenPath(np.zeros(3), stretched))
    predictor.meet(Contact(SPRING, device, np.zeros(3), cuts=True))
    predictor.observe(device, np.zeros(3), np.zeros(3))
    assert not predictor.predict(ticks).any()
    felt = np.array([0.2, -0.1, 1.5])
    predictor.meet(Contact(SPRING, device + felt / SPRING, felt, cuts=True))
    predictor.observe(device, np.zeros(3), felt)
    assert predictor.predict(0.0) == pytest.approx(felt)
    assert predictor.predict(ticks) == pytest.approx(SPRING * ticks * stretched)
    predictor.observe(device, np.zeros(3), None)  # between two answers of the tissue
    assert predictor.predict(ticks) == pytest.approx(SPRING * ticks * stretched)
