"""Which triangles take part in a contact: those nearby, those that carry force, and those that the tool enters."""

import warp as wp

from kernels.contact_state import LARGEST, Body, Lists, Points, block, displaced, distance_to, pose_of
from kernels.friction_cone import safe_inverse
from kernels.probe_distance import SHELL, Pose, axis_distance

__all__ = ["find_near", "join_touching", "start_over"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ZERO = wp.constant(wp.float64(0.0))
SLACK = wp.constant(wp.float64(1.25))
"""How much larger than at rest a triangle may have become before the search for contacts overlooks a part of it."""


@wp.kernel
def find_near(
    # body
    body: Body,
    centre: wp.array(dtype=wp.vec3d),  # [triangle], at rest [m]
    radius: wp.array(dtype=wp.float64),  # [triangle], of the ball around it [m]
    # tool
    kind: int,
    size: wp.vec2d,  # [m]; of a shell: radius of the ball around it and its centre's height above the tip
    pose_rows: wp.array2d(dtype=wp.float64),
    reach: wp.float64,  # [m]
    # in and out
    lists: Lists,
    results: wp.array(dtype=wp.float64),
):
    """Triangles whose rest position is within reach or that work, their nodes, and where those nodes are."""
    pose = pose_of(pose_rows)
    margin = reach + results[LARGEST]
    middle = pose.tip + pose.turn * wp.vec3d(ZERO, ZERO, size[1])
    tick = lists.count[4] + 1
    lists.count[4] = tick
    near = int(0)
    nodes = int(0)
    for t in range(centre.shape[0]):
        distance = wp.length(centre[t] - middle) - size[0]
        if kind != SHELL:
            distance, _way = axis_distance(kind, size, pose, centre[t])
        if distance < radius[t] + margin or lists.working_mark[t] == 1:
            lists.near[near] = t
            near += 1
            for a in range(3):
                node = body.corners[t, a]
                if lists.near_mark[node] != tick:
                    lists.near_mark[node] = tick
                    lists.near_node[nodes] = node
                    nodes += 1
    lists.count[0] = near
    lists.count[1] = nodes
    for k in range(nodes):
        node = lists.near_node[k]
        body.moved[node] = displaced(body, lists, node)


@wp.func
def begin_work(body: Body, points: Points, lists: Lists, pose: Pose, triangle: int):
    """Let a triangle work: its nodes may carry load, its points know their responses and anchors; the number of points
    whose compliance is not there."""
    missing = int(0)
    lists.working[lists.count[2]] = triangle
    lists.count[2] = lists.count[2] + 1
    lists.working_mark[triangle] = 1
    for a in range(3):
        node = body.corners[triangle, a]
        if lists.loaded_mark[node] == 0:
            lists.loaded_mark[node] = 1
            lists.loaded[lists.count[3]] = node
            lists.count[3] = lists.count[3] + 1
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
            own = wp.mat33d()
            for a in range(3):
                to_node = wp.mat33d()
                for b in range(3):
                    between = block(body, body.corners[triangle, a], body.corners[triangle, b])
                    to_node += weight[b] * between
                points.response[point, a] = to_node
                own += weight[a] * to_node
            points.response[point, 3] = own
            points.response[point, 4] = safe_inverse(own)
            if wp.isfinite(wp.trace(own)):
                points.ready[point] = 1
            else:
                missing += 1
        point = points.following[point]
    return missing


@wp.func
def join_touching(
    body: Body, points: Points, lists: Lists, kind: int, size: wp.vec2d, pose: Pose, current: int, missing: int
):
    """Let nearby triangles work that the tool enters; how many joined, and points whose compliance is not there.

    With ``current`` 0 nodes are taken where they were before this tick. A tool is met from the side that a triangle's
    outward normal points to.
    """
    joined = int(0)
    lost = int(missing)
    for k in range(lists.count[0]):
        triangle = lists.near[k]
        if lists.working_mark[triangle] == 0 and points.first[triangle] >= 0:
            a = body.corners[triangle, 0]
            b = body.corners[triangle, 1]
            c = body.corners[triangle, 2]
            pa = body.free[a] + body.moved[a]
            pb = body.free[b] + body.moved[b]
            pc = body.free[c] + body.moved[c]
            if current == 1:
                pa = body.free[a] + displaced(body, lists, a)
                pb = body.free[b] + displaced(body, lists, b)
                pc = body.free[c] + displaced(body, lists, c)
            outward = wp.cross(pb - pa, pc - pa)
            middle = (pa + pb + pc) / wp.float64(3.0)
            wide = SLACK * wp.max(wp.length(pa - middle), wp.max(wp.length(pb - middle), wp.length(pc - middle)))
            close = kind == SHELL
            if not close:
                far, _way = axis_distance(kind, size, pose, middle)
                close = far < wide
            enters = int(0)
            if close:
                point = points.first[triangle]
                while point >= 0 and enters == 0:
                    weight = points.weight[point]
                    place = weight[0] * pa + weight[1] * pb + weight[2] * pc
                    distance, way = distance_to(kind, size, pose, points, point, place)
                    if distance < ZERO and wp.dot(way, outward) < ZERO:
                        enters = int(1)
                    point = points.following[point]
            if enters == 1:
                joined += 1
                lost += begin_work(body, points, lists, pose, triangle)
    return joined, lost


@wp.func
def start_over(body: Body, points: Points, lists: Lists, pose: Pose):
    """Rebuild work and loads from the forces that points still carry; points whose compliance is not there."""
    for k in range(lists.count[2]):
        lists.working_mark[lists.working[k]] = 0
    for k in range(lists.count[3]):
        lists.loaded_mark[lists.loaded[k]] = 0
        body.force[lists.loaded[k]] = wp.vec3d()
    lists.count[2] = 0
    lists.count[3] = 0
    missing = int(0)
    for k in range(lists.count[0]):
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
            missing += begin_work(body, points, lists, pose, triangle)
    return missing
