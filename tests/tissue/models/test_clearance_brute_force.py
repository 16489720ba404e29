"""Distance between tool and structure, against a brute force over points of the tool.

The reference is the smallest sum of the signed distances from tool and structure over random
points, which are then moved to smaller sums. It is never below the true distance, and above it by
less than `REFERENCE_M`.
"""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from structure_poses import distance_m

from tissue.cutters import profile
from tissue.models.keep_clear import DISTANCE_ERROR_M, OVERLAP_ERROR_M, KeepClear, Structure

REFERENCE_M = 2e-6
STARTS, TRIES, ROUNDS = 6, 12, 90
"""Number of points that the search moves, of trials per round and of rounds."""
ROUNDING_M = 1e-9
TOOLS = {
    "ball": profile.ball_burr(diameter_m=3e-3),
    "mill": profile.cylinder(diameter_m=3e-3, length_m=8e-3),
    "drill": profile.twist_drill(diameter_m=2e-3, length_m=20e-3, point_angle_rad=2.06),
    "reamer": profile.hemispherical_reamer(
        diameter_m=12e-3, peg_diameter_m=3e-3, peg_length_m=4e-3
    ),
}


def distance_from(structure, points):
    """Return the signed distances of points from the triangles of a closed surface [m]."""
    corners = structure.vertices_m[structure.faces]
    count = len(points)
    pairs = np.tile(corners, (count, 1, 1)), np.repeat(points, len(corners), axis=0)
    nearest = trimesh.triangles.closest_point(*pairs)
    apart = np.linalg.norm(nearest - pairs[1], axis=1).reshape(count, -1).min(axis=1)
    # Winding number by solid angles (Van Oosterom and Strackee 1983).
    a, b, c = np.moveaxis(pairs[0] - pairs[1][:, None], 1, 0)
    lengths = [np.linalg.norm(each, axis=1) for each in (a, b, c)]
    below = np.prod(lengths, axis=0)
    for first, second, third in ((a, b, lengths[2]), (b, c, lengths[0]), (c, a, lengths[1])):
        below += np.einsum("ij,ij->i", first, second) * third
    angles = 2.0 * np.arctan2(np.einsum("ij,ij->i", a, np.cross(b, c)), below)
    winding = angles.reshape(count, -1).sum(axis=1) / (4.0 * np.pi)
    return np.where(winding > 0.5, -apart, apart)


def reference_m(structure, tool, tip_m, turn, rng):
    """Return the smallest sum of the signed distances that a random search finds [m]."""

    def total(points):
        half = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
        return tool.distance(half)[0] + distance_from(structure, turn.apply(points) + tip_m)

    radius = tool.radius_m
    low, high = tool.height_range_m
    points = rng.uniform([-radius, -radius, low], [radius, radius, high], (1500, 3))
    totals = total(points)
    rows = np.arange(STARTS)
    best = np.argsort(totals)[:STARTS]
    points = points[best]
    totals = totals[best]
    sizes = np.full(STARTS, 0.1 * max(high - low, radius))
    for _ in range(ROUNDS):
        shifts = rng.normal(size=(STARTS, TRIES, 3)) * sizes[:, None, None]
        tried = points[:, None] + shifts
        sums = total(tried.reshape(-1, 3)).reshape(STARTS, TRIES)
        smallest = sums.argmin(axis=1)
        closer = sums[rows, smallest] < totals
        points = np.where(closer[:, None], tried[rows, smallest], points)
        totals = np.minimum(totals, sums[rows, smallest])
        sizes *= np.where(closer, 1.2, 0.6)
    return float(totals.min())


def random_surface(rng, kind):
    """Return a closed surface with a size of a few millimetres, in random proportions [mm]."""
    if kind == "hull":
        return trimesh.convex.convex_hull(rng.normal(size=(10, 3)) * rng.uniform(0.3, 8.0, 3))
    if kind == "tube":
        return trimesh.creation.annulus(
            r_min=rng.uniform(1.0, 3.0), r_max=4.0, height=rng.uniform(3.0, 20.0), sections=6
        )
    pieces = [trimesh.creation.box(rng.uniform(0.5, 6.0, 3)), trimesh.creation.icosahedron()]
    pieces[1].apply_translation([7.0, *rng.normal(size=2)])
    return trimesh.util.concatenate(pieces)


@pytest.mark.parametrize("kind", ["hull", "tube", "pieces"])
@pytest.mark.parametrize("name", TOOLS)
def test_any_tool_and_any_structure(name, kind):
    """Turned, scaled and mirrored structures, apart from the tool and overlapping it."""
    rng = np.random.default_rng([ord(name[0]), ord(kind[0])])
    made = random_surface(rng, kind)
    frame = Rotation.random(random_state=rng.integers(1000)).as_matrix() * rng.uniform(0.5, 2.0)
    faces = np.asarray(made.faces)
    if rng.random() < 0.5:
        frame[:, 0] *= -1.0
        faces = faces[:, ::-1]
    structure = Structure(1e-3 * np.asarray(made.vertices) @ frame.T, faces)
    clear = KeepClear(TOOLS[name], {"structure": structure})
    for _ in range(2):
        turn = Rotation.random(random_state=rng.integers(1000))
        tip = rng.uniform(-6e-3, 6e-3, 3)
        exact = reference_m(structure, TOOLS[name], tip, turn, rng)
        error = DISTANCE_ERROR_M if exact > 0.0 else OVERLAP_ERROR_M
        found = distance_m(clear, tip, turn)
        assert exact - error - REFERENCE_M <= found <= exact + ROUNDING_M
