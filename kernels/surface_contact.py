"""Contact of a tool with a triangulated body that has a dense compliance matrix.

The solver is a nonlinear Gauss-Seidel iteration on one thread.

The unknowns are the forces at contact points. The position of a contact point is given by
barycentric weights on its triangle. The solver visits one triangle after another, and solves the
forces at the triangle's contact points (``kernels.contact_state``). The tool's distance and normal
are evaluated at the present position of each contact point, so no outer loop over normals is
needed. The change dF_a of the force at each node a of the triangle then changes the displacements
of all loaded nodes, ``u_b += W_ba dF_a`` (``kernels.near_compliance``). Only working triangles are
solved, that is, triangles that touch the tool or carry force. When the contact points no longer
move, the other triangles near the tool are checked. If the tool would penetrate a triangle, this
triangle becomes a working triangle.
"""

import warp as wp

from kernels.arrays import Doubles, Vectors
from kernels.constants import ZERO
from kernels.contact_search import join_touching, start_over
from kernels.contact_state import (
    AREA,
    CONTACTS,
    DEEPEST,
    DONE,
    FORCE,
    IMMOVABLE,
    LARGEST,
    RUN_OUT,
    STATE,
    SWEEPS,
    TORQUE,
    WORKING,
    Body,
    Lists,
    Points,
    Pose,
    coulomb_force,
    distance_to,
    pose_of,
)
from kernels.near_compliance import LOADED, SLOTS, Patch, move_all, moved_at, push

wp.set_module_options({"max_unroll": 1})


@wp.func
def load(body: Body, patch: Patch, node: int, change: wp.vec3d):
    """Add a ``change`` to the force on a node, and update the displacements of all loaded nodes."""
    if wp.length_sq(change) > ZERO:
        body.force[node] = body.force[node] + change
        push(patch, patch.slot[node], change, patch.count[LOADED])


@wp.func
def solve_triangle(
    body: Body,
    points: Points,
    patch: Patch,
    pose: Pose,
    friction: wp.float64,
    triangle: int,
):
    """Solve the contact forces of one triangle, one contact point after another.

    Return the largest change of a contact point's position [m], and the largest displacement [m] of
    the triangle's nodes before this change.
    """
    a = body.corners[triangle, 0]
    b = body.corners[triangle, 1]
    c = body.corners[triangle, 2]
    ua = moved_at(patch, patch.slot[a])
    ub = moved_at(patch, patch.slot[b])
    uc = moved_at(patch, patch.slot[c])
    largest = wp.max(wp.length(ua), wp.max(wp.length(ub), wp.length(uc)))
    pa = body.free[a] + ua
    pb = body.free[b] + ub
    pc = body.free[c] + uc
    fa = wp.vec3d()
    fb = wp.vec3d()
    fc = wp.vec3d()
    worst = wp.float64(0.0)
    point = points.first[triangle]
    while point >= 0:
        weight = points.weight[point]
        place = weight[0] * pa + weight[1] * pb + weight[2] * pc
        old = points.force[point]
        distance, direction = distance_to(pose, points, point, place)
        if distance < ZERO or wp.length_sq(old) > ZERO:
            compliance = points.response[point, 3]
            slip = place - points.anchor[point]
            new = coulomb_force(
                compliance, points.response[point, 4], old, distance, direction, slip, friction
            )
            change = new - old
            points.force[point] = new
            pa += points.response[point, 0] * change
            pb += points.response[point, 1] * change
            pc += points.response[point, 2] * change
            fa += weight[0] * change
            fb += weight[1] * change
            fc += weight[2] * change
            worst = wp.max(worst, wp.length(compliance * change))
        point = points.following[point]
    load(body, patch, a, fa)
    load(body, patch, b, fb)
    load(body, patch, c, fc)
    return worst, largest


@wp.func
def sum_loads(body: Body, points: Points, lists: Lists, patch: Patch):
    """Recompute the nodal forces and displacements from the forces at the contact points.

    The recomputation removes rounding errors, which accumulate when only changes are added.
    """
    for k in range(patch.count[LOADED]):
        body.force[patch.node[k]] = wp.vec3d()
    for k in range(lists.count[WORKING]):
        triangle = lists.working[k]
        point = points.first[triangle]
        while point >= 0:
            weight = points.weight[point]
            for a in range(3):
                node = body.corners[triangle, a]
                body.force[node] = body.force[node] + weight[a] * points.force[point]
            point = points.following[point]
    move_all(body, patch, patch.count[SLOTS])


@wp.func
def report(
    body: Body,
    points: Points,
    lists: Lists,
    patch: Patch,
    pose: Pose,
    slack: wp.float64,
    state: int,
    results_out: Doubles,
):
    """Compute and write the results, such as the force and torque on the tool and the end state.

    If the tool penetrates the body by more than ``slack`` [m] at a rigid point, the end state DONE
    is changed to IMMOVABLE. At a rigid point, the compliance along the normal is zero.
    """
    force = wp.vec3d()
    torque = wp.vec3d()
    area = wp.float64(0.0)
    deepest = wp.float64(0.0)
    contacts = int(0)
    ended = int(state)
    for k in range(lists.count[WORKING]):
        triangle = lists.working[k]
        point = points.first[triangle]
        while point >= 0:
            place = wp.vec3d()
            weight = points.weight[point]
            for a in range(3):
                node = body.corners[triangle, a]
                place += weight[a] * (body.free[node] + moved_at(patch, patch.slot[node]))
            carried = points.force[point]
            distance, direction = distance_to(pose, points, point, place)
            deepest = wp.max(deepest, -distance)
            compliance = points.response[point, 3]
            # The compliance along the normal is only a rounding error. The body cannot yield at
            # this point, for example at a support.
            if (
                ended == DONE
                and distance < -slack
                and wp.dot(direction, compliance * direction)
                <= wp.float64(1e-12) * wp.trace(compliance)
            ):
                ended = int(IMMOVABLE)
            if wp.length_sq(carried) > ZERO:
                force -= carried
                torque -= wp.cross(place - pose.tip, carried)
                area += points.area[point]
                contacts += 1
            point = points.following[point]
    for i in range(3):
        results_out[FORCE + i] = force[i]
        results_out[TORQUE + i] = torque[i]
    results_out[STATE] = wp.float64(ended)
    results_out[CONTACTS] = wp.float64(contacts)
    results_out[AREA] = area
    results_out[DEEPEST] = deepest


@wp.kernel
def solve_contact(
    # tool
    kind: int,
    size: wp.vec2d,  # [m]
    pose_rows: Vectors,
    # law and limits
    friction: wp.float64,
    tolerance: wp.float64,  # largest change of a point, relative to the largest displacement
    sweeps: int,
    # in and out
    body_out: Body,
    points_out: Points,
    lists_out: Lists,
    patch_out: Patch,
    results_out: Doubles,
):
    """Solve the contact forces in sweeps over the working triangles.

    A triangle is working if it touches the tool or carries force. The sweeps end when the contact
    points no longer move and the tool penetrates no other triangle, or after ``sweeps`` sweeps.
    """
    pose = pose_of(pose_rows, kind, size)
    state = int(RUN_OUT)
    start_over(body_out, points_out, lists_out, patch_out, pose)
    join_touching(body_out, points_out, lists_out, patch_out, pose)
    move_all(body_out, patch_out, patch_out.count[LOADED])
    largest = wp.float64(0.0)
    sweep = int(0)
    while state == RUN_OUT and sweep < sweeps and lists_out.count[WORKING] > 0:
        sweep += 1
        worst = wp.float64(0.0)
        largest = wp.float64(0.0)
        for k in range(lists_out.count[WORKING]):
            step, moved = solve_triangle(
                body_out, points_out, patch_out, pose, friction, lists_out.working[k]
            )
            worst = wp.max(worst, step)
            largest = wp.max(largest, moved)
        if worst <= tolerance * largest:
            sum_loads(body_out, points_out, lists_out, patch_out)
            joined = join_touching(body_out, points_out, lists_out, patch_out, pose)
            if joined == 0:
                state = int(DONE)
    if lists_out.count[WORKING] == 0:
        state = int(DONE)
    if sweep == 0 or state == RUN_OUT:
        sum_loads(body_out, points_out, lists_out, patch_out)
    results_out[SWEEPS] = wp.float64(sweep)
    results_out[LARGEST] = largest
    report(
        body_out,
        points_out,
        lists_out,
        patch_out,
        pose,
        tolerance * largest,
        state,
        results_out,
    )
