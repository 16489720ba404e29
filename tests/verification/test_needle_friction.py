"""Friction on the shaft of a needle, against closed forms.

The shaft slides, sticks, reverses and breaks away.
"""

import numpy as np
import pytest
from needle_drives import CAPSULE, EXACT, FRICTION, LIVER, SPEED_M_S, drive, pushed

from tissue.models.needle.model import Insertion
from tissue.models.needle.parameters import needle_tissue, vessel_wall


def test_friction_turns_round_with_a_band_in_which_the_shaft_sticks():
    insertion = pushed(60e-3)
    deflection, length, pull = insertion.deflection_m, insertion.inserted_m, insertion.pull_N
    back = drive(insertion, 0.0, step_m=1e-6)
    stuck = back[:, 1] == length
    breakaway = CAPSULE.hold_N + FRICTION.static_out_N_m * length
    band_m = deflection + LIVER.deflection_m(breakaway)
    assert 60e-3 - back[stuck, 0].min() == pytest.approx(band_m, abs=1e-6)  # one step
    assert back[0, 2] == pytest.approx(pull, rel=EXACT)
    np.testing.assert_allclose(
        back[stuck, 2], [LIVER.pull_N(z - length) for z in back[stuck, 0]], atol=EXACT
    )
    assert back[:, 2].min() == pytest.approx(-breakaway, abs=3e-4)  # 250 N/m over one step
    sliding = ~stuck
    np.testing.assert_allclose(
        back[sliding, 2], -(CAPSULE.hold_N + FRICTION.sliding_out_N_m * back[sliding, 1]), atol=1e-9
    )


def test_a_needle_that_stops_breaks_away_with_the_static_friction():
    insertion = pushed(60e-3)
    insertion.advance(60e-3, 0.0)
    held, length = insertion.pull_N, insertion.inserted_m
    assert insertion.drag_N_s_m == 0.0
    assert held == pytest.approx(0.94 + 0.65 + FRICTION.sliding_in_N_m * length, rel=1e-9)
    on = drive(insertion, 65e-3, step_m=1e-6)
    peak = 0.94 + 0.65 + FRICTION.static_in_N_m * length
    assert on[:, 2].max() == pytest.approx(peak, abs=3e-4)
    assert on[np.argmax(on[:, 2]) + 1, 2] == pytest.approx(
        0.94 + 0.65 + FRICTION.sliding_in_N_m * length, rel=0.02
    )
    np.testing.assert_allclose(insertion.pull_N, pushed(65e-3).pull_N, rtol=EXACT)


def test_a_needle_that_turns_round_twice_breaks_away_with_the_static_friction():
    insertion = pushed(60e-3)
    length = insertion.inserted_m
    assert insertion.drag_N_s_m > 0.0
    drive(insertion, 58e-3)
    assert insertion.drag_N_s_m == 0.0
    on = drive(insertion, 65e-3, step_m=1e-6)
    assert on[:, 2].max() == pytest.approx(0.94 + 0.65 + FRICTION.static_in_N_m * length, abs=3e-4)


def test_the_parts_of_the_force():
    """The parts of the force add up everywhere.

    While the shaft slides they are hold, cutting and friction. While it sticks they fall back
    together. Before an intact wall the whole excess is elastic.
    """
    insertion = Insertion(needle_tissue(walls=[vessel_wall(30e-3)]))
    resting = []
    for leg in (70e-3, -20e-3, 70e-3):
        for travel in np.linspace(insertion.travel_m, leg, 900).tolist():
            insertion.advance(travel, SPEED_M_S)
            elastic, cutting, friction = insertion.shares_N()
            assert elastic + cutting + friction == pytest.approx(insertion.pull_N, abs=EXACT)
            length = insertion.inserted_m
            held = 0.65 * (length > 0.0) + 0.3 * (length > 30e-3)
            if insertion.sliding > 0:
                cut = 0.94 * (length == insertion.cut_m)
                expected = held, cut, FRICTION.sliding_in_N_m * length
            elif insertion.sliding < 0:
                expected = -held, 0.0, -FRICTION.sliding_out_N_m * length
            elif insertion.blocked and length > 0.0:
                resting.append(elastic)
                expected = elastic, 0.94, FRICTION.sliding_in_N_m * length
            else:
                assert min(elastic * insertion.pull_N, friction * insertion.pull_N) >= 0.0
                assert 0.0 <= cutting <= max(insertion.pull_N, 0.0)
                continue
            assert (elastic, cutting, friction) == pytest.approx(expected, abs=1e-9)
    assert len(resting) > 20
    assert (np.diff(resting) > 0.0).all() and resting[0] >= 0.65


@pytest.mark.parametrize("share", [0.5, 0.999, 1.001, 20.0])
def test_slower_than_half_the_band_it_creeps_under_static_friction(share):
    insertion = pushed(40e-3)
    speed, creeping = 0.5 * share * FRICTION.stick_band_m_s, share < 1.0
    drive(insertion, 45e-3, speed_m_s=speed)
    per_length = FRICTION.static_in_N_m if creeping else FRICTION.sliding_in_N_m
    assert insertion.pull_N == pytest.approx(
        0.94 + 0.65 + per_length * insertion.inserted_m, rel=1e-9
    )
    assert insertion.drag_N_s_m == (
        0.0 if creeping else FRICTION.viscous_in_N_s_m2 * insertion.inserted_m
    )
    drive(insertion, 10e-3, speed_m_s=speed)
    per_length = FRICTION.static_out_N_m if creeping else FRICTION.sliding_out_N_m
    assert insertion.pull_N == pytest.approx(-0.65 - per_length * insertion.inserted_m, rel=1e-9)
    assert insertion.drag_N_s_m == (
        0.0 if creeping else FRICTION.viscous_out_N_s_m2 * insertion.inserted_m
    )
