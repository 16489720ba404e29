"""Signed distance of points from a tool, a body of revolution, and distance bounds on triangles.

The distance from a convex body is a convex function of position. The linear approximation of this
function at a point of a triangle is therefore a lower bound on the whole triangle.
"""

import warp as wp

from kernels.arrays import Doubles2D, Int32s
from kernels.constants import HALF, ONE, THREE, TWO, ZERO

TOLERANCE_M = wp.float64(1.0e-6)
"""Largest accepted difference [m] between the smallest distance and its lower bound."""
MOST_EVALUATIONS = 20000
"""Number of distance evaluations after which the tolerance of a search grows.

20,000 evaluations of the distance between a tool and a triangle take about 2 ms.
"""
STEPS = 10
"""Number of gradient-descent steps within a triangle before the triangle is halved.

With this value, a distance query for a ball burr near a sphere of 5120 triangles takes 68 us. With
5 steps, such a query takes 78 us, and with 20 steps 72 us.
"""
TIE_M = wp.float64(1.0e-12)
"""Difference [m] below which the distances from two pieces of an outline count as equal."""
ARC = 1


@wp.struct
class Outline:
    """Parts of a tool: half sections that are rotated about z. The origin is the tool's tip."""

    kind: Int32s  # [piece] 1 for an arc, 0 for a line
    shape: Doubles2D  # [piece, 10] see `tissue.cutters.body.outline_table`
    first: Int32s  # [part + 1] first piece of each part
    convex: Int32s  # [part]


@wp.func
def widened(tolerance: wp.float64, evaluations: int, doubling: int):
    """Return the increased tolerance of a search after a number of evaluations.

    The tolerance doubles every `doubling` evaluations beyond `MOST_EVALUATIONS`. The growing
    tolerance limits the time of a search with many equally near triangles, as in a fine tube around
    the tool. Stopping after a fixed number of evaluations would cause larger errors. Large boxes
    would then not be searched, and the distance bounds of such boxes are millimetres too low.
    """
    if evaluations < MOST_EVALUATIONS:
        return tolerance
    beyond = wp.float64(evaluations - MOST_EVALUATIONS)
    return tolerance * wp.pow(TWO, beyond / wp.float64(doubling))


@wp.func
def on_line(shape: Doubles2D, k: int, p: wp.vec2d):
    """Compute the vector from the nearest point of a straight piece of the outline to ``p``.

    Also return the radius of curvature [m], at ``p``, of the curve of constant distance through
    ``p``. The radius is 1e9 m for a straight curve.
    """
    start = wp.vec2d(shape[k, 0], shape[k, 1])
    direction = wp.vec2d(shape[k, 2], shape[k, 3])
    free = wp.dot(p - start, direction)
    reach = wp.clamp(free, ZERO, shape[k, 4])
    offset = p - start - reach * direction
    # 1e9 m: straight
    bend = wp.float64(1.0e9)
    # Beyond an end, the distance is curved around this end. Along the line, it is not curved.
    if reach != free:
        bend = wp.length(offset)
    return offset, bend


@wp.func
def on_arc(shape: Doubles2D, k: int, p: wp.vec2d):
    """Compute the vector from the nearest point of an arc of the outline to ``p``.

    Also return the arc's normal at the nearest point, and the radius of curvature [m] of the curve
    through ``p`` on which the distance is constant.
    """
    out = p - wp.vec2d(shape[k, 0], shape[k, 1])
    reach = wp.length(out)
    middle = wp.vec2d(shape[k, 3], shape[k, 4])
    direction = middle
    if reach > ZERO:
        direction = out / reach
    # Beyond the arc's half angle, the distance to the nearer end is used.
    if wp.dot(direction, middle) < shape[k, 5]:
        first = wp.vec2d(shape[k, 6], shape[k, 7])
        last = wp.vec2d(shape[k, 8], shape[k, 9])
        direction = wp.where(wp.dot(out, first) > wp.dot(out, last), first, last)
        reach = wp.length(out - shape[k, 2] * direction)
    return out - shape[k, 2] * direction, direction, reach


@wp.func
def distance_to_part(outline: Outline, part: int, point: wp.vec3d):
    """Compute the signed distance of a point from one part of the tool.

    Also return the gradient of the distance, and a radius of curvature. Through the point passes a
    surface of constant distance. The smaller of its two principal radii is returned.
    """
    radius = wp.sqrt(point[0] * point[0] + point[1] * point[1])
    p = wp.vec2d(radius, point[2])
    # 1e9 m stands for no piece yet, and for a distance without curvature.
    nearest = wp.float64(1.0e9)
    away = wp.vec2d()
    normal = wp.vec2d()
    side = wp.float64(0.0)
    bend = wp.float64(1.0e9)
    for k in range(outline.first[part], outline.first[part + 1]):
        offset = wp.vec2d()
        outward = wp.vec2d()
        if outline.kind[k] == ARC:
            offset, outward, curved = on_arc(outline.shape, k, p)
        else:
            offset, curved = on_line(outline.shape, k, p)
            outward = wp.vec2d(outline.shape[k, 3], -outline.shape[k, 2])
        length = wp.length(offset)
        if length < nearest - TIE_M:
            nearest = length
            away = offset
            normal = outward
            bend = curved
            side = wp.dot(offset, outward)
        elif length < nearest + TIE_M:
            side += wp.dot(offset, outward)  # corner, shared by two pieces
    value = wp.where(side < ZERO, -nearest, nearest)
    slope = normal
    if nearest > TIE_M:
        slope = away / value
    gradient = wp.vec3d(slope[0], ZERO, slope[1])
    if radius > ZERO:
        gradient = wp.vec3d(slope[0] * point[0] / radius, slope[0] * point[1] / radius, slope[1])
    # Around the axis, the radius of curvature is the distance from the axis, divided by the radial
    # component of the gradient.
    if slope[0] > ZERO:
        bend = wp.min(bend, radius / slope[0])
    return value, gradient, bend


@wp.func
def nearest_on_triangle(p: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Compute the point of a triangle nearest to `p`.

    See Ericson 2005, Real-Time Collision Detection, section 5.1.5.
    """
    ab = b - a
    ac = c - a
    d1 = wp.dot(ab, p - a)
    d2 = wp.dot(ac, p - a)
    d3 = wp.dot(ab, p - b)
    d4 = wp.dot(ac, p - b)
    d5 = wp.dot(ab, p - c)
    d6 = wp.dot(ac, p - c)
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    if d1 <= ZERO and d2 <= ZERO:
        return a
    if d3 >= ZERO and d4 <= d3:
        return b
    if d6 >= ZERO and d5 <= d6:
        return c
    if vc <= ZERO and d1 >= ZERO and d3 <= ZERO:
        return a + (d1 / (d1 - d3)) * ab
    if vb <= ZERO and d2 >= ZERO and d6 <= ZERO:
        return a + (d2 / (d2 - d6)) * ac
    if va <= ZERO and d4 - d3 >= ZERO and d5 - d6 >= ZERO:
        return b + ((d4 - d3) / ((d4 - d3) + (d5 - d6))) * (c - b)
    total = va + vb + vc
    return a + (vb / total) * ab + (vc / total) * ac


@wp.func
def best_mix(first: wp.vec3d, second: wp.vec3d):
    """Find the weighted mean of two linear functions with the largest minimum over a triangle.

    The functions are defined on a triangle. Each function, and the returned weighted mean, is given
    by its values at the corners of the triangle.
    """
    best = first
    if wp.min(second) > wp.min(best):
        best = second
    for i in range(3):
        j = (i + 1) % 3
        gap = first[j] - first[i]
        change = gap - (second[j] - second[i])
        if change != ZERO:
            share = gap / change
            if share > ZERO and share < ONE:
                mixed = first + share * (second - first)
                if wp.min(mixed) > wp.min(best):
                    best = mixed
    return best


@wp.func
def bounds_over(outline: Outline, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d, best: wp.float64):
    """Compute a lower and an upper bound of the smallest distance between tool and triangle.

    Gradient descent approaches the point of the triangle with the smallest distance. If the
    distance function is smooth at this point, the lower bound from its linear approximation is
    exact. At a crease, a weighted mean of two linear approximations gives this bound.
    """
    middle = (a + b + c) / THREE
    size = wp.max(wp.length(a - middle), wp.max(wp.length(b - middle), wp.length(c - middle)))
    # 1e9 m stands for no bound yet.
    lower = wp.float64(1.0e9)
    upper = wp.float64(1.0e9)
    for part in range(outline.convex.shape[0]):
        at, slope = middle, wp.vec3d()
        smallest, reach = wp.float64(1.0e9), wp.float64(1.0)
        bound = wp.vec3d(wp.float64(-1.0e9))
        tried = middle
        step = int(0)
        while step < STEPS:
            step += 1
            value, gradient, bend = distance_to_part(outline, part, tried)
            tangent = wp.vec3d(
                wp.dot(gradient, a - tried),
                wp.dot(gradient, b - tried),
                wp.dot(gradient, c - tried),
            )
            tangent += wp.vec3d(value)
            # If the part is not convex, a tangent is not a bound. The distance decreases by at most
            # the length of the path.
            if outline.convex[part] == 0:
                tangent = wp.vec3d(value - size)
                step = STEPS
            bound = best_mix(bound, tangent)
            if value < smallest:
                smallest = value
                at = tried
                slope = wp.min(bend, TWO * size) * gradient
            else:
                reach *= HALF
            if wp.min(bound) >= wp.min(best, wp.min(upper, smallest)) - TOLERANCE_M:
                step = STEPS
            tried = nearest_on_triangle(at - reach * slope, a, b, c)
        upper = wp.min(upper, smallest)
        lower = wp.min(lower, wp.min(bound))
    return lower, upper
