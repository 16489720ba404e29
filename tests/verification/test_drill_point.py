"""Loads of drills and of a ball against figures that were computed without the program.

Someone with the formulas and the geometry alone computed the loads, by adaptive quadrature and by
sums over rings, with a rake from finite differences of the swept flute. The tests also construct
the rake from vectors.
"""

from math import atan, cos, pi, radians, sin, tan

import numpy as np
import pytest

from tissue.cutters.drill_point import FRICTION_ANGLE, DrillPoint
from tissue.cutters.tools import ball_burr, twist_drill
from tissue.materials.constants import CuttingCoefficients, constants
from tissue.models.bone.engagement import DensityNodes, plunge_unit_loads
from tissue.simulation.load_record import LayerLoads

LAW = CuttingCoefficients(
    250e6, 160e6, 0.0, 5e3, 4e3, 0.0, 1800.0, 1.5, size_exponent=0.0, minimum_chip_m=1e-7
)
POINT = DrillPoint(1.6e-3, 0.576e-3, radians(30.0), radians(118.0))


def thrust_and_torque(cutter, feed_per_turn_m):
    """Return thrust [N] and torque [N mm] of a fully engaged cutter."""
    chips_m, unit = plunge_unit_loads(cutter, np.array([feed_per_turn_m]))
    layer = LayerLoads(DensityNodes.of(1800, 1800), chips_m, unit)
    loads = np.tensordot(layer.values(LAW), unit[0, :, 0], 1)
    return loads[2], 1e3 * loads[5]


@pytest.mark.parametrize(
    ("diameter_mm", "feed_mm_s", "rpm", "with_web", "without_web"),
    [
        (3.2, 2.0, 1000.0, (40.2934, 41.2894), (39.13, 53.33)),
        (3.2, 2.0, 1500.0, (31.0454, 31.3516), (30.35, 40.53)),
        (4.0, 1.0, 500.0, (50.3667, 64.5147), (48.92, 83.33)),
        (4.0, 1.0, 2000.0, (24.3568, 29.5771), (24.23, 38.33)),
        (4.0, 0.5, 500.0, (33.0268, 41.2230), (32.46, 53.33)),
    ],
)
def test_thrust_and_torque_of_drills(diameter_mm, feed_mm_s, rpm, with_web, without_web):
    """Within 1e-4 with a web, the error of 40,000 elements; without, within the printed digits."""
    feed_m = 1e-3 * feed_mm_s * 60.0 / rpm
    for web_mm, wanted, tolerance in ((None, with_web, 1e-4), (0.0, without_web, 2e-4)):
        drill = twist_drill(diameter_mm=diameter_mm, length_mm=20.0, web_mm=web_mm, spin_rpm=rpm)
        assert thrust_and_torque(drill, feed_m) == pytest.approx(wanted, rel=tolerance)


@pytest.mark.parametrize("feed_mm_s, wanted", [(5.0, (83.30, 301.05)), (0.05, (28.39, 67.84))])
def test_thrust_and_torque_of_a_buried_ball(feed_mm_s, wanted):
    """A ball plunges: above the minimum chip thickness, and all of it below. Within 0.1 %."""
    ball = ball_burr(diameter_mm=6.0, flutes=6, spin_rpm=10_000.0)
    found = thrust_and_torque(ball, 1e-3 * feed_mm_s * 60.0 / 10_000.0)
    assert found == pytest.approx(wanted, rel=1e-3)


def test_a_left_hand_drill_has_the_same_thrust_and_the_opposite_torque():
    left, right = (
        thrust_and_torque(twist_drill(diameter_mm=3.2, length_mm=20.0, spin_rpm=rpm), 1e-4)
        for rpm in (-1000.0, 1000.0)
    )
    assert left[0] == pytest.approx(right[0], rel=1e-12)
    assert left[1] == pytest.approx(-right[1], rel=1e-12)


def test_rake_of_the_flute_constructed_from_vectors():
    """The rake face contains the lip and the tangent of the flute's helix."""
    radii = np.linspace(0.4e-3, 1.59e-3, 9)
    half = 0.5 * POINT.point_angle_rad
    web = 0.5 * POINT.web_m
    lip = np.array([sin(half), 0.0, cos(half)])
    places = np.column_stack([np.sqrt(radii**2 - web**2), np.full(9, web), np.zeros(9)])
    cutting = np.column_stack([-places[:, 1], places[:, 0], np.zeros(9)]) / radii[:, None]
    helix = (
        np.array([0.0, 0.0, 1.0])
        - cutting * (radii / POINT.radius_m * tan(POINT.helix_rad))[:, None]
    )
    face = np.cross(lip, helix)
    surface = np.cross(lip, cutting)
    surface *= -np.sign(surface[:, 2:])  # toward the bone
    surface /= np.linalg.norm(surface, axis=1)[:, None]
    along = np.cross(surface, lip)
    along *= np.sign(np.sum(along * cutting, axis=1))[:, None]
    up = np.cross(lip, face)
    up *= -np.sign(np.sum(up * surface, axis=1))[:, None]
    rakes = np.arctan2(-np.sum(up * along, axis=1), -np.sum(up * surface, axis=1))
    assert POINT.rakes_rad(radii) == pytest.approx(rakes, abs=1e-12)
    assert np.degrees(POINT.rakes_rad(np.array([1.6e-3]))) == pytest.approx(29.8642, abs=1e-4)


def test_a_flat_chisel_edge_has_the_pressure_of_a_flat_punch():
    """Half the wedge's angle is a right angle at a point angle of 180: 2 k (1 + pi / 2)."""
    nearly_flat = radians(180.0 - 1e-6)
    wedge = atan(tan(0.5 * nearly_flat) * sin(radians(130.0)))
    pressure = DrillPoint(1e-3, 2e-4, radians(30.0), nearly_flat).indentation / tan(wedge)
    reference = sin(FRICTION_ANGLE) / (1.0 - sin(FRICTION_ANGLE))
    assert pressure * reference == pytest.approx(1.0 + 0.5 * pi, rel=1e-6)


def test_friction_angle_follows_from_the_cited_coefficients():
    bone = constants("cutting", "bone")
    ratio = bone["radial_chip_N_mm2"].value / bone["tangential_chip_N_mm2"].value
    assert tan(FRICTION_ANGLE) == pytest.approx(ratio)
