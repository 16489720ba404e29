"""Distance between tool and structure.

It is compared with closed forms in turned and moved frames, and with a sampled brute force.
"""

import itertools

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from meshes.shapes.sdf import capsule, ellipsoid, shape_triangles
from tissue.cutters import profile
from tissue.models.keep_clear import KeepClear, Structure
from tissue.models.tissue_model import ToolMotion

SECTIONS = 128
ABOVE_MM = 1e-6
BELOW_MM = 0.01
"""Tolerance of a distance above the true value and below it [mm]."""
BALL = profile.ball_burr(diameter_m=3e-3)
MILL = profile.cylinder(diameter_m=3e-3, length_m=8e-3)
REAMER = profile.hemispherical_reamer(diameter_m=12e-3, peg_diameter_m=3e-3, peg_length_m=4e-3)
FLAT = profile.flat_reamer(diameter_m=10e-3, length_m=3e-3, peg_diameter_m=3e-3, peg_length_m=4e-3)
DRILL = profile.twist_drill(diameter_m=2e-3, length_m=20e-3, point_angle_rad=2.06)


def nerve(diameter_m):
    """Return a cylinder along z whose facets touch the round one from outside.

    No facet lies inside the round cylinder.
    """
    radius = 0.5 * diameter_m / np.cos(np.pi / SECTIONS)
    made = trimesh.creation.cylinder(radius=1e3 * radius, height=40.0, sections=SECTIONS)
    # made in metres it would have no ends: trimesh drops triangles that small
    made.apply_scale(1e-3)
    assert made.is_watertight
    return made


class Frame:
    """A frame that is turned and far away, in which structure and tool are given."""

    def __init__(self, seed, made, shape):
        rng = np.random.default_rng(seed)
        self.turn = Rotation.random(random_state=seed)
        self.shift = rng.uniform(-0.5, 0.5, 3)
        vertices = self.turn.apply(np.asarray(made.vertices)) + self.shift
        self.clear = KeepClear(shape, {"nerve": Structure(vertices, np.asarray(made.faces))})

    def __call__(self, tip_m, turn=None):
        """Distance [mm] for a tip and rotation in the structure's own frame."""
        tool = ToolMotion()
        tool.tip_m[:] = self.turn.apply(tip_m) + self.shift
        tool.rotation[:] = (self.turn * (turn or Rotation.identity())).as_matrix()
        self.clear.measure(tool)
        return float(self.clear.measures[0])


def require_safe(found_mm, exact_m):
    assert 1e3 * exact_m - BELOW_MM <= found_mm <= 1e3 * exact_m + ABOVE_MM


@pytest.mark.parametrize("diameter_mm", [1.0, 0.6, 0.3])
def test_ball_and_cylinder(diameter_mm):
    """The distance of ball and cylinder is exact.

    It is the distance of the ball's centre from the axis, less both radii, apart and in each other
    up to the very axis.
    """
    frame = Frame(3, nerve(1e-3 * diameter_mm), BALL)
    rng = np.random.default_rng(1)
    for apart in [0.0, 1e-5, 1.5e-3 + 0.5e-3 * diameter_mm, *rng.uniform(0.0, 4e-3, 60)]:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        along = rng.uniform(-8e-3, 8e-3)
        turn = Rotation.random(random_state=rng.integers(1000))
        centre = np.array([apart * np.cos(angle), apart * np.sin(angle), along])
        found = frame(centre - turn.apply([0.0, 0.0, 1.5e-3]), turn)
        require_safe(found, apart - 1.5e-3 - 0.5e-3 * diameter_mm)


@pytest.mark.parametrize("diameter_mm", [1.0, 0.6, 0.3])
def test_end_mill_and_cylinder(diameter_mm):
    """Under the face, next to the side and diagonally off the rim, where the distance is plain."""
    frame = Frame(5, nerve(1e-3 * diameter_mm), MILL)
    radius = 0.5e-3 * diameter_mm
    # the mill's axis lies along x, the nerve along z
    upright = Rotation.from_euler("y", 90, degrees=True)
    for gap in (-0.1e-3, 0.0, 0.02e-3, 1e-3):
        require_safe(frame([radius + gap, 0.0, 2e-3], upright), gap)
        require_safe(frame([-4e-3, -1.5e-3 - radius - gap, 1e-3], upright), gap)
    for aside, under in ((0.5e-3, 0.3e-3), (0.2e-3, 0.4e-3), (1e-3, 1e-3)):
        found = frame([under, -1.5e-3 - aside, 0.5e-3], upright)
        require_safe(found, np.hypot(aside, under) - radius)


def test_edge_of_an_end_mill_in_a_flat_wall():
    """The edge of an end mill in a flat wall breaches it by its depth.

    The wall's face lies less deep in the tool than that.
    """
    wall = trimesh.creation.box((30e-3, 30e-3, 10e-3))
    wall.apply_translation([0.0, 0.0, -5e-3])
    frame = Frame(7, wall, MILL)
    turn = Rotation.from_euler("x", 45, degrees=True)
    lowest = turn.apply([0.0, -1.5e-3, 0.0])[2]
    for depth in (-0.5e-3, 0.05e-3, 0.3e-3, 1.0e-3):
        require_safe(frame([1e-3, 2e-3, -lowest - depth], turn), -depth)


@pytest.mark.parametrize(
    "shape", [REAMER, FLAT, DRILL, MILL, profile.pear_bur(diameter_m=2e-3, length_m=4e-3)]
)
def test_any_tool_and_a_small_ball(shape):
    """The distance of any tool and a small ball is exact.

    It is the distance of the ball's centre from the half section, less the ball's radius; the
    section's own search finds it.
    """
    radius = 0.15e-3
    rng = np.random.default_rng(2)
    made = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    inner = float(np.min(np.einsum("ij,ij->i", made.face_normals, made.triangles_center)))
    made.apply_scale(radius / inner)  # the facets touch the ball from outside
    frame = Frame(11, made, shape)
    low, high = shape.height_range_m
    for _ in range(60):
        at = np.array(
            [rng.uniform(0.0, shape.radius_m + 2e-3), rng.uniform(low - 2e-3, high + 2e-3)]
        )
        exact = float(shape.distance(at[None])[0][0]) - radius
        turn = Rotation.random(random_state=rng.integers(1000))
        around = rng.uniform(0.0, 2.0 * np.pi)
        centre = turn.apply([at[0] * np.cos(around), at[0] * np.sin(around), at[1]])
        require_safe(frame(-centre, turn), exact)


def test_a_tool_that_lies_wholly_in_a_structure():
    """The depth of a tool that lies wholly in a structure keeps growing.

    It grows after the surfaces separate again.
    """
    frame = Frame(13, trimesh.creation.icosphere(subdivisions=5, radius=8e-3), BALL)
    for aside in (0.0, 2e-3, 5e-3):
        # facets 0.02 mm inside
        assert frame([aside, 0.0, -1.5e-3]) == pytest.approx(1e3 * (aside - 9.5e-3), abs=0.03)


def test_a_shape_of_the_anatomy_is_meshed_finely_enough():
    """Triangles around a capsule of 0.3 mm, less their slack, against its own formula."""
    shape = capsule(0.15e-3, (-8e-3, 1e-3, 0.0), (8e-3, -2e-3, 1e-3))
    vertices, faces, slack = shape_triangles(shape, np.full(3, -5e-3), np.full(3, 5e-3))
    assert slack < 6e-6
    clear = KeepClear(BALL, {"nerve": Structure(vertices, faces, slack)})
    rng = np.random.default_rng(0)
    for centre in rng.uniform(-3e-3, 3e-3, (60, 3)):
        tool = ToolMotion(tip_m=centre - [0.0, 0.0, 1.5e-3])
        clear.measure(tool)
        require_safe(float(clear.measures[0]), float(shape.distance(centre[None])[0]) - 1.5e-3)


def test_a_shape_whose_distance_is_a_lower_bound_is_meshed_where_it_is_nearest():
    """A shape whose distance is a lower bound is meshed where it is nearest.

    The formula of a flat ellipsoid gives a tenth of the distance in its plane; its true nearest
    point is known there.
    """
    shape = ellipsoid((0.5e-3, 5e-3, 5e-3))
    vertices, faces, slack = shape_triangles(
        shape, np.array([-1e-3, 19e-3, -1e-3]), np.array([1e-3, 21e-3, 1e-3])
    )
    clear = KeepClear(BALL, {"disc": Structure(vertices, faces, slack)})
    clear.measure(ToolMotion(tip_m=np.array([0.0, 20e-3, -1.5e-3])))
    assert 1e3 * (20e-3 - 5e-3 - 1.5e-3) - 0.05 <= float(clear.measures[0]) <= 13.5 + ABOVE_MM


def section_distance(corners, boxes):
    """Return the signed distance [mm] from a body of revolution.

    The body is given by its outline's corners, and by (radius, low, high) of its discs.
    """
    ends = np.array(corners, dtype=float)

    def distance(points):
        radius = np.hypot(points[:, 0], points[:, 1])
        height = points[:, 2]
        nearest = np.full(len(points), np.inf)
        for start, end in itertools.pairwise(ends):
            along = end - start
            share = np.clip(
                ((radius - start[0]) * along[0] + (height - start[1]) * along[1]) / (along @ along),
                0.0,
                1.0,
            )
            away = np.hypot(
                radius - start[0] - share * along[0], height - start[1] - share * along[1]
            )
            nearest = np.minimum(nearest, away)
        inside = np.any(
            [(radius < r) & (height > low) & (height < high) for r, low, high in boxes], axis=0
        )
        return np.where(inside, -nearest, nearest)

    return distance


def cylinder_distance(points, radius, length):
    """Signed distance [mm] from a cylinder along z."""
    across = np.hypot(points[:, 0], points[:, 1]) - radius
    along = np.abs(points[:, 2]) - 0.5 * length
    outside = np.hypot(np.maximum(across, 0.0), np.maximum(along, 0.0))
    return np.where((across < 0.0) & (along < 0.0), np.maximum(across, along), outside)


def smallest_sum(total, points, rng):
    """Return the smallest value over space.

    The best of dense points are each moved at random as long as the value falls.
    """
    values = total(points)
    best = np.argsort(values)[:60]
    points = points[best]
    values = values[best]
    reach = 0.1
    while reach > 1e-4:
        directions = rng.normal(size=(12, 3))
        tried = points[:, None] + reach * directions / np.linalg.norm(directions, axis=1)[:, None]
        found = total(tried.reshape(-1, 3)).reshape(len(points), -1)
        pick = found.argmin(axis=1)
        better = found.min(axis=1) < values
        points[better] = tried[better, pick[better]]
        values[better] = found.min(axis=1)[better]
        reach *= 0.9
    return values.min()


SMALL_MILL = profile.cylinder(diameter_m=3e-3, length_m=4e-3)
SMALL_FLAT = profile.flat_reamer(
    diameter_m=6e-3, length_m=2e-3, peg_diameter_m=1.5e-3, peg_length_m=2e-3
)
MILL_SECTION = section_distance([(0, 0), (1.5, 0), (1.5, 4), (0, 4)], [(1.5, 0, 4)])
FLAT_SECTION = section_distance(
    [(0, -2), (0.75, -2), (0.75, 0), (3, 0), (3, 2), (0, 2)], [(3, 0, 2), (0.75, -2, 2)]
)


@pytest.mark.parametrize(
    ("shape", "section", "diameter_mm"),
    [
        (SMALL_MILL, MILL_SECTION, 1.0),
        (SMALL_FLAT, FLAT_SECTION, 1.0),
        (SMALL_FLAT, FLAT_SECTION, 4.0),
    ],
)
def test_depth_is_the_smallest_sum_of_both_signed_distances(shape, section, diameter_mm):
    """The depth is the smallest sum of both signed distances.

    It is checked with dense points of the tool and closed forms of both distances; the cylinder's
    end and rim are among the poses.
    """
    made = nerve(1e-3 * diameter_mm)
    frame = Frame(17, made, shape)
    low, high = 1e3 * np.array(shape.height_range_m)
    reach = 1e3 * shape.radius_m
    spans = (
        np.arange(-reach, reach + 0.1, 0.2),
        np.arange(-reach, reach + 0.1, 0.2),
        np.arange(low, high + 0.1, 0.2),
    )
    lattice = np.stack(np.meshgrid(*spans, indexing="ij"), axis=-1).reshape(-1, 3)
    for seed in range(4):
        rng = np.random.default_rng(seed)
        checked = 0
        while checked < 3:
            turn = Rotation.random(random_state=rng.integers(1 << 30))
            tip = rng.uniform(-3.5, 3.5, 3) + np.array([0.0, 0.0, rng.choice([0.0, 20.0])])

            def total(points, turn=turn, tip=tip):
                return cylinder_distance(points, 0.5 * diameter_mm, 40.0) + section(
                    turn.inv().apply(points - tip)
                )

            points = turn.apply(lattice) + tip
            if total(points).min() > -0.02:
                continue
            checked += 1
            exact_mm = smallest_sum(total, points, rng)
            require_safe(frame(1e-3 * tip, turn), 1e-3 * exact_mm)


def test_the_rim_of_an_end_mill_in_a_thin_cylinder():
    """The rim of an end mill in a thin cylinder is found.

    At these poses the rim, between the axis and the outline's corners, was 0.026 and 0.004 mm
    deeper than reported.
    """
    frame = Frame(19, nerve(1e-3), SMALL_MILL)
    axis = np.array([0.45, 0.3, 1.0])
    to_nerve = Rotation.from_euler("x", 90, degrees=True)  # the poses have the cylinder along y
    turn = to_nerve * Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0]
    for tip, depth in (([0.7308, -0.2696, 0.0539], 0.4874), ([0.3533, -1.4785, 0.7586], 0.0590)):
        found = frame(1e-3 * to_nerve.apply(tip), turn)
        assert -found >= depth
        assert -found <= depth + 0.25


def test_a_face_that_lies_flat_in_a_flat_wall():
    """The search ends for a face that lies flat in a flat wall.

    Every point of the tool's bevel is as deep as every other, and the search cannot separate them.
    """
    wall = trimesh.creation.box((20e-3, 20e-3, 8e-3))
    frame = Frame(23, wall, SMALL_MILL)
    for depth in (0.02e-3, 0.2e-3, 0.9e-3):
        require_safe(frame([0.0, 0.0, 4e-3 - depth]), -depth)
