"""Penetration depth of a tool, a body of revolution, in a structure with a closed surface.

The tool is the union of its largest inscribed balls. If the centre of a ball lies in the structure,
the depth of the ball is its radius plus the depth of its centre. The centres of all balls form the
tool's medial axis, which is divided into cells. A cell is a part of a segment of the medial axis in
the tool's half section, rotated around the tool's axis by a range of angles. A branch-and-bound
search over the cells finds the deepest ball. The error is at most `MedialAxis.tolerance`, unless
the search is long (`kernels.tool_distance.widened`).
"""

import warp as wp

from kernels.arrays import Doubles2D, Int32s, Vectors
from kernels.constants import HALF, ONE, TWO, ZERO
from kernels.tool_distance import nearest_on_triangle, widened

wp.set_module_options({"enable_backward": False})

CELLS = wp.constant(128)
"""Number of rows of the search stack.

The search stack holds the cells that remain to be searched, where a cell is a part of the tool's
medial axis. Each halving of a cell adds one row. Thirty halvings reduce both sides of a cell from
30 mm to about a micrometre.
"""
CELL_COLUMNS = wp.constant(6)
DOUBLING = wp.constant(2000)
"""Number of evaluated cells after which the tolerance of a long search doubles.

A cell is a part of the tool's medial axis. The evaluation of a cell takes up to 0.3 ms, so the
tolerance must grow faster than in `kernels.structure_distance`.
"""
FAR_M = wp.constant(wp.float64(1.0e3))
"""Range [m] of the search for the nearest surface point, larger than any structure."""
NEAR_M = wp.constant(wp.float64(1.0e-6))
"""Distance [m] from a surface below which the direction to the surface is not accurate."""
OUTSIDE_SIZES = wp.constant(wp.float64(16.0))
"""Distance from the structure's surface to an auxiliary point outside the structure, in cell sizes.

From the distance of this point, a bound for the balls of a cell (part of the tool's medial axis) is
computed. If the space outside the structure is large enough, the bound is below the true distance
by about 1/32 of the cell size.
"""
HULL = wp.constant(8)
"""Number of corners of the hull around a cell of the medial axis, see `hull_corner`."""
WIDE_RAD = wp.constant(wp.float64(1.0))
"""Smallest half angle [rad] of a cell whose bound is computed only from the cell's size.

For larger angles, the hull around the cell is too coarse. At this angle, the distance of hull
corners on tangents from the tool's axis is 1.85 times the radius of the cell.
"""


@wp.struct
class MedialAxis:
    """Segments of a tool's medial axis, see `tissue.cutters.body.MedialAxis`."""

    starts: Vectors  # [segment] radius and height of the centre, ball radius [m]
    ends: Vectors
    across: Int32s  # [segment] 1 if centres outside the structure also count
    slack: wp.float64  # largest distance by which true balls may exceed these balls [m]
    # largest accepted difference between the smallest signed distance and its lower bound [m]
    tolerance: wp.float64


@wp.func
def in_structure(motion: Doubles2D, radius: wp.float64, angle: wp.float64, height: wp.float64):
    """Convert a point of the tool, in cylindrical coordinates, to the structure's frame."""
    point_x = radius * wp.cos(angle)
    point_y = radius * wp.sin(angle)
    x = motion[0, 0] + motion[1, 0] * point_x + motion[2, 0] * point_y + motion[3, 0] * height
    y = motion[0, 1] + motion[1, 1] * point_x + motion[2, 1] * point_y + motion[3, 1] * height
    z = motion[0, 2] + motion[1, 2] * point_x + motion[2, 2] * point_y + motion[3, 2] * height
    return wp.vec3d(x, y, z)


@wp.func
def is_in_structure(mesh: wp.uint64, point: wp.vec3d):
    """Return whether a point lies inside the structure."""
    return wp.mesh_query_point_sign_winding_number(mesh, wp.vec3(point), float(FAR_M)).sign < 0.0


@wp.func
def nearest_on_surface(mesh: wp.uint64, point: wp.vec3d):
    """Return the distance of `point` from the surface, the nearest surface point and its face."""
    at = wp.vec3(point)
    query = wp.mesh_query_point_no_sign(mesh, at, float(FAR_M))
    foot = wp.vec3d(wp.mesh_eval_position(mesh, query.face, query.u, query.v))
    return wp.length(foot - point), foot, query.face


@wp.func
def hull_corner(
    motion: Doubles2D,
    start: wp.vec3d,
    end: wp.vec3d,
    angle: wp.float64,
    half_angle: wp.float64,
    k: int,
):
    """Return corner `k` of the hull around a cell of the medial axis, and the ball radius there.

    The hull encloses the ball centres of the cell. The ball centres at each end of the cell's
    segment form an arc around the tool's axis. For each of the two arcs, the hull has corners at
    the ends of the arc and on the tangent at its middle. A concave function of centre and ball
    radius has its smallest value at a corner of the hull.
    """
    ball = wp.where(k < 4, start, end)
    turned = angle + wp.where(k % 2 == 0, -half_angle, half_angle)
    radius = ball[0]
    if (k // 2) % 2 == 1:
        radius /= wp.cos(half_angle)
    return in_structure(motion, radius, turned, ball[1]), ball[2]


@wp.func
def first_ball_inside(mesh: wp.uint64, motion: Doubles2D, medial: MedialAxis):
    """Return whether the centre of the first ball of the medial axis lies in the structure."""
    ball = medial.starts[0]
    return is_in_structure(mesh, in_structure(motion, ball[0], ZERO, ball[1]))


@wp.func
def cell_bounds(
    mesh: wp.uint64,
    motion: Doubles2D,
    start: wp.vec3d,
    end: wp.vec3d,
    across: int,
    angle: wp.float64,
    half_angle: wp.float64,
    before: wp.float64,
    moved: wp.float64,
    wanted: wp.float64,
):
    """Compute bounds of the smallest signed distance between the structure and the balls of a cell.

    Return a lower bound, an upper bound, and the signed distance of the cell's middle from the
    surface [m].

    `before` is the known signed distance of another point from the surface, and `moved` is the
    distance from this point to the middle of the cell. When the lower bound reaches `wanted`, the
    function stops improving the bound.
    """
    middle = HALF * (start + end)
    centre = in_structure(motion, middle[0], angle, middle[1])
    apart, foot, face = nearest_on_surface(mesh, centre)
    # The sign takes far more time than the distance. Within a sphere that does not touch the
    # surface, the sign does not change, so the sign of `before` is used.
    is_inside = before < ZERO
    if wp.abs(before) <= moved + NEAR_M:
        is_inside = is_in_structure(mesh, centre)
    signed = wp.where(is_inside, -apart, apart)

    # The point of a cell that is farthest from its middle is one of its corners.
    cosine = wp.cos(half_angle)
    rise = HALF * (end[1] - start[1])
    size = wp.float64(0.0)
    for k in range(2):
        radius = wp.where(k == 0, start[0], end[0])
        squared = radius * radius + middle[0] * middle[0] - TWO * radius * middle[0] * cosine
        size = wp.max(size, wp.sqrt(wp.max(squared, ZERO) + rise * rise))
    largest = wp.max(start[2], end[2])

    lower = -apart - size - largest
    upper = -apart - middle[2]
    if not is_inside:
        # 1e9 m stands for no bound, here and below.
        upper = wp.float64(1.0e9)
        lower = apart - size - largest
        if across == 1:
            upper = apart - middle[2]
        elif apart >= size:
            # No centre lies in the structure. The search over the surface has already covered these
            # balls.
            return upper, upper, signed
    if half_angle >= WIDE_RAD or lower >= wanted:
        return lower, upper, signed

    # Inside the structure, the distance from the surface is at most the distance from any triangle.
    a = wp.vec3d(wp.mesh_get_point(mesh, face * 3 + 0))
    b = wp.vec3d(wp.mesh_get_point(mesh, face * 3 + 1))
    c = wp.vec3d(wp.mesh_get_point(mesh, face * 3 + 2))
    from_triangle = wp.float64(1.0e9)
    for k in range(HULL):
        corner, radius = hull_corner(motion, start, end, angle, half_angle, k)
        from_triangle = wp.min(
            from_triangle, -wp.length(corner - nearest_on_triangle(corner, a, b, c)) - radius
        )
    lower = wp.max(lower, from_triangle)
    if lower >= wanted:
        return lower, upper, signed

    # From a point outside, the signed distance decreases by at most the length of the path. For a
    # distant point, this bound is nearly constant along the surface.
    normal = wp.vec3d(wp.mesh_eval_face_normal(mesh, face))
    if apart > NEAR_M:
        normal = (centre - foot) / signed
    reach = OUTSIDE_SIZES * size + wp.max(signed, ZERO)
    outside = foot + reach * normal
    clear, _foot, _face = nearest_on_surface(mesh, outside)
    from_outside = wp.float64(1.0e9)
    for k in range(HULL):
        corner, radius = hull_corner(motion, start, end, angle, half_angle, k)
        from_outside = wp.min(from_outside, clear - wp.length(corner - outside) - radius)
    # The sign takes far more time than the distance, and a point inside gives a lower bound.
    if from_outside > lower and not is_in_structure(mesh, outside):
        lower = from_outside
    return lower, upper, signed


@wp.func
def over_balls(
    mesh: wp.uint64,
    motion: Doubles2D,
    medial: MedialAxis,
    best: wp.float64,
    last_segment: Int32s,
    # start and end as fractions of the segment, angle, half angle, bound, signed distance
    cells: Doubles2D,
):
    """Compute a lower bound [m] of the smallest signed distance between structure and balls.

    The balls are the inscribed balls of the tool. Only balls whose centre lies in the structure are
    included. On segments that `medial.across` marks, balls with centres outside are also included.
    The result is at most `best`.
    """
    smallest = best
    lowest = best
    count = int(0)
    begin = last_segment[0]
    number = medial.starts.shape[0]
    signed = wp.float64(0.0)
    last_middle = wp.vec3d()
    for turn in range(number):
        # The search starts at the segment that was deepest in the last tick, which excludes most
        # others.
        root = (begin + turn) % number
        cells[0, 0] = ZERO
        cells[0, 1] = ONE
        cells[0, 2] = ZERO
        cells[0, 3] = wp.float64(wp.pi)
        start = medial.starts[root]
        along = medial.ends[root] - start
        long = wp.sqrt(along[0] * along[0] + along[1] * along[1])
        middle = start + HALF * along
        lower, upper, signed = cell_bounds(
            mesh,
            motion,
            start,
            start + along,
            medial.across[root],
            ZERO,
            wp.float64(wp.pi),
            signed,
            wp.length(middle - last_middle),
            smallest - medial.tolerance,
        )
        last_middle = middle
        cells[0, 4] = lower
        cells[0, 5] = signed
        count += 1
        if upper < smallest:
            smallest = upper
            last_segment[0] = root
        held = int(1)
        while held > 0:
            held -= 1
            bound = cells[held, 4]
            accepted = smallest - widened(medial.tolerance, count, DOUBLING)
            if bound >= accepted or held + 2 > CELLS:
                lowest = wp.min(lowest, bound - medial.slack)
                continue
            first = cells[held, 0]
            last = cells[held, 1]
            angle = cells[held, 2]
            half_angle = cells[held, 3]
            radius = wp.max(start[0] + first * along[0], start[0] + last * along[0])
            centre = cells[held, 5]
            # Halve the longer side.
            split_angle = TWO * radius * half_angle > (last - first) * long
            for half in range(2):
                row = held + half
                cells[row, 0] = first
                cells[row, 1] = last
                cells[row, 2] = angle
                cells[row, 3] = half_angle
                # Distance between the middles of the cell and of its half, along the segment or
                # around the axis.
                moved = wp.float64(0.25) * (last - first) * long
                if split_angle:
                    middle_radius = start[0] + HALF * (first + last) * along[0]
                    moved = TWO * middle_radius * wp.sin(wp.float64(0.25) * half_angle)
                    cells[row, 3] = HALF * half_angle
                    cells[row, 2] = angle + wp.where(half == 0, -cells[row, 3], cells[row, 3])
                else:
                    share = HALF * (first + last)
                    cells[row, 0] = wp.where(half == 0, first, share)
                    cells[row, 1] = wp.where(half == 0, share, last)
                lower, upper, inner = cell_bounds(
                    mesh,
                    motion,
                    start + cells[row, 0] * along,
                    start + cells[row, 1] * along,
                    medial.across[root],
                    cells[row, 2],
                    cells[row, 3],
                    centre,
                    moved,
                    smallest - medial.tolerance,
                )
                cells[row, 5] = inner
                cells[row, 4] = wp.max(lower, bound)
                if upper < smallest:
                    smallest = upper
                    last_segment[0] = root
            count += 2
            if cells[held, 4] < cells[held + 1, 4]:
                # The half with the lower bound is searched first.
                for column in range(CELL_COLUMNS):
                    swapped = cells[held, column]
                    cells[held, column] = cells[held + 1, column]
                    cells[held + 1, column] = swapped
            held += 2
    return lowest
