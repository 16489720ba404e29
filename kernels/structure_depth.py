"""Penetration depth of a tool, a body of revolution, in a structure with a closed surface.

The tool is the union of its largest inscribed balls. If the centre of a ball lies in the structure,
the depth of the ball is its radius plus the depth of its centre. The centres of all balls form the
tool's medial axis, which is divided into cells. A cell is a part of a segment of the medial axis in
the tool's half section, rotated around the tool's axis by a range of angles. A branch-and-bound
search over the cells finds the deepest ball. The error is at most `MedialAxis.tolerance`, unless
the search is long (`kernels.tool_distance.widened`).
"""

import warp as wp

from kernels.arrays import Int32s, Vectors
from kernels.constants import HALF, ONE, TWO, ZERO
from kernels.tool_distance import nearest_on_triangle, widened

CELLS = 128
"""Number of rows of the search stack.

The search stack holds the cells that remain to be searched, where a cell is a part of the tool's
medial axis. Each halving of a cell adds one row. Thirty halvings reduce both sides of a cell from
30 mm to about a micrometre.
"""
DOUBLING = 2000
"""Number of evaluated cells after which the tolerance of a long search doubles.

A cell is a part of the tool's medial axis. The evaluation of a cell takes up to 0.3 ms, so the
tolerance must grow faster than in `kernels.structure_distance`.
"""
FAR_M = wp.float64(1.0e3)
"""Range [m] of the search for the nearest surface point, larger than any structure."""
NEAR_M = wp.float64(1.0e-6)
"""Distance [m] from a surface below which the direction to the surface is not accurate."""
OUTSIDE_SIZES = wp.float64(16.0)
"""Distance from the structure's surface to an auxiliary point outside the structure, in cell sizes.

From the distance of this point, a bound for the balls of a cell (part of the tool's medial axis) is
computed. If the space outside the structure is large enough, the bound is below the true distance
by about 1/32 of the cell size.
"""
HULL = 8
"""Number of corners of the hull around a cell of the medial axis, see `hull_corner`."""
WIDE_RAD = wp.float64(1.0)
"""Smallest half angle [rad] of a cell whose bound is computed only from the cell's size.

For larger angles, the hull around the cell is too coarse. At this angle, the outermost hull corners
are 1.85 times as far from the tool's axis as the cell.
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


@wp.struct
class AxisCell:
    """Part of a segment of the medial axis, rotated around the tool's axis by a range of angles."""

    first: wp.float64  # ends of the part, as fractions of the segment
    last: wp.float64
    angle: wp.float64  # middle of the range [rad]
    half_angle: wp.float64  # [rad]
    bound: wp.float64  # lower bound of the distance between the structure and the balls [m]
    # signed distance from the surface [m]: of the cell's middle, and before the evaluation of the
    # cell, of the last evaluated middle
    distance: wp.float64


@wp.func
def in_structure(motion: Vectors, radius: wp.float64, angle: wp.float64, height: wp.float64):
    """Convert a point of the tool, in cylindrical coordinates, to the structure's frame."""
    x = radius * wp.cos(angle)
    y = radius * wp.sin(angle)
    return motion[0] + x * motion[1] + y * motion[2] + height * motion[3]


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
    motion: Vectors,
    start: wp.vec3d,
    end: wp.vec3d,
    angle: wp.float64,
    half_angle: wp.float64,
    k: int,
):
    """Return corner `k` of the hull around a medial-axis cell, and the ball radius at the corner.

    The hull encloses the ball centres of the cell. The ball centres at each end of the cell's
    segment form an arc around the tool's axis. For each of the two arcs, the hull has corners at
    the ends of the arc and on the tangent at the middle of the arc. The hull is used because a
    concave function of ball centre and ball radius has its smallest value at a corner.
    """
    ball = wp.where(k < 4, start, end)
    turned = angle + wp.where(k % 2 == 0, -half_angle, half_angle)
    radius = ball[0]
    if (k // 2) % 2 == 1:
        radius /= wp.cos(half_angle)
    return in_structure(motion, radius, turned, ball[1]), ball[2]


@wp.func
def first_ball_inside(mesh: wp.uint64, motion: Vectors, medial: MedialAxis):
    """Return whether the centre of the first ball of the medial axis lies in the structure."""
    ball = medial.starts[0]
    return is_in_structure(mesh, in_structure(motion, ball[0], ZERO, ball[1]))


@wp.func
def cell_bounds(
    mesh: wp.uint64,
    motion: Vectors,
    medial: MedialAxis,
    segment: int,
    cell: AxisCell,
    moved: wp.float64,
    wanted: wp.float64,
):
    """Compute bounds of the smallest signed distance between the structure and the balls of a cell.

    Return a lower bound, an upper bound, and the signed distance of the cell's middle from the
    surface [m].

    `cell.distance` is the known signed distance of another point from the surface, and `moved` is
    the distance from this point to the middle of the cell. The function stops improving the lower
    bound when this bound reaches `wanted`.
    """
    origin = medial.starts[segment]
    span = medial.ends[segment] - origin
    start = origin + cell.first * span
    end = origin + cell.last * span
    angle = cell.angle
    half_angle = cell.half_angle
    middle = HALF * (start + end)
    centre = in_structure(motion, middle[0], angle, middle[1])
    apart, foot, face = nearest_on_surface(mesh, centre)
    # The sign takes far more time than the distance. Within a sphere that does not touch the
    # surface, the sign does not change, so the sign of `cell.distance` is used.
    is_inside = cell.distance < ZERO
    if wp.abs(cell.distance) <= moved + NEAR_M:
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
        if medial.across[segment] == 1:
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
    # The sign is expensive, so it is computed only if the bound would improve. The bound holds only
    # if the point lies outside.
    if from_outside > lower and not is_in_structure(mesh, outside):
        lower = from_outside
    return lower, upper, signed


@wp.func
def over_balls(
    mesh: wp.uint64,
    motion: Vectors,
    medial: MedialAxis,
    best: wp.float64,
    last_segment: Int32s,
    cells: wp.array(dtype=AxisCell),
):
    """Compute a lower bound [m] of the smallest signed distance between structure and balls.

    The balls are the inscribed balls of the tool. Only balls whose centre lies in the structure are
    included. On segments that `medial.across` marks, balls whose centre lies outside the structure
    are also included. The result is at most `best`.
    """
    smallest = best
    lowest = best
    count = int(0)
    begin = last_segment[0]
    number = medial.starts.shape[0]
    whole = AxisCell()
    whole.last = ONE
    whole.half_angle = wp.float64(wp.pi)
    last_middle = wp.vec3d()
    for turn in range(number):
        # The search starts at the segment that was deepest in the last tick, which excludes most
        # others.
        root = (begin + turn) % number
        start = medial.starts[root]
        span = medial.ends[root] - start
        long = wp.sqrt(span[0] * span[0] + span[1] * span[1])
        middle = start + HALF * span
        moved = wp.length(middle - last_middle)
        wanted = smallest - medial.tolerance
        lower, upper, signed = cell_bounds(mesh, motion, medial, root, whole, moved, wanted)
        last_middle = middle
        whole.bound = lower
        whole.distance = signed
        cells[0] = whole
        count += 1
        if upper < smallest:
            smallest = upper
            last_segment[0] = root
        held = int(1)
        while held > 0:
            held -= 1
            cell = cells[held]
            accepted = smallest - widened(medial.tolerance, count, DOUBLING)
            if cell.bound >= accepted or held + 2 > CELLS:
                lowest = wp.min(lowest, cell.bound - medial.slack)
                continue
            length = (cell.last - cell.first) * long
            radius = wp.max(start[0] + cell.first * span[0], start[0] + cell.last * span[0])
            split = HALF * (cell.first + cell.last)
            # Halve the longer side.
            split_angle = TWO * radius * cell.half_angle > length
            for half in range(2):
                part = cell
                # Distance between the middles of the cell and of its half, along the segment or
                # around the axis.
                moved = wp.float64(0.25) * (cell.last - cell.first) * long
                if split_angle:
                    middle_radius = start[0] + split * span[0]
                    moved = TWO * middle_radius * wp.sin(wp.float64(0.25) * cell.half_angle)
                    part.half_angle = HALF * cell.half_angle
                    part.angle = cell.angle + wp.where(half == 0, -part.half_angle, part.half_angle)
                elif half == 0:
                    part.last = split
                else:
                    part.first = split
                wanted = smallest - medial.tolerance
                lower, upper, signed = cell_bounds(mesh, motion, medial, root, part, moved, wanted)
                part.bound = wp.max(lower, cell.bound)
                part.distance = signed
                cells[held + half] = part
                if upper < smallest:
                    smallest = upper
                    last_segment[0] = root
            count += 2
            first_half = cells[held]
            second_half = cells[held + 1]
            if first_half.bound < second_half.bound:
                # The half with the lower bound is searched first.
                cells[held] = second_half
                cells[held + 1] = first_half
            held += 2
    return lowest
