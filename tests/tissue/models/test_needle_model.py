"""Needle as a tissue model: the contract's laws, contact with the organ, reports, refused poses."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue import InputError
from tissue.models.needle.model import NeedleModel
from tissue.models.needle.parameters import needle_tissue, vessel_wall
from tissue.models.tissue_model import ToolMotion

NEEDLE_M = 1.27e-3
LIVER = needle_tissue()
LAYERED = needle_tissue(walls=[vessel_wall(20e-3)])
ARRAYS = ("resistance", "edge", "wrench", "engaged_m2")


def needle(tissue=LAYERED, **options):
    """A needle above an organ."""
    model = NeedleModel(tissue, diameter_m=NEEDLE_M, **options)
    model.place(at(-1.0))
    return model


def at(depth_mm, *, speed_m_s=5e-3, inwards=True, sideways_mm=0.0):
    """The needle upright with its tip at a depth."""
    motion = ToolMotion(tip_m=1e-3 * np.array([sideways_mm, 0.0, -depth_mm]), speed_m_s=speed_m_s)
    motion.heading[0] = (0.0, 0.0, -1.0 if inwards else 1.0)
    return motion


def go(model, depths_mm, *, step_mm=0.05, sideways_mm=0.0):
    """Visit depths one after the other; return the last response and motion."""
    before = depths_mm[0]
    for depth in depths_mm:
        count = max(round(abs(depth - before) / step_mm), 1)
        for part in np.linspace(before, depth, count + 1):
            motion = at(part, inwards=depth >= before, sideways_mm=sideways_mm)
            model.advance(motion)
            response = model.respond(motion)
        before = depth
    return response, motion


def wander(seed, count=12):
    """Depths that go in and out again [mm]."""
    return [-1.0, *np.random.default_rng(seed).uniform(-15.0, 60.0, size=count).tolist()]


def test_nothing_touched_gives_no_force():
    model = needle()
    for motion in (at(-5.0), at(-1e-6), at(-100.0, inwards=False), at(-2.0, sideways_mm=50.0)):
        model.advance(motion)
        response = model.respond(motion)
        for name in (*ARRAYS, "measures"):
            assert not getattr(response, name).any(), name


@pytest.mark.parametrize("seed", range(5))
def test_force_grows_with_speed_as_its_two_parts_predict(seed):
    """Force grows with speed as its two parts predict.

    wrench = resistance x speed + edge, for any speed, at one pose; and friction always resists.
    """
    model = needle()
    _, motion = go(model, wander(seed))
    for speed in (0.0, 1e-5, 1e-3, 0.1):
        motion.speed_m_s = speed
        response = model.respond(motion)
        np.testing.assert_allclose(
            response.wrench, response.resistance * speed + response.edge, rtol=1e-12, atol=1e-15
        )
        assert response.wrench[2] == pytest.approx(response.measures[2:].sum(), abs=1e-12)
        assert response.resistance[:3] @ motion.heading[0] <= 0.0


def test_layers_and_the_one_that_the_tip_touches():
    model = needle()
    assert model.layer_names == ("capsule", "parenchyma", "vessel wall")
    wall_mm = 20.0 + 1e3 * model.insertion.tissue.deflection_m(2.0)
    depths = (-1.0, 10.0, 25.0, wall_mm, 60.0)
    for before, depth, layer in zip(depths, depths[1:], (0, 1, 2, 1), strict=False):
        engaged = go(model, [before, depth])[0].engaged_m2
        assert np.flatnonzero(engaged).tolist() == [layer], depth
        assert engaged.sum() == pytest.approx(0.25 * np.pi * NEEDLE_M**2)
    assert NeedleModel(replace(LIVER, membranes=()), diameter_m=NEEDLE_M).layer_names == (
        "parenchyma",
    )


def test_events_are_emitted_once_in_their_order():
    model = needle()
    go(model, [-1.0, 60.0])
    assert model.notices[0] == "the capsule is punctured after 16.9 mm of travel with 2.30 N"
    assert re.fullmatch(
        r"the vessel wall is punctured after \d+\.\d mm of travel with \d\.\d\d N\. "
        r"It lies 20\.0 mm deep and breaks at a tip force of \d\.\d\d N",
        model.notices[1],
    )
    _, force_N = model.insertion.punctures[1]
    wall = model.insertion.tissue.membranes[1]
    assert force_N > wall.puncture_N and f" {wall.puncture_N:.2f} N" in model.notices[1]
    assert len(model.notices) == 2
    go(model, [60.0, -20.0, 60.0, -20.0])
    assert model.notices[2:] == ["the needle has left the organ"] * 2


def test_an_organ_that_clings_to_the_needle_above_its_surface_keeps_its_track():
    """An organ that clings to the needle above its surface keeps its track.

    Drawn up to 2 mm above the surface, the organ still holds 6 mm of the shaft; moved aside and
    down, it still does. Straight down again the shaft sticks, so the held length stays and the
    organ is drawn up that much less.
    """
    model = needle(LIVER)
    go(model, [-1.0, 30.0])
    go(model, [30.0, -2.0])
    held = model.insertion.inserted_m
    drawn = model.insertion.deflection_m
    assert held > 5e-3 and model.insertion.travel_m == pytest.approx(-2e-3)
    go(model, [-2.0, 0.5], sideways_mm=2.0)
    assert model.insertion.inserted_m == held and model.insertion.punctured == 1
    assert model.insertion.deflection_m == pytest.approx(drawn + 2.5e-3, abs=1e-12)


def test_sideways_motion_in_the_organ_is_reported_once():
    model = needle()
    go(model, [-1.0, 30.0])
    before = model.notices.copy()
    for sideways_mm in (4.0, 6.0, 9.0):
        model.advance(at(30.0, sideways_mm=sideways_mm))
    assert model.notices[: len(before)] == before
    (event,) = model.notices[len(before) :]
    assert event.startswith("the needle has moved 5 mm sideways")
    # a needle that is moved sideways above the organ begins a new track
    model = needle()
    go(model, [-1.0, 30.0, -20.0])
    go(model, [-20.0, 30.0], sideways_mm=9.0)
    assert not any("sideways" in event for event in model.notices)


def test_measures_are_the_insertion_in_millimetres_and_newtons():
    """Measures are the insertion in millimetres and newtons.

    They are length, deflection, and the elastic, cutting and friction parts; the viscous drag is
    part of the friction.
    """
    model = needle(LIVER)
    response, motion = go(model, [-1.0, 30.0])
    insertion = model.insertion
    names = model.measure_names
    measures = dict(zip(names, response.measures, strict=True))
    elastic, cutting, friction = insertion.shares_N()
    drag = insertion.drag_N_s_m * motion.speed_m_s
    wanted = [
        1e3 * insertion.inserted_m,
        1e3 * insertion.deflection_m,
        elastic,
        cutting,
        friction + drag,
    ]
    assert list(measures.values()) == pytest.approx(wanted) and min(wanted) > 0.0
    pull = insertion.pull_N + drag
    assert response.wrench[:3] == pytest.approx(pull * motion.rotation[:, 2])
    assert sum(wanted[2:]) == pytest.approx(pull)


def test_a_turn_within_a_tick_has_no_viscous_friction():
    """The tick ends deeper than it began, but with the speed of the withdrawal."""
    model = needle(LIVER)
    go(model, [-1.0, 30.0])
    turned = at(30.01, speed_m_s=20e-3, inwards=False)
    model.advance(turned)
    assert model.insertion.sliding == 1
    response = model.respond(turned)
    friction = model.insertion.shares_N()[2]
    assert response.measures[4] == friction > 0.0 and not response.resistance.any()


def test_a_needle_that_goes_in_elsewhere_punctures_again():
    model = needle(LIVER)
    go(model, [-1.0, 30.0, -20.0])
    go(model, [-20.0, 30.0, -20.0], sideways_mm=0.9 * 1e3 * NEEDLE_M)
    assert len(model.insertion.punctures) == 1
    assert sum("punctured" in notice for notice in model.notices) == 1
    go(model, [-20.0, 30.0, -20.0], sideways_mm=2.0)
    assert sum("punctured" in notice for notice in model.notices) == 2


@pytest.mark.parametrize("seed", range(6))
def test_the_place_on_the_surface_does_not_matter(seed):
    """The place on the surface does not matter.

    A needle turned about the normal and moved along the surface has the turned force; depth counts
    along a tilted needle.
    """
    random = np.random.default_rng(seed)
    turned = Rotation.from_euler("z", random.uniform(-3.0, 3.0)).as_matrix()
    shift = np.append(random.normal(size=2), 0.0)
    tilt = Rotation.from_euler("xy", random.uniform(-0.6, 0.6, size=2)).as_matrix()
    plain = needle(LIVER)
    moved = needle(LIVER)
    for depth in (*np.arange(-1.0, 40.0, 0.3), *np.arange(40.0, -20.0, -0.3)):
        motion = at(depth)
        other = ToolMotion(rotation=turned @ tilt, speed_m_s=motion.speed_m_s)
        other.tip_m = shift + turned @ tilt @ motion.tip_m
        other.heading[0] = turned @ tilt @ motion.heading[0]
        plain.advance(motion)
        moved.advance(other)
        expected = turned @ tilt @ plain.respond(motion).wrench[:3]
        np.testing.assert_allclose(moved.respond(other).wrench[:3], expected, atol=1e-9)
    assert not moved.respond(other).wrench[3:].any()


def test_a_needle_that_starts_inside_is_refused():
    with pytest.raises(
        InputError, match=r"tip outside the organ, got a tip 5 mm inside. Start above the surface"
    ):
        NeedleModel(LIVER, diameter_m=NEEDLE_M).place(at(5.0))


def test_a_needle_that_lies_flat_is_refused_where_it_touches():
    model = needle()
    for depth in (-5.0, 1.0):
        motion = at(depth)
        motion.rotation[:] = Rotation.from_euler("x", 85, degrees=True).as_matrix()
        if depth < 0.0:
            model.advance(motion)
            assert not model.respond(motion).wrench.any()
        else:
            with pytest.raises(
                InputError,
                match=r"more than 10 degrees, got 5 degrees. Point the needle into",
            ):
                model.advance(motion)


def test_axis_in_the_direction_of_insertion_is_refused_with_the_opposite_axis():
    motion = at(1.0)
    motion.rotation[:] = Rotation.from_euler("y", 150, degrees=True).as_matrix()
    with pytest.raises(
        InputError,
        match=r"out of the organ, got \(0.5, 0, -0.866\)\. Reverse it to \(-0.5, 0, 0.866\), in a",
    ):
        needle().advance(motion)


@pytest.mark.parametrize("where", ["tip_m", "rotation"])
def test_a_needle_that_is_nowhere_is_refused(where):
    model = needle()
    motion = at(3.0)
    getattr(motion, where)[...] = np.nan
    with pytest.raises(InputError, match="the needle's pose must be finite"):
        model.advance(motion)


@pytest.mark.parametrize("tilt_deg", [0.0, 30.0, 45.0])
def test_an_oblique_needle_reaches_a_membrane_at_its_depth(tilt_deg):
    """A flat membrane at a depth d crosses a track tilted by t at the inserted length d / cos t."""
    turned = Rotation.from_euler("y", tilt_deg, degrees=True).as_matrix()
    model = needle()
    stopped = []
    for depth in np.arange(-1.0, 70.0, 0.05):
        motion = at(depth)
        oblique = ToolMotion(rotation=turned, speed_m_s=motion.speed_m_s)
        oblique.tip_m = turned @ motion.tip_m
        oblique.heading[0] = turned @ motion.heading[0]
        model.advance(oblique)
        if model.insertion.blocked:
            stopped.append(model.insertion.inserted_m)
    assert model.insertion.punctured == 2
    assert stopped[-1] == pytest.approx(20e-3 / np.cos(np.radians(tilt_deg)), rel=1e-12)
    assert tilt_deg != 0.0 or stopped[-1] == 20e-3


def test_weak_membrane_breaks_in_the_tick_of_the_capsule():
    """The event of a membrane that breaks at once has the travel and the pull of that moment.

    The tip arrives at the membrane at the travel of the capsule's puncture, or while it slides.
    """
    for walls in (
        [vessel_wall(2.5e-3, name="fat", puncture_N=0.7, hold_N=0.05)],
        [vessel_wall(20e-3, name="fat", puncture_N=0.3, hold_N=0.0)],
    ):
        model = needle(needle_tissue(walls=walls))
        travels_m = []
        for depth in np.arange(-1.0, 60.0, 0.05):
            model.advance(at(depth))
            while len(travels_m) < len(model.insertion.punctures):
                travels_m.append(1e-3 * depth)
        (first_m, _), (at_m, force_N) = model.insertion.punctures
        fat = model.tissue.membranes[1]
        assert first_m <= at_m
        assert travels_m[1] - 0.05e-3 <= at_m <= travels_m[1]
        assert force_N == pytest.approx(model.tissue.pull_N(at_m - fat.depth_m), rel=1e-9)
        assert force_N > fat.puncture_N
