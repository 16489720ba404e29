"""Blade as a tissue model: the contract's laws, frames, small changes, reports, refused poses."""

from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tissue import InputError
from tissue.models.incision.model import PLAY_M, IncisionModel
from tissue.models.incision.parameters import Blade, IncisedTissue, incised_tissue
from tissue.models.tissue_model import ToolMotion

BLADE = Blade(width_m=6e-3, thickness_m=4e-4, edge_rad=np.radians(45.0))
SKIN = incised_tissue("skin", BLADE)
STEP_M = 2e-5


def made(tissue=SKIN, tool=BLADE):
    """A blade above a tissue."""
    model = IncisionModel(tissue, tool)
    model.place(at((0.0, 0.0, 1.0)))
    return model


def at(tip_mm, *, rotation=None, speed_m_s=0.02, heading=(0.0, 0.0, -1.0)):
    """The blade with its tip at a point."""
    motion = ToolMotion(tip_m=1e-3 * np.array(tip_mm, float), speed_m_s=speed_m_s)
    motion.heading[0] = heading
    if rotation is not None:
        motion.rotation[:] = rotation
    return motion


def along(points_mm, *, step_m=STEP_M):
    """Points on straight lines, a tick's travel apart [m]."""
    points = 1e-3 * np.array(points_mm, float)
    pieces = []
    for start, end in pairwise(points):
        count = max(round(np.linalg.norm(end - start) / step_m), 1)
        pieces.append(start + np.arange(1, count + 1)[:, None] / count * (end - start))
    return np.concatenate(pieces)


def forces_N(tips_m, *, model=None, rotation=None):
    """Force at every point of a path, shape (n, 3)."""
    model = model or made()
    motion = at((0.0, 0.0, 0.0), rotation=rotation)
    found = []
    for tip in tips_m:
        motion.tip_m[:] = tip
        model.advance(motion)
        found.append(model.respond(motion).wrench[:3].copy())
    return np.array(found)


STROKE = along([(0, 0, 1), (0, 0, -5), (12, 0.3, -5), (14, 0.3, -2), (6, 1.5, -4), (6, 0, 3)])
"""Down, along, up and back, with the plane of the blade left."""


@cache
def wander(seed):
    """A path in the plane of the blade that dips in and out, and the force along it."""
    count = 8
    random = np.random.default_rng(seed)
    points = np.zeros((count + 1, 3))
    points[0, 2] = 1.0
    points[1:, 0] = random.uniform(-8.0, 8.0, count)
    points[1:, 2] = random.uniform(-6.0, 2.0, count)
    tips = along(points)
    return tips, forces_N(tips)


def test_nothing_touched_gives_no_force():
    model = made()
    for tip in ((0, 0, 1e-6), (5, 3, 2), (0, 0, 40)):
        model.advance(at(tip))
        response = model.respond(at(tip))
        for name in ("resistance", "edge", "wrench", "engaged_m2", "measures"):
            assert not getattr(response, name).any(), name
        assert response.gap_m == pytest.approx(1e-3 * tip[2])


@cache
def stroke_forces_N(lean_deg, roll_deg):
    """Rotation of a blade, and its force at every point of `STROKE`."""
    rotation = Rotation.from_euler("yx", (lean_deg, roll_deg), degrees=True).as_matrix()
    return rotation, forces_N(STROKE, rotation=rotation)


@pytest.mark.parametrize(("lean_deg", "roll_deg"), [(0.0, 0.0), (25.0, 20.0)])
@pytest.mark.parametrize("kind", ["turned", "moved", "mirrored"])
def test_the_frame_does_not_matter(kind, lean_deg, roll_deg):
    """A scene turned about the normal, moved along the surface or mirrored has its force turned
    and mirrored, for an upright blade and one that leans along and across its plane.
    """
    random = np.random.default_rng(3)
    rotation, plain = stroke_forces_N(lean_deg, roll_deg)
    shift = np.zeros(3)
    change = np.eye(3)
    if kind == "turned":
        change = Rotation.from_euler("z", random.uniform(0.5, 3.0)).as_matrix()
    elif kind == "moved":
        shift[:2] = random.normal(size=2)
    else:
        change = np.diag([1.0, -1.0, 1.0]) @ Rotation.from_euler("z", 0.7).as_matrix()
    mirror = np.diag([1.0, np.linalg.det(change), 1.0])
    other = forces_N(STROKE @ change.T + shift, rotation=change @ rotation @ mirror)
    assert np.abs(plain).max() > 1.0
    # Columns begin at the entry, so that rounding alone differs.
    np.testing.assert_allclose(other, plain @ change.T, atol=1e-6 * np.abs(plain).max())


LARGEST_CHANGE = 10.0
"""Largest change of the force over stiffness and change of the path, as the science contract asks.

The largest measured one is 7.3.
"""
STROKES = {
    "straight": [(0, 0, 1), (0, 0, -5), (12, 0, -5), (12, 0, 3)],
    "curved": [(0, 0, 1), (0, 0, -4), (4, 0, -5), (8, 0, -6), (12, 0, -5), (16, 0, -3), (18, 0, 1)],
    "oblique": [(0, 0, 1), (3, 0, -3), (9, 0, -6), (14, 0, -1), (14, 0, 2)],
}


@pytest.mark.parametrize(
    ("stroke", "edge_deg"),
    [
        ("straight", 45.0),
        ("curved", 45.0),
        ("oblique", 25.0),
        ("oblique", 45.0),
        ("oblique", 90.0),
    ],
)
def test_a_small_change_of_the_path_changes_the_force_little(stroke, edge_deg):
    """A path that is shifted by a random small amount in every tick."""
    tool = Blade(width_m=6e-3, thickness_m=4e-4, edge_rad=np.radians(edge_deg))
    tips = along(STROKES[stroke])
    plain = forces_N(tips, model=made(tool=tool))
    for shift_m in (1e-9, 1e-7, 1e-5):
        shifts = np.random.default_rng(0).uniform(-shift_m, shift_m, tips.shape) * (1.0, 0.0, 1.0)
        other = forces_N(tips + shifts, model=made(tool=tool))
        changed = np.linalg.norm(other - plain, axis=1).max()
        assert changed <= LARGEST_CHANGE * SKIN.stiffness_N_m * shift_m


@pytest.mark.parametrize("seed", range(2))
def test_a_blade_that_leaves_walls_between_its_strokes_is_rarely_sensitive(seed):
    """A blade that wanders to and fro leaves thin walls, which it cuts at once or a tick later.

    Measured are at most 1 % of the ticks, and 0.06 N of 10 N.
    """
    tips, forces = wander(seed)
    shifts = np.random.default_rng(100 + seed).uniform(-1e-7, 1e-7, tips.shape) * (1.0, 0.0, 1.0)
    changed = np.linalg.norm(forces_N(tips + shifts) - forces, axis=1)
    assert (changed > LARGEST_CHANGE * SKIN.stiffness_N_m * 1e-7).mean() < 0.03
    assert changed.max() < 0.2


@pytest.mark.parametrize("seed", range(2))
def test_the_force_changes_between_ticks_as_little_as_the_path(seed):
    """|dF| <= 2 k |dx|: neither cutting nor leaving is a jump."""
    _, forces = wander(seed)
    assert np.linalg.norm(np.diff(forces, axis=0), axis=1).max() <= (
        2.0 * SKIN.stiffness_N_m * 1.5 * STEP_M
    )


def test_the_number_of_steps_changes_the_force_little():
    """Ten times as many steps of the path."""
    points = [(0, 0, 1), (0, 0, -5), (12, 0, -5), (15, 0, -3)]
    coarse = forces_N(along(points, step_m=1e-4))[-1]
    fine = forces_N(along(points, step_m=1e-5))[-1]
    np.testing.assert_allclose(coarse, fine, atol=0.01 * np.linalg.norm(fine))


def test_a_blade_that_enters_beside_a_cut_meets_intact_tissue():
    """Within the play it moves in the cut. Beyond the play, or turned, it cuts anew."""
    play_mm = 1e3 * PLAY_M
    turned = Rotation.from_euler("z", 30, degrees=True).as_matrix()
    for aside_mm, rotation, count in (
        (0.9 * play_mm, None, 1),
        (1.1 * play_mm, None, 2),
        (0.0, turned, 2),
    ):
        model = made()
        forces_N(along([(0, 0, 1), (0, 0, -5), (0, 0, 2)]), model=model)
        second = forces_N(
            along([(0, aside_mm, 1), (0, aside_mm, -2)]), model=model, rotation=rotation
        )
        assert len(model.cuts) == count
        assert (np.abs(second).max() > 1.0) == (count == 2)


def test_across_its_plane_the_blade_is_pushed_back_elastically():
    model = made()
    forces_N(along([(0, 0, 1), (0, 0, -5)]), model=model)
    aside = forces_N(along([(0, 0, -5), (0, 3, -5)]), model=model)[-1]
    depth_m = model.cuts[0].place_m[1]
    expected = -SKIN.stiffness_N_m * depth_m / BLADE.width_m * (3e-3 - PLAY_M)
    assert aside[1] == pytest.approx(expected, rel=1e-6)
    back = forces_N(along([(0, 3, -5), (0, 0, -5)]), model=model)[-1]
    assert back[1] == 0.0


def test_measures_are_those_of_the_cut():
    model = made()
    forces_N(along([(0, 0, 1), (0, 0, -5), (10, 0, -5)]), model=model)
    motion = at((10, 0, -5))
    response = model.respond(motion)
    depth, deflection, cut, friction = response.measures
    pull = np.linalg.norm(response.wrench)
    assert depth == pytest.approx(1e3 * model.cuts[0].place_m[1])
    assert deflection == pytest.approx(1e3 * pull / SKIN.stiffness_N_m)
    assert cut == pytest.approx(1e6 * model.area_m2) and cut > 10.0
    assert friction == pytest.approx(1e3 * model.friction_J) and friction > 0.0
    assert response.engaged_m2[0] > 2.0 * 0.49e-6 * depth**2


def test_a_blade_that_starts_inside_is_refused():
    with pytest.raises(
        InputError, match="start with the blade outside the tissue, got a blade 5 mm"
    ):
        IncisionModel(SKIN, BLADE).place(at((0, 0, -5)))


@pytest.mark.parametrize(("axis", "angle_deg"), [("x", 85.0), ("y", 85.0)])
def test_a_blade_that_lies_flat_is_refused_where_it_touches(axis, angle_deg):
    flat = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    model = made()
    model.advance(at((0, 0, 10), rotation=flat))
    with pytest.raises(InputError, match="more than 10 degrees"):
        model.advance(at((0, 0, -1), rotation=flat))


@pytest.mark.parametrize("depth_mm", [-3.0, 3.0])
@pytest.mark.parametrize("where", ["tip_m", "rotation"])
def test_a_blade_that_is_nowhere_is_refused(where, depth_mm):
    model = made()
    motion = at((0, 0, -depth_mm))
    model.advance(motion)
    getattr(motion, where)[...] = np.nan
    with pytest.raises(InputError, match="the blade's pose must be finite"):
        model.advance(motion)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"toughness_J_m2": 0.0}, "toughness_J_m2"),
        ({"friction_Pa": -1.0}, "friction_Pa"),
        ({"poisson_ratio": 0.6}, "poisson_ratio"),
        ({"prestrain": 2.0}, "prestrain"),
        ({"stiffness_N_m": np.nan}, "stiffness_N_m"),
    ],
)
def test_constants_that_make_no_sense_are_refused(change, message):
    entries = {
        "name": "skin",
        "toughness_J_m2": 1700.0,
        "friction_Pa": 1e4,
        "stiffness_N_m": 4e3,
        "young_Pa": 1e6,
        "poisson_ratio": 0.4,
        "prestrain": 0.1,
    }
    with pytest.raises(InputError, match=message):
        IncisedTissue(**entries | change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width_m": 3e-4}, "greater than thickness_m"),
        ({"thickness_m": 0.0}, "thickness_m"),
        ({"edge_rad": 0.01}, "edge_rad"),
    ],
)
def test_a_blade_that_makes_no_sense_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        Blade(**{"width_m": 6e-3, "thickness_m": 4e-4, "edge_rad": 1.0} | change)
