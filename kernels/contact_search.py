"""Search for the triangles that take part in a contact.

The search finds the triangles near the tool, the triangles whose contact points carry force, and
the triangles that the tool penetrates.
"""

import warp as wp

from kernels.arrays import Doubles, Vectors
from kernels.constants import THREE, ZERO
from kernels.contact_state import (
    LARGEST,
    NEARBY,
    SHELL,
    TICK,
    WORKING,
    Body,
    Lists,
    Points,
    Pose,
    axis_distance,
    block,
    distance_to,
    pose_of,
    safe_inverse,
)
from kernels.near_compliance import (
    LOADED,
    SLOTS,
    STALE,
    Patch,
    add_node,
    drop_idle,
    drop_left,
    gather_again,
    keep_loaded,
    move_all,
    moved_at,
)

wp.set_module_options({"max_unroll": 1})

SLACK = wp.float64(1.25)
"""Search distance around the middle of a triangle, in triangle radii.

The radius of a triangle is the distance from its middle to its farthest corner. A search distance
of 1 covers the whole triangle, and the rest is a margin.
"""


@wp.kernel
def find_near(
    # body
    centre: Vectors,  # [triangle], at rest [m]
    radius: Doubles,  # [triangle], radius of the ball around it [m]
    # tool
    kind: int,
    # [m]; of a shell: radius of the enclosing ball, height of its centre above the tip
    size: wp.vec2d,
    pose_rows: Vectors,
    reach: wp.float64,  # [m]
    results: Doubles,  # of the last tick
    # in and out
    body_out: Body,
    lists_out: Lists,
    patch_out: Patch,
):
    """Find the nearby triangles, the working triangles, their nodes, and the nodes' displacements.

    A triangle is nearby if the distance between the tool and the ball around the undeformed
    triangle is below a limit. The limit is ``reach`` plus the largest displacement in the last tick
    (1 ms step). A triangle is working if the solver treats the contact forces at its points as
    unknowns.
    """
    pose = pose_of(pose_rows, kind, size)
    margin = reach + results[LARGEST]
    middle = pose.tip + pose.turn * wp.vec3d(ZERO, ZERO, size[1])
    tick = lists_out.count[TICK] + 1
    lists_out.count[TICK] = tick
    near = int(0)
    known = patch_out.count[SLOTS]
    stale = patch_out.count[STALE]
    if stale == 1:
        gather_again(body_out, patch_out)
    for t in range(centre.shape[0]):
        distance = wp.length(centre[t] - middle) - size[0]
        # The ball around a shell bounds its distance; the other tools have a formula.
        if pose.kind != SHELL:
            distance, _normal = axis_distance(pose, centre[t])
        if distance < radius[t] + margin or lists_out.working_mark[t] == 1:
            lists_out.near[near] = t
            near += 1
            for a in range(3):
                node = body_out.corners[t, a]
                patch_out.near_mark[node] = tick
                if patch_out.slot[node] < 0:
                    add_node(body_out, patch_out, node)
    lists_out.count[NEARBY] = near
    stale = wp.max(stale, patch_out.count[SLOTS] - known)
    drop_left(patch_out, tick)
    if stale > 0:
        move_all(body_out, patch_out, patch_out.count[SLOTS])
    for slot in range(patch_out.count[SLOTS]):
        body_out.moved[patch_out.node[slot]] = moved_at(patch_out, slot)


@wp.func
def begin_work(body: Body, points: Points, lists: Lists, patch: Patch, pose: Pose, triangle: int):
    """Add a triangle to the working triangles, that is, to the triangles that the solver visits.

    The nodes of a working triangle may carry load. For each contact point of the triangle, the
    compliance and the friction anchor are stored. The anchor is the position that the point would
    have if it had moved with the tool since the last tick.
    """
    lists.working[lists.count[WORKING]] = triangle
    lists.count[WORKING] = lists.count[WORKING] + 1
    lists.working_mark[triangle] = 1
    for a in range(3):
        keep_loaded(body, patch, body.corners[triangle, a], lists.count[TICK])
    point = points.first[triangle]
    while point >= 0:
        weight = points.weight[point]
        place = wp.vec3d()
        for a in range(3):
            node = body.corners[triangle, a]
            place += weight[a] * (body.last_free[node] + body.moved[node])
        arm = wp.transpose(pose.last_turn) * (place - pose.last_tip)
        points.anchor[point] = pose.tip + pose.turn * arm
        if points.ready[point] == 0:
            compliance = wp.mat33d()
            for a in range(3):
                to_node = wp.mat33d()
                for b in range(3):
                    between = block(body, body.corners[triangle, a], body.corners[triangle, b])
                    to_node += weight[b] * between
                points.response[point, a] = to_node
                compliance += weight[a] * to_node
            points.response[point, 3] = compliance
            points.response[point, 4] = safe_inverse(compliance)
            points.ready[point] = 1
        point = points.following[point]


@wp.func
def join_touching(
    body: Body,
    points: Points,
    lists: Lists,
    patch: Patch,
    pose: Pose,
):
    """Add nearby triangles that the tool penetrates to the working triangles.

    Return the number of added triangles. Penetration counts only if the tool is on the side of the
    triangle's outward normal.
    """
    joined = int(0)
    for k in range(lists.count[NEARBY]):
        triangle = lists.near[k]
        if lists.working_mark[triangle] == 0 and points.first[triangle] >= 0:
            a = body.corners[triangle, 0]
            b = body.corners[triangle, 1]
            c = body.corners[triangle, 2]
            pa = body.free[a] + moved_at(patch, patch.slot[a])
            pb = body.free[b] + moved_at(patch, patch.slot[b])
            pc = body.free[c] + moved_at(patch, patch.slot[c])
            # A shell has no axis from which the distance could be bounded, so every nearby triangle
            # is searched.
            close = pose.kind == SHELL
            if not close:
                middle = (pa + pb + pc) / THREE
                wide = wp.max(
                    wp.length_sq(pa - middle),
                    wp.max(wp.length_sq(pb - middle), wp.length_sq(pc - middle)),
                )
                far, _normal = axis_distance(pose, middle)
                close = far < ZERO or far * far < SLACK * SLACK * wide
            enters = int(0)
            if close:
                outward = wp.cross(pb - pa, pc - pa)
                point = points.first[triangle]
                while point >= 0 and enters == 0:
                    weight = points.weight[point]
                    place = weight[0] * pa + weight[1] * pb + weight[2] * pc
                    distance, normal = distance_to(pose, points, point, place)
                    if distance < ZERO and wp.dot(normal, outward) < ZERO:
                        enters = int(1)
                    point = points.following[point]
            if enters == 1:
                joined += 1
                begin_work(body, points, lists, patch, pose, triangle)
    return joined


@wp.func
def start_over(body: Body, points: Points, lists: Lists, patch: Patch, pose: Pose):
    """Recompute the list of working triangles and the nodal forces from the contact forces.

    A triangle is working if one of its contact points carries force.
    """
    for k in range(lists.count[WORKING]):
        lists.working_mark[lists.working[k]] = 0
    lists.count[WORKING] = 0
    for k in range(patch.count[LOADED]):
        body.force[patch.node[k]] = wp.vec3d()
    for k in range(lists.count[NEARBY]):
        triangle = lists.near[k]
        carries = int(0)
        point = points.first[triangle]
        while point >= 0:
            force = points.force[point]
            if wp.length_sq(force) > ZERO:
                carries = int(1)
                weight = points.weight[point]
                for a in range(3):
                    node = body.corners[triangle, a]
                    body.force[node] = body.force[node] + weight[a] * force
            point = points.following[point]
        if carries == 1:
            begin_work(body, points, lists, patch, pose, triangle)
    drop_idle(patch, lists.count[TICK])
