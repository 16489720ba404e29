"""Distance between tool and structure.

It is compared with closed forms in turned and moved frames, and with a sampled brute force.
"""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from meshes.shapes.sdf import capsule, shape_triangles
from tissue.cutters import profile
from tissue.models.keep_clear import (
    DEEP_OVERLAP_ERROR_M,
    DISTANCE_ERROR_M,
    OVERLAP_ERROR_M,
    KeepClear,
    Structure,
)
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


def tube(inner_mm, sections, rings):
    """Return a tube along z whose inner facets touch the round one from outside.

    The middle of a facet is at +x. The wall ends at a radius of 5 mm, and at heights of -8 and 8 mm.
    """
    inner = 1e-3 * inner_mm / np.cos(np.pi / sections)
    heights = np.linspace(-8e-3, 8e-3, rings + 1)
    profile_m = [(5e-3, z) for z in heights] + [(inner, z) for z in heights[::-1]]
    angles = 2.0 * np.pi * (np.arange(sections) + 0.5) / sections
    vertices = np.concatenate(
        [
            np.column_stack([r * np.cos(angles), r * np.sin(angles), z + 0 * angles])
            for r, z in profile_m
        ]
    )
    ring = sections * np.arange(len(profile_m))[:, None]
    above = np.roll(ring, -1)
    here = np.arange(sections)
    after = np.roll(here, -1)
    first = np.stack([ring + here, ring + after, above + here], axis=2)
    second = np.stack([ring + after, above + after, above + here], axis=2)
    faces = np.concatenate([first, second]).reshape(-1, 3)
    made = trimesh.Trimesh(vertices, faces, process=False)
    assert made.is_watertight
    if made.volume < 0.0:
        made.invert()
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


def assert_safe(found_mm, exact_m):
    """Assert that a distance is exact within the tolerances above and below."""
    assert 1e3 * exact_m - BELOW_MM <= found_mm <= 1e3 * exact_m + ABOVE_MM


@pytest.mark.parametrize("diameter_mm", [1.0, 0.3])
def test_ball_and_cylinder(diameter_mm):
    """The distance of ball and cylinder is exact.

    It is the distance of the ball's centre from the axis, less both radii, apart and in each other
    up to the very axis.
    """
    frame = Frame(3, nerve(1e-3 * diameter_mm), BALL)
    rng = np.random.default_rng(1)
    for apart in [0.0, 1e-5, 1.5e-3 + 0.5e-3 * diameter_mm, *rng.uniform(0.0, 4e-3, 30)]:
        angle = rng.uniform(0.0, 2.0 * np.pi)
        along = rng.uniform(-8e-3, 8e-3)
        turn = Rotation.random(random_state=rng.integers(1000))
        centre = np.array([apart * np.cos(angle), apart * np.sin(angle), along])
        found = frame(centre - turn.apply([0.0, 0.0, 1.5e-3]), turn)
        assert_safe(found, apart - 1.5e-3 - 0.5e-3 * diameter_mm)


@pytest.mark.parametrize(("sections", "rings"), [(48, 1), (1000, 1), (24, 16), (64, 100)])
@pytest.mark.parametrize("scale", [1.0, -0.8])
def test_drill_in_a_tube(sections, rings, scale):
    """On the axis and off it, in long and short triangles, in turned, scaled and mirrored frames.

    On the axis, all facets of the tube are equally near.
    """
    made = tube(2.6, sections, rings)
    # a negative scale mirrors the tube, and trimesh then turns the triangles
    made.apply_scale(scale)
    assert made.volume > 0.0
    frame = Frame(sections, made, DRILL)
    for aside in (0.0, 0.1e-3, 0.34e-3):
        for height in (4e-3, 1e-3, -3e-3):
            exact_mm = 2.6 * abs(scale) - 1e3 * aside - 1.0
            found = frame([aside, 0.0, height])
            assert exact_mm - 1e3 * DISTANCE_ERROR_M - ABOVE_MM <= found <= exact_mm + ABOVE_MM


def test_the_depth_in_many_triangles_is_coarse_and_safe():
    """A ball of 3 mm in a sphere of 20,480 triangles."""
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=5.0)
    sphere.apply_scale(1e-3)
    inner_mm = 1e3 * np.linalg.norm(sphere.triangles_center, axis=1).min()
    outer_mm = 1e3 * np.linalg.norm(sphere.vertices, axis=1).max()
    frame = Frame(5, sphere, BALL)
    for away_mm in (0.5, 3.0, 4.5, outer_mm + 1.2):
        found = frame([0.0, 0.0, 1e-3 * away_mm - 1.5e-3])
        # the sphere of the triangles lies between the two radii
        depth_mm = outer_mm - away_mm + 1.5
        error_mm = (
            outer_mm
            - inner_mm
            + 1e3 * (DEEP_OVERLAP_ERROR_M if depth_mm > 1.0 else OVERLAP_ERROR_M)
        )
        assert -depth_mm - error_mm <= found <= -(inner_mm - away_mm + 1.5) + ABOVE_MM


def test_drill_in_a_tight_tube():
    """The wall of the tube is 0.1 mm in the drill on all sides."""
    frame = Frame(2, tube(0.9, 48, 1), DRILL)
    for height in (4e-3, 0.0, -5e-3):
        assert_safe(frame([0.0, 0.0, height]), -0.1e-3)


def test_a_drill_in_a_very_fine_tube_is_never_reported_as_a_breach():
    """The search then ends with a wider tolerance, on the safe side."""
    found = Frame(4, tube(2.6, 128, 400), DRILL)([0.0, 0.0, -3e-3])
    assert 1.6 - 0.2 <= found <= 1.6 + ABOVE_MM


@pytest.mark.parametrize("diameter_mm", [1.0, 0.3])
def test_end_mill_and_cylinder(diameter_mm):
    """Under the face, next to the side and diagonally off the rim, where the distance is plain."""
    frame = Frame(5, nerve(1e-3 * diameter_mm), MILL)
    radius = 0.5e-3 * diameter_mm
    # the mill's axis lies along x, the nerve along z
    upright = Rotation.from_euler("y", 90, degrees=True)
    for gap in (-0.1e-3, 0.0, 0.02e-3, 1e-3):
        assert_safe(frame([radius + gap, 0.0, 2e-3], upright), gap)
        assert_safe(frame([-4e-3, -1.5e-3 - radius - gap, 1e-3], upright), gap)
    for aside, under in ((0.5e-3, 0.3e-3), (0.2e-3, 0.4e-3), (1e-3, 1e-3)):
        found = frame([under, -1.5e-3 - aside, 0.5e-3], upright)
        assert_safe(found, np.hypot(aside, under) - radius)


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
    for _ in range(30):
        at = np.array(
            [rng.uniform(0.0, shape.radius_m + 2e-3), rng.uniform(low - 2e-3, high + 2e-3)]
        )
        exact = float(shape.distance(at[None])[0][0]) - radius
        turn = Rotation.random(random_state=rng.integers(1000))
        around = rng.uniform(0.0, 2.0 * np.pi)
        centre = turn.apply([at[0] * np.cos(around), at[0] * np.sin(around), at[1]])
        assert_safe(frame(-centre, turn), exact)


def test_a_shape_of_the_anatomy_is_meshed_finely_enough():
    """Triangles around a capsule of 0.3 mm, less their slack, against its own formula."""
    shape = capsule(0.15e-3, (-8e-3, 1e-3, 0.0), (8e-3, -2e-3, 1e-3))
    vertices, faces, slack = shape_triangles(shape, np.full(3, -5e-3), np.full(3, 5e-3))
    assert slack < 6e-6
    clear = KeepClear(BALL, {"nerve": Structure(vertices, faces, slack)})
    rng = np.random.default_rng(0)
    for centre in rng.uniform(-3e-3, 3e-3, (30, 3)):
        tool = ToolMotion(tip_m=centre - [0.0, 0.0, 1.5e-3])
        clear.measure(tool)
        assert_safe(float(clear.measures[0]), float(shape.distance(centre[None])[0]) - 1.5e-3)
