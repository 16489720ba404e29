"""Reference of the cutting force, against closed forms.

They are caps, slots, layers, old cuts and turned frames.
"""

from itertools import pairwise
from math import acos, cos, pi, sin

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import half_space
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import (
    ball_burr,
    cylinder,
    flat_reamer,
    hemispherical_reamer,
    pear_bur,
    twist_drill,
)
from tissue.evaluation.reference import history
from tissue.evaluation.reference.force import Resolution, Solid, wrench_at
from tissue.evaluation.reference.history import _over_ticks, force_on_path
from tissue.evaluation.reference.path import ToolPath, convex_parts
from tissue.materials.constants import cutting_coefficients

R, FEED, DEPTH = 1.5e-3, 4e-3, 0.4e-3
BONE = cutting_coefficients("bone", minimum_chip_um=0.0)
"""Linear law, whose closed forms are short."""
CLOSE = 1e-3
"""Of the force: three times what the default resolution is off by in these cases."""
PROFILES = {
    "ball": ball_burr(diameter_m=2 * R),
    "cylinder": cylinder(diameter_m=2 * R, length_m=6e-3),
    "drill": twist_drill(diameter_m=2 * R, length_m=6e-3, point_angle_rad=2.0),
    "pear": pear_bur(diameter_m=2 * R, length_m=5e-3),
    "hemisphere": hemispherical_reamer(diameter_m=2 * R),
    "pegged": hemispherical_reamer(diameter_m=2 * R, peg_diameter_m=0.8e-3, peg_length_m=1e-3),
    "pegged disc": flat_reamer(
        diameter_m=2 * R, length_m=1e-3, peg_diameter_m=0.8e-3, peg_length_m=1e-3
    ),
}


def burr(profile="ball", spin=-500.0):
    return Cutter(PROFILES[profile], 6, spin)


def block(frame=None, plate_m=np.inf, below_kg_m3=400.0):
    """Bone below z = 0 of a frame: 1800 kg/m3 down to a depth, another density under it."""
    normal = (Rotation.identity() if frame is None else frame).apply([0.0, 0.0, 1.0])

    def classify(points, depth):
        deep = -(points @ normal) > plate_m
        return deep.astype(np.uint8), np.where(deep, below_kg_m3, 1800.0)

    return Solid(
        Anatomy("block", half_space(normal), ("plate", "core"), classify),
        (BONE, BONE),
    )


def path(*corners_mm, frame=None):
    """A path along straight lines, every leg of whole ticks, in a frame."""
    frame = frame or Rotation.identity()
    corners = 1e-3 * np.array(corners_mm)
    tips, velocities = [corners[:1]], []
    for start, end in pairwise(corners):
        steps = round(np.linalg.norm(end - start) / (FEED * 1e-3))
        tips.append(start + np.arange(1, steps + 1)[:, None] / steps * (end - start))
        velocities.append(np.broadcast_to((end - start) / (steps * 1e-3), (steps, 3)))
    velocities = np.concatenate([velocities[0][:1], *velocities])
    rotations = np.broadcast_to(frame.as_matrix(), (len(velocities), 3, 3))
    turn = frame.apply
    return ToolPath(
        turn(np.concatenate(tips)), rotations, turn(velocities), np.zeros_like(velocities), 2 * R
    )


def bone():
    """Cited coefficients of cortical bone: tangential and radial, chip and edge."""
    return (
        BONE.tangential_chip_Pa,
        BONE.radial_chip_Pa,
        BONE.tangential_edge_N_m,
        BONE.radial_edge_N_m,
    )


def cap_force(cutter, first, last):
    """Return thrust [N] and axial torque [N m] of a plunging ball between two angles from its tip.

    They are integrated by hand.
    """
    ktc, krc, kte, kre = bone()
    chip, n = FEED * cutter.chip_per_speed_s, cutter.flute_count
    thrust = lambda a: krc * chip * (a / 2 + sin(2 * a) / 4) + kre * sin(a)  # noqa: E731
    torque = lambda a: ktc * chip * sin(a) ** 2 / 2 - kte * cos(a)  # noqa: E731
    return n * R * (thrust(last) - thrust(first)), -np.sign(cutter.spin_rad_s) * n * R**2 * (
        torque(last) - torque(first)
    )


def slot_force(cutter, depth, feed=FEED):
    """Return the force [N] on a ball that moves along x in solid bone under a face.

    The face is cut to a depth, and the force is integrated by hand.
    """
    ktc, krc, kte, kre = bone()
    a, chip = acos(1 - depth / R), feed * cutter.chip_per_speed_s
    scale, sense = cutter.flute_count * R / (2 * pi), np.sign(cutter.spin_rad_s)
    x = -(krc * chip * pi / 2 * (a / 2 - sin(2 * a) / 4) + kre * 2 * (1 - cos(a)))
    y = -sense * (ktc * chip * pi / 2 * (1 - cos(a)) + kte * 2 * a)
    z = krc * chip * sin(a) ** 2 + kre * pi * sin(a)
    return scale * np.array([x, y, z])


def relative(found, wanted):
    return np.linalg.norm(np.subtract(found, wanted)) / np.linalg.norm(wanted)


@pytest.mark.parametrize("spin", [-500.0, 900.0])
def test_a_plunging_ball_feels_its_cap(spin):
    cutter, route = burr(spin=spin), path([0, 0, 0.2], [0, 0, -1.2])
    tick = 200  # 0.6 mm deep
    wrench = wrench_at(tick, route, cutter, block())
    thrust, torque = cap_force(cutter, 0.0, acos(1 + route.tips_m[tick, 2] / R))
    assert relative(wrench[:3], [0.0, 0.0, thrust]) < CLOSE
    assert relative(wrench[3:], [0.0, 0.0, torque]) < CLOSE


def test_layers_have_their_own_strength():
    cutter, route, tick, plate = burr(), path([0, 0, 0.2], [0, 0, -1.2]), 250, 0.5e-3
    depth = -route.tips_m[tick, 2]
    rim, change = acos(1 - depth / R), acos(1 - (depth - plate) / R)
    thrust = (
        cap_force(cutter, change, rim)[0] + (400 / 1800) ** 1.5 * cap_force(cutter, 0.0, change)[0]
    )
    assert (
        relative(wrench_at(tick, route, cutter, block(plate_m=plate))[:3], [0.0, 0.0, thrust])
        < CLOSE
    )


@pytest.mark.parametrize("spin", [-500.0, 900.0])
@pytest.mark.parametrize(
    "frame", [Rotation.identity(), *Rotation.random(2, random_state=3)], ids="ABC"
)
def test_a_slot_half_engages_the_ball_in_any_frame(frame, spin):
    cutter, route = burr(spin=spin), path([-4, 0, 0.2], [-4, 0, -0.4], [1, 0, -0.4], frame=frame)
    force = frame.inv().apply(wrench_at(1300, route, cutter, block(frame))[:3])
    assert relative(force, slot_force(cutter, DEPTH)) < CLOSE


@pytest.mark.parametrize("profile", PROFILES)
def test_a_second_pass_over_an_old_cut_meets_nothing(profile):
    frame = Rotation.random(random_state=5)
    once = [
        [-4, 0, 0.2],
        [-4, 0, -0.4],
        [1, 0, -0.4],
        [1, 0, 0.2],
        [-4, 0, 0.2],
        [-4, 0, -0.4],
        [0, 0, -0.4],
    ]
    route, cutter = path(*once, frame=frame), burr(profile)
    assert (
        np.abs(wrench_at(1300, route, cutter, block(frame), resolution=Resolution(8, 2))[:3]).max()
        > 1.0
    )
    late = len(route.tips_m) - 101
    assert (
        np.abs(wrench_at(late, route, cutter, block(frame), resolution=Resolution(8, 2))).max()
        < 1e-9
    )


@pytest.mark.slow
def test_a_deeper_pass_meets_what_the_old_one_left():
    """A deeper pass cuts the bone that the old one left.

    It is compared with a plain sum over four million points: the old slot is a cylinder along x,
    0.1 mm higher.
    """
    old, new = -0.3, -0.4
    route = path([-4, 0, old], [3, 0, old], [3, 0, 0.4], [-4, 0, 0.4], [-4, 0, new], [1, 0, new])
    cutter = burr()
    ktc, krc, kte, kre = bone()
    polar, turn = np.meshgrid(
        (np.arange(2000) + 0.5) / 2000 * (pi / 2),
        (np.arange(2000) + 0.5) / 2000 * pi - pi / 2,
        indexing="ij",
    )
    normal = np.stack([np.sin(polar) * np.cos(turn), np.sin(polar) * np.sin(turn), -np.cos(polar)])
    y, z = R * normal[1], R * normal[2] + R + 1e-3 * new
    engaged = (z < 0) & (np.hypot(y, z - R - 1e-3 * old) > R)
    chip = FEED * cutter.chip_per_speed_s * normal[0]
    around = np.sign(cutter.spin_rad_s) * np.stack(
        [-np.sin(turn), np.cos(turn), np.zeros_like(turn)]
    )
    density = (ktc * chip + kte) * around + (krc * chip + kre) * normal
    length = cutter.flute_count / (2 * pi) * R * (pi / 2 / 2000) * (pi / 2000)
    wanted = -length * (density * engaged).sum(axis=(1, 2))
    assert relative(wrench_at(len(route.tips_m) - 100, route, cutter, block())[:3], wanted) < CLOSE


def test_the_end_of_a_cylinder_cuts_and_its_side_does_not():
    cutter, route = burr("cylinder"), path([0, 0, 0.2], [0, 0, -1.2])
    _, krc, _, kre = bone()
    wanted = cutter.flute_count * R * (krc * FEED * cutter.chip_per_speed_s + kre)
    assert relative(wrench_at(200, route, cutter, block())[:3], [0.0, 0.0, wanted]) < CLOSE


def test_a_turning_ball_cuts_as_its_centre_moves():
    """A turning ball cuts as its centre moves.

    Turned about its centre it moves no surface along a normal; turned about its tip it is a ball
    that moves along x.
    """
    cutter, count, rate = burr(), 11, 4.0
    tilt = Rotation.from_rotvec(np.outer(np.linspace(-0.02, 0.02, count), [0.0, 1.0, 0.0]))
    turning, place = np.tile([0.0, rate, 0.0], (count, 1)), np.array([0.0, 0.0, -DEPTH])
    tips = place - R * tilt.as_matrix()[:, :, 2]
    about_centre = ToolPath(tips, tilt.as_matrix(), np.cross(turning, tips - place), turning, 2 * R)
    assert np.abs(wrench_at(5, about_centre, cutter, block())).max() < 1e-9
    about_tip = ToolPath(
        np.tile(place, (count, 1)), tilt.as_matrix(), np.zeros((count, 3)), turning, 2 * R
    )
    assert (
        relative(wrench_at(5, about_tip, cutter, block())[:3], slot_force(cutter, DEPTH, rate * R))
        < CLOSE
    )


@pytest.mark.parametrize("profile", PROFILES)
def test_the_least_distance_on_a_path_is_that_of_its_nearest_place(profile):
    random = np.random.default_rng(4)
    start, end = random.uniform(-4 * R, 4 * R, (2, 300, 3))
    share = np.linspace(0.0, 1.0, 2001)[:, None, None]
    for part in convex_parts(PROFILES[profile]):
        along = (start + share * (end - start)).reshape(-1, 3)
        wanted = part.distance(along).reshape(2001, -1).min(axis=0)
        found = part.least_on_path(start, end, limit_m=np.full(300, np.inf))
        step = np.linalg.norm(end - start, axis=1) / 2000
        assert (found <= wanted + 1e-9).all() and (found > wanted - step).all()
        bound = part.least_on_path(start, end, limit_m=np.zeros(300))
        assert (bound <= found + 1e-9).all() and np.allclose(
            bound[found < 0], found[found < 0], atol=1e-12
        )


def test_a_feed_that_changes_smoothly_is_interpolated(monkeypatch):
    """A feed that changes smoothly is interpolated.

    Under a given thrust, no two ticks have the same velocity, and few need to be evaluated.
    """
    evaluated = set()

    def counted_wrench(tick, *given, **named):
        evaluated.add(tick)
        return wrench_at(tick, *given, **named)

    monkeypatch.setattr(history, "wrench_at", counted_wrench)
    time = np.arange(401) * 1e-3
    depth = FEED * (time + np.sin(8 * time) / 16)
    tips, velocities = np.zeros((2, 401, 3))
    tips[:, 2], velocities[:, 2] = 0.2e-3 - depth, -FEED * (1 + np.cos(8 * time) / 2)
    route = ToolPath(
        tips, np.broadcast_to(np.eye(3), (401, 3, 3)), velocities, np.zeros((401, 3)), 2 * R
    )
    found = force_on_path(route, burr(), block(), resolution=Resolution(8, 3))
    exact = [wrench_at(k, route, burr(), block())[:3] for k in range(60, 400, 31)]
    assert len(evaluated) < 200 and found.uncertainty < 3e-3
    assert relative(found.force_N[60:400:31], exact) < 3e-3


def test_a_line_over_the_first_contact_is_not_taken():
    """No force before the contact, where a line over it agrees with the tick in its middle.

    The force begins after tick 5 of 32 and is half of the last one at tick 16.
    """

    asked = []

    def force(tick):
        asked.append(tick)
        return np.full(6, 0.0 if tick <= 5 else 16.0 + 1.0 * (tick - 16))

    tips, velocities = np.zeros((2, 33, 3))
    velocities[:, 2] = -FEED
    tips[:, 2] = -FEED * 1e-3 * np.arange(33)
    route = ToolPath(
        tips, np.broadcast_to(np.eye(3), (33, 3, 3)), velocities, np.zeros((33, 3)), 2 * R
    )
    found = _over_ticks(force, route)
    count = len(asked)
    assert found == pytest.approx(np.array([force(tick) for tick in range(33)]), rel=1e-12)
    assert count < 20
