"""Needle along its axis, against closed forms.

The forms are the curve of Okamura (2004), the work of cutting and energy. No measured needle force
is available for comparison. Tested are the published fit to one needle in bovine liver, and the
consequences of the model's own laws.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import find_peaks

from tissue.models.needle.model import Insertion, NeedleModel
from tissue.models.needle.parameters import Membrane, NeedleTissue, needle_tissue, vessel_wall
from tissue.models.tissue_model import ToolMotion
from tissue.motion.motion import FollowPath
from tissue.scene.load import load_scene
from tissue.simulation.simulate import simulate

STEP_S = 1e-3


SPEED_M_S = 3e-3
"""Of the needle: at a hand's pace [m/s]."""


EXACT = 1e-12
"""Tolerance of closed forms of a few newtons and centimetres [N], [m].

They are solved once a step, so roundings do not add up.
"""


LIVER = needle_tissue()


FRICTION = LIVER.friction


CAPSULE = LIVER.membranes[0]


def energy_J(tissue, deflection_m):
    """Elastic energy of the deflected organ: the pull integrated."""
    size = abs(deflection_m)
    return (0.5 * tissue.linear_N_m + tissue.quadratic_N_m2 * size / 3.0) * size * size


def drive(insertion, to_m, *, step_m=1e-5, speed_m_s=SPEED_M_S):
    """Return travel, inserted length, pull and stored energy on the path to a travel.

    The path starts at the present travel of the needle.
    """

    def row():
        stored_J = energy_J(insertion.tissue, insertion.deflection_m)
        return insertion.travel_m, insertion.inserted_m, insertion.pull_N, stored_J

    count = max(round(abs(to_m - insertion.travel_m) / step_m), 1)
    rows = [row()]
    for travel in np.linspace(insertion.travel_m, to_m, count + 1)[1:].tolist():
        insertion.advance(travel, speed_m_s)
        rows.append(row())
    return np.array(rows)


def pushed(to_m, tissue=LIVER):
    """A needle pushed in at the usual speed."""
    insertion = Insertion(tissue)
    drive(insertion, to_m)
    return insertion


def trace(tissue, corners_mm, *, feed_m_s=SPEED_M_S, diameter_m=1.27e-3):
    """Drive a model along a straight path at 1 kHz.

    Returns depth of the tip [mm], axial force [N] and measures.
    """
    points = np.zeros((len(corners_mm), 3))
    points[:, 2] = -1e-3 * np.array(corners_mm)
    path, motion = FollowPath(points, feed_m_s=feed_m_s, axis=(0.0, 0.0, 1.0)), ToolMotion()
    model = NeedleModel(tissue, diameter_m=diameter_m)
    path.begin(motion)
    model.place(motion)
    rows = []
    for tick in range(int(path.duration_s / STEP_S) + 1):
        path.advance(tick * STEP_S, STEP_S, model.respond(motion), motion)
        model.advance(motion)
        response = model.respond(motion)
        rows.append((-1e3 * motion.tip_m[2], response.wrench[2], *response.measures))
    return np.array(rows).T


FITTED = 0.15
"""Share by which a fitted curve may miss a published number; scatter between livers is larger."""


def test_before_the_puncture_the_force_is_the_polynomial():
    path = drive(Insertion(LIVER), 16.5e-3)
    mm = 1e3 * path[:, 0]
    np.testing.assert_allclose(path[:, 2], 0.048 * mm + 0.0052 * mm**2, rtol=EXACT)
    assert not path[:, 1].any()


def test_okamura_liver():
    """The liver follows Okamura (2004).

    The force is 2.30 N at 16.7 mm, drops by 0.66 N with 0.65 N of it left elastic, then grows with
    depth.
    """
    mm, force, insertion, deflection, elastic, cutting, friction = trace(LIVER, [-1.0, 60.0])
    peak = int(np.argmax(force[mm < 18.0]))
    drop = force[peak] - force[peak + 1]
    late = mm > mm[peak + 1]
    slope, start = np.polyfit(1e-3 * mm[late], force[late], 1)
    per_length = FRICTION.sliding_in_N_m + FRICTION.viscous_in_N_s_m2 * SPEED_M_S
    print(
        f"\nat 16.7 mm {np.interp(16.7, mm, force):.3f} N (published 2.30), puncture at "
        f"{mm[peak]:.2f} mm (16.7)"
    )
    print(
        f"drop {drop:.3f} N (0.66), then {elastic[late][0]:.3f} N elastic (0.65), "
        f"{cutting[late][0]:.3f} N cutting"
    )
    print(
        f"deflection after it {deflection[late][0]:.1f} mm, slope over the tip's travel "
        f"{slope:.2f} N/m (10.6)"
    )
    assert np.interp(16.7, mm, force) == pytest.approx(2.30, rel=FITTED)
    assert force[peak] == pytest.approx(2.30, rel=0.01)
    assert mm[peak] == pytest.approx(16.7, rel=FITTED)
    assert drop == pytest.approx(0.66, rel=FITTED)
    assert slope == pytest.approx(10.6, rel=FITTED)
    np.testing.assert_allclose(elastic[late], 0.65, atol=EXACT)
    np.testing.assert_allclose(cutting[late], 0.94, atol=EXACT)
    np.testing.assert_allclose(elastic + cutting + friction, force, atol=EXACT)
    np.testing.assert_allclose(insertion + deflection, np.maximum(mm, 0.0), atol=1e-9)
    # Over the inserted length the friction's own slope is exact; over the travel the force is
    # straight within 1 mN, since the organ yields a little more with every millimetre.
    np.testing.assert_allclose(
        np.diff(force[late]) / np.diff(1e-3 * insertion[late]), per_length, rtol=1e-6
    )
    assert np.abs(force[late] - start - slope * 1e-3 * mm[late]).max() < 1e-3


def test_the_force_after_the_puncture_balances_in_closed_form():
    """The force after the puncture balances in closed form.

    a1 u + a2 u² = cutting + hold + C (z - u): the u of the quadratic, at every travel behind the
    puncture.
    """
    insertion = Insertion(LIVER)
    drive(insertion, 17e-3)
    for travel in np.linspace(17.1e-3, 80e-3, 50).tolist():
        insertion.advance(travel, SPEED_M_S)
        roots = np.roots([5200.0, 48.0 + 10.57, -(0.94 + 0.65 + 10.57 * travel)])
        assert insertion.deflection_m == pytest.approx(roots.max(), rel=1e-9)
        assert insertion.pull_N == pytest.approx(
            0.94 + 0.65 + 10.57 * insertion.inserted_m, rel=1e-9
        )


def test_the_vessel_wall_is_a_second_puncture():
    tissue = needle_tissue(walls=[vessel_wall(30e-3)])
    mm, force, insertion, *_ = trace(tissue, [-1.0, 70.0])
    wall = tissue.membranes[1]
    resting = insertion == 30.0
    assert np.count_nonzero(resting) > 100
    assert (np.diff(force[resting]) > 0.0).all()
    expected = wall.puncture_N + CAPSULE.hold_N + FRICTION.static_in_N_m * 30e-3
    last = np.flatnonzero(resting)[-1]
    # One tick before the puncture: the organ's stiffness there, below 250 N/m, times 3 µm of
    # travel.
    assert expected - 1e-3 < force[last] <= expected
    assert mm[last] == pytest.approx(30.0 + 1e3 * tissue.deflection_m(expected), abs=4e-3)
    assert force[last + 1] < force[last] - 0.5
    assert (np.diff(insertion[last + 1 :]) > 0.0).all()


def test_an_old_track_takes_no_cutting_until_its_end():
    insertion = pushed(50e-3)
    cut = insertion.cut_m
    drive(insertion, -20e-3)
    assert (insertion.inserted_m, insertion.pull_N) == (0.0, 0.0)
    again = drive(insertion, 60e-3)
    sliding = (again[:, 1] > 0.0) & (again[:, 1] < cut)
    np.testing.assert_allclose(
        again[sliding, 2], 0.65 + FRICTION.sliding_in_N_m * again[sliding, 1], atol=1e-9
    )
    assert insertion.cut_m > cut
    assert insertion.pull_N == pytest.approx(pushed(60e-3).pull_N, rel=EXACT)


def test_a_membrane_that_is_only_pressed_springs_back():
    insertion = Insertion(LIVER)
    rows = np.vstack([drive(insertion, 15e-3), drive(insertion, -1e-3), drive(insertion, 15e-3)])
    work = np.sum(0.5 * (rows[1:, 2] + rows[:-1, 2]) * np.diff(rows[:, 0]))
    assert work == pytest.approx(energy_J(LIVER, 15e-3), rel=1e-6)
    assert insertion.punctured == 0


TISSUES = {
    "liver": LIVER,
    "vessel wall": needle_tissue(walls=[vessel_wall(20e-3)]),
    "no capsule": replace(LIVER, membranes=()),
    "nothing cut": replace(LIVER, membranes=(), cutting_N=0.0),
    "linear": NeedleTissue(
        linear_N_m=60.0,
        quadratic_N_m2=0.0,
        cutting_N=0.2,
        friction=FRICTION,
        membranes=tuple(
            Membrane(name=str(k), depth_m=5e-3 * k, puncture_N=0.4, hold_N=0.1 * k)
            for k in range(4)
        ),
    ),
}


def wander(seed, count=24):
    """Travels at which a random motion turns round, the last outside [m]."""
    turns = np.random.default_rng(seed).uniform(-20e-3, 70e-3, size=count)
    return [*turns.tolist(), -60e-3]


@pytest.mark.slow
@pytest.mark.parametrize("tissue", TISSUES.values(), ids=TISSUES)
def test_energy_is_lost_and_never_made(tissue):
    """Energy is lost and never created.

    Work done on the needle minus the organ's energy never falls, step by step, on any path that
    ends outside.
    """
    insertion = Insertion(tissue)
    rows = np.vstack([drive(insertion, turn) for turn in wander(0)])
    work = 0.5 * (rows[1:, 2] + rows[:-1, 2]) * np.diff(rows[:, 0])
    lost = work - np.diff(rows[:, 3])
    # The trapezium misses a kink in the force, where sticking ends, by a quarter of the stiffness
    # times the step squared.
    kink_J = 0.25 * 400.0 * 1e-5**2
    assert lost.min() > -kink_J
    assert rows[-1, 3] == 0.0 and insertion.inserted_m == 0.0
    assert lost.sum() > 1e-3


@pytest.mark.parametrize("tissue", TISSUES.values(), ids=TISSUES)
@pytest.mark.parametrize("seed", range(3))
def test_the_state_does_not_depend_on_the_step(tissue, seed):
    """Between two turns it is the same in one step or in a thousand."""
    coarse, fine = Insertion(tissue), Insertion(tissue)
    for turn in wander(seed):
        drive(coarse, turn, step_m=1.0)
        drive(fine, turn, step_m=7e-5)
        for name in ("inserted_m", "deflection_m", "cut_m"):
            assert getattr(coarse, name) == pytest.approx(getattr(fine, name), abs=EXACT), name
        assert coarse.punctured == fine.punctured
    np.testing.assert_allclose(coarse.punctures, fine.punctures, atol=EXACT)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_pull_energy_and_deflection_agree(sign):
    """The pull is the slope of the energy (central difference), and the deflection its inverse."""
    for deflection in np.linspace(1e-4, 20e-3, 40):
        step = 1e-6
        slope = energy_J(LIVER, sign * deflection + step) - energy_J(
            LIVER, sign * deflection - step
        )
        assert LIVER.pull_N(sign * deflection) == pytest.approx(slope / (2.0 * step), rel=1e-6)
        assert LIVER.deflection_m(LIVER.pull_N(deflection)) == pytest.approx(deflection, rel=EXACT)


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


PEAKS_MM = np.array([19.0, 28.0, 32.0, 36.0])


PEAKS_N = np.array([2.3, 1.9, 1.6, 1.4])


FIFTH = 0.2


STIFF = {
    "linear_N_mm": 0.45,
    "quadratic_N_mm2": 0.0,
    "capsule_puncture_N": 0.3,
    "capsule_hold_N": 0.0,
    "cutting_N": 0.27,
    "sliding_in_N_m": 2.5,
    "static_in_N_m": 3.0,
    "viscous_in_N_s_m2": 0.0,
}
"""Organ of 0.45 N/mm whose holes do not cling.

It is as stiff at every deflection as the cited one at 39 mm.
"""


def scene_of(folder):
    """Return the scene whose membranes lie in front of the peaks by the organ's deflection.

    The tip touches each membrane one deflection before it breaks.
    """
    lines = [
        f'[needle.liver.{k}]\nvalue = {v}\nrange = [{v}, {v}]\nsource = "t"\nconfidence = "L"'
        for k, v in STIFF.items()
    ]
    (folder / "organ.toml").write_text("\n".join(lines), "utf-8")
    names = [f"membrane {number}" for number in range(1, 5)]
    friction_N = 1e-3 * STIFF["static_in_N_m"] * (PEAKS_MM - PEAKS_N / STIFF["linear_N_mm"])
    return load_scene(
        "needle",
        {
            "materials": str(folder / "organ.toml"),
            "anatomy.interval_ms": 0.0,
            "anatomy.membrane_depths_mm": dict(
                zip(names, PEAKS_MM - PEAKS_N / STIFF["linear_N_mm"], strict=True)
            ),
            "anatomy.membrane_punctures_N": dict(zip(names, PEAKS_N - friction_N, strict=True)),
            "anatomy.membrane_holds_N": dict.fromkeys(names, 0.0),
            "motion.points_mm": [[0, 0, 2], [0, 0, -45]],
            "motion.feed_mm_s": 5.0,
            "duration_s": None,
        },
    )


def test_a_stiff_organ_with_four_membranes_has_the_shape(tmp_path):
    trace = simulate(scene_of(tmp_path)).trace
    force, mm = trace["model_force_z_N"], -trace["tool_z_mm"]
    at, _ = find_peaks(force, prominence=0.5)
    left = force[at + 1] / force[at]
    print("peaks", mm[at], "mm", force[at], "N, left of them", left)
    np.testing.assert_allclose(mm[at], PEAKS_MM, atol=0.02)
    np.testing.assert_allclose(force[at], PEAKS_N, rtol=5e-3)
    assert left.mean() == pytest.approx(FIFTH, abs=0.01)
    np.testing.assert_allclose(left, FIFTH, atol=0.07)


def test_the_cited_organ_comes_to_the_first_two_only():
    """The cited organ has the first two peaks only.

    Between two peaks the tip moves at most as far as the organ's deflection grows: closed form of
    the polynomial. Even where every fall to a fifth is granted, the third peak, 4 mm farther, is
    below 1.4 N. To reach 1.4 N the force may not have fallen below a third.
    """
    tissue = needle_tissue()
    for fallen_N in FIFTH * np.array([1.4, 2.3]):
        deflections = tissue.deflection_m(float(fallen_N)) + 1e-3 * np.diff(PEAKS_MM)
        reached = [tissue.pull_N(float(each)) for each in deflections]
        print(f"from {fallen_N:.2f} N the next peak comes to", np.round(reached, 2), "N at most")
        assert reached[0] > 1.2 and max(reached[1:]) < 1.0
    least = tissue.pull_N(tissue.deflection_m(1.4) - 4e-3)
    print(f"4 mm before 1.4 N the force is {least:.2f} N, {least / 1.9:.0%} of the peak before it")
    assert least / 2.3 > 1.4 * FIFTH
    assert least == pytest.approx(0.78, abs=0.05)
