"""Signed distance between a tool of revolution and a structure.

The structure is a closed triangle surface. A branch-and-bound search over a tree of boxes, and then
over halves of triangles, finds the point of the structure's surface with the smallest distance from
the tool. The error is at most `TOLERANCE_M`, unless the search is long (`widened`). If the tool
overlaps the structure, `kernels.structure_depth` computes the penetration depth.

The kernel `clearance` computes the distance between a tool's surface and another body, by
interpolation in a grid of distances.
"""

import warp as wp

from kernels.arrays import Doubles, Int32s, Singles, Singles3D, Vectors, Vectors2D
from kernels.constants import HALF, ZERO
from kernels.elements import CHUNK, Elements
from kernels.structure_depth import AxisCell, MedialAxis, first_ball_inside, over_balls
from kernels.tool_distance import TOLERANCE_M, Outline, bounds_over, distance_to_part, widened

NODES, TRIANGLES = 256, 256
"""Numbers of rows of two search stacks: stack of tree nodes, and stack of triangles."""
DOUBLING = 10000
"""Number of distance evaluations after which the tolerance of a long search doubles.

Consider a 3.2 mm drill on the axis of a tube. For a tube of 51,000 triangles, the error is 0.001
mm, and a tick takes 3 ms. For 205,000 triangles, the error is 0.13 mm, and a tick takes 9 ms. With
a value of 2,000 instead of 10,000, the error for 205,000 triangles is 0.48 mm, and a tick takes 4
ms.
"""
DEEP_M = wp.float64(1.0e-3)
"""Depth of the structure's surface in the tool [m] above which the medial axis ``deep`` is used.

This axis is coarser if the structure has many triangles. With a larger value, a tick takes longer
in more overlaps. The value was chosen by judgement.
"""
LEAF = 4
"""Number of triangles in a leaf of the tree, equal to `meshes.surfaces.box_tree.LEAF`."""


@wp.struct
class Tree:
    """Triangles in a complete binary tree of boxes. Node i has the children 2 i + 1 and 2 i + 2."""

    centre: Vectors  # [node] [m]
    half: Vectors  # [node] half sides [m], negative in empty nodes
    corners: Vectors2D  # [triangle, 3] [m], LEAF triangles per leaf
    first_leaf: wp.int32


@wp.func
def smallest_in_triangle(
    outline: Outline,
    a: wp.vec3d,
    b: wp.vec3d,
    c: wp.vec3d,
    best: wp.float64,
    evaluations: int,
    stack: Vectors2D,
    bound: Doubles,
):
    """Find the smallest distance between the tool and a triangle, limited to at most `best`.

    Return the distance [m], the number of evaluations so far, and the smallest lower bound of the
    distance to the parts of the triangle that were not searched.
    """
    smallest = best
    # 1e9 m stands for no bound.
    left = wp.float64(1.0e9)
    count = evaluations
    lower, upper = bounds_over(outline, a, b, c, smallest)
    count += 1
    smallest = wp.min(smallest, upper)
    stack[0, 0] = a
    stack[0, 1] = b
    stack[0, 2] = c
    bound[0] = lower
    held = int(1)
    while held > 0:
        held -= 1
        accepted = smallest - widened(TOLERANCE_M, count, DOUBLING)
        if bound[held] >= accepted or held + 2 > TRIANGLES:
            left = wp.min(left, bound[held])
        else:
            p = stack[held, 0]
            q = stack[held, 1]
            r = stack[held, 2]
            pq = wp.length_sq(q - p)
            qr = wp.length_sq(r - q)
            rp = wp.length_sq(p - r)
            # Rotate the corners so that the longest edge runs from q to r.
            if pq > qr and pq >= rp:
                turned = r
                r = q
                q = p
                p = turned
            elif rp > qr:
                turned = q
                q = r
                r = p
                p = turned
            middle = HALF * (q + r)
            for half in range(2):
                end = wp.where(half == 0, q, r)
                lower, upper = bounds_over(outline, p, end, middle, smallest)
                smallest = wp.min(smallest, upper)
                stack[held, 0] = p
                stack[held, 1] = end
                stack[held, 2] = middle
                bound[held] = lower
                held += 1
            count += 2
    return smallest, count, left


@wp.func
def in_tool(motion: Vectors, point: wp.vec3d):
    """Convert a point from the structure's frame to the tool's frame."""
    p = point - motion[0]
    return wp.vec3d(wp.dot(motion[1], p), wp.dot(motion[2], p), wp.dot(motion[3], p))


@wp.func
def node_bound(outline: Outline, tree: Tree, motion: Vectors, node: int):
    """Compute a lower bound of the distance between the tool and the box of a tree node."""
    half = tree.half[node]
    # 1e9 m stands for no bound, so that an empty node is never searched.
    bound = wp.float64(1.0e9)
    if half[0] >= ZERO:
        centre = in_tool(motion, tree.centre[node])
        for part in range(outline.convex.shape[0]):
            value, gradient, _bend = distance_to_part(outline, part, centre)
            # The distance decreases by at most the length of the path. For a convex part, the
            # tangent plane of the distance gives a tighter bound.
            drop = wp.length(half)
            if outline.convex[part] == 1:
                drop = wp.float64(0.0)
                slope = gradient[0] * motion[1] + gradient[1] * motion[2] + gradient[2] * motion[3]
                for axis in range(3):
                    drop += wp.abs(slope[axis]) * half[axis]
            bound = wp.min(bound, value - drop)
    return bound


@wp.func
def over_surface(
    outline: Outline,
    tree: Tree,
    motion: Vectors,
    last_leaf: Int32s,
    nodes: Int32s,
    node_bounds: Doubles,
    stack: Vectors2D,
    bounds: Doubles,
):
    """Compute a lower bound of the signed distance [m] between the tool and a structure's surface.

    The difference between the distance and the bound is at most the search tolerance (see
    `widened`).
    """
    # 1e9 m stands for no bound.
    smallest = wp.float64(1.0e9)
    left = wp.float64(1.0e9)
    count = int(0)
    # The search starts at the leaf that was nearest in the last tick, which excludes most of the
    # tree.
    for held in range(2):
        nodes[held] = wp.where(held == 0, 0, last_leaf[0])
        node_bounds[held] = wp.float64(-1.0e9)
    height = int(2)
    while height > 0:
        height -= 1
        node = nodes[height]
        if node_bounds[height] >= smallest - widened(TOLERANCE_M, count, DOUBLING):
            left = wp.min(left, node_bounds[height])
            continue
        if node >= tree.first_leaf:
            before = smallest
            first = (node - tree.first_leaf) * LEAF
            for t in range(first, wp.min(first + LEAF, tree.corners.shape[0])):
                a = in_tool(motion, tree.corners[t, 0])
                b = in_tool(motion, tree.corners[t, 1])
                c = in_tool(motion, tree.corners[t, 2])
                smallest, count, open_bound = smallest_in_triangle(
                    outline, a, b, c, smallest, count, stack, bounds
                )
                left = wp.min(left, open_bound)
            if smallest < before:
                last_leaf[0] = node
        else:
            near = 2 * node + 1
            far = 2 * node + 2
            near_bound = node_bound(outline, tree, motion, near)
            far_bound = node_bound(outline, tree, motion, far)
            count += 2
            nearer_first = near_bound <= far_bound
            nodes[height] = wp.where(nearer_first, far, near)
            node_bounds[height] = wp.max(near_bound, far_bound)
            nodes[height + 1] = wp.where(nearer_first, near, far)
            node_bounds[height + 1] = wp.min(near_bound, far_bound)
            height += 2
    return wp.min(smallest - TOLERANCE_M, left)


@wp.kernel
def distance_to_structure(
    outline: Outline,
    tree: Tree,
    mesh: wp.uint64,
    # rows: tip [m]; tool axes x, y, z, in the structure's frame
    motion: Vectors,
    medial: MedialAxis,
    deep: MedialAxis,  # used for deep overlaps
    # scratch arrays
    last_leaf_out: Int32s,
    nodes_out: Int32s,
    node_bounds_out: Doubles,
    stack_out: Vectors2D,
    bounds_out: Doubles,
    last_segment_out: Int32s,
    cells_out: wp.array(dtype=AxisCell),
    first_thread: int,
    # out
    distance_out: Doubles,  # [m], negative where tool and structure overlap
):
    """Compute a lower bound [m] of the signed distance between a tool and a structure."""
    smallest = over_surface(
        outline, tree, motion, last_leaf_out, nodes_out, node_bounds_out, stack_out, bounds_out
    )
    if smallest < ZERO or first_ball_inside(mesh, motion, medial):
        # The surfaces touch, or the whole tool is inside. Compute how deep the balls of the tool
        # lie in the structure.
        if smallest < -DEEP_M:
            smallest = over_balls(mesh, motion, deep, smallest, last_segment_out, cells_out)
        else:
            smallest = over_balls(mesh, motion, medial, smallest, last_segment_out, cells_out)
    distance_out[0] = smallest


@wp.func
def clipped(distance: Singles3D, i: int, j: int, k: int):
    """Return the stored distance [m] at grid voxel (i, j, k).

    Outside the grid, the nearest voxel of the grid is used.
    """
    return distance[
        wp.clamp(i, 0, distance.shape[0] - 1),
        wp.clamp(j, 0, distance.shape[1] - 1),
        wp.clamp(k, 0, distance.shape[2] - 1),
    ]


@wp.func
def along_z(distance: Singles3D, i: int, j: int, k: int, share: float):
    """Interpolate the stored distance [m] between the grid voxels (i, j, k) and (i, j, k + 1)."""
    return wp.lerp(clipped(distance, i, j, k), clipped(distance, i, j, k + 1), share)


@wp.kernel
def clearance(
    # tool
    elements: Elements,
    motion: Vectors,  # rows: tip [voxel]; tool axes x, y, z
    spacing: float,  # [m]
    # field
    distance: Singles3D,  # at voxel centres [m]
    chunk_offset: int,
    # out
    least_out: Singles,  # [chunk], smallest distance of the chunk's elements [m]
):
    """Compute the smallest distance of each chunk's surface elements from another body.

    The distances from the other body are given at voxel centres, and are interpolated trilinearly.
    """
    chunk = wp.tid() + chunk_offset
    # 1e9 m stands for no distance yet.
    least = float(1.0e9)
    for e in range(chunk * CHUNK, wp.min(chunk * CHUNK + CHUNK, elements.point.shape[0])):
        arm = elements.point[e] / spacing
        place = wp.vec3(motion[0]) + arm[0] * wp.vec3(motion[1]) + arm[1] * wp.vec3(motion[2])
        place += arm[2] * wp.vec3(motion[3]) - wp.vec3(0.5)
        i = int(wp.floor(place[0]))
        j = int(wp.floor(place[1]))
        k = int(wp.floor(place[2]))
        fy = place[1] - float(j)
        fz = place[2] - float(k)
        near = wp.lerp(along_z(distance, i, j, k, fz), along_z(distance, i, j + 1, k, fz), fy)
        i += 1
        far = wp.lerp(along_z(distance, i, j, k, fz), along_z(distance, i, j + 1, k, fz), fy)
        least = wp.min(least, wp.lerp(near, far, place[0] - float(i - 1)))
    least_out[chunk] = least
