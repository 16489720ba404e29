"""State shared by the contact kernels.

It holds a body's surface, its contact points, work lists, and the places in the results.
"""

import warp as wp

from kernels.probe_distance import SHELL, Pose, axis_distance

__all__ = [
    "AREA",
    "CONTACTS",
    "DEEPEST",
    "DONE",
    "FORCE",
    "IMMOVABLE",
    "LARGEST",
    "MISSING",
    "NEARBY",
    "RESULTS",
    "RUN_OUT",
    "STATE",
    "SWEEPS",
    "TICK",
    "TORQUE",
    "WORKING",
    "Body",
    "Lists",
    "Points",
    "block",
    "distance_to",
    "pose_of",
]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FORCE, TORQUE, STATE, SWEEPS, CONTACTS, AREA, DEEPEST, LARGEST, RESULTS = (
    0,
    3,
    6,
    7,
    8,
    9,
    10,
    11,
    12,
)
"""Places in the results, and their size.

In order: force on the tool [N], torque on the tool [N m], state at the end of the solve, sweeps,
contacts, contact area [m2], deepest point and largest displacement [m]; number of entries.

In order: force on the tool [N], torque on the tool [N m], state at the end of the solve, sweeps,
contacts, contact area [m2], deepest point and largest displacement [m].
"""
DONE, RUN_OUT, IMMOVABLE, MISSING = 0, 1, 2, 3
"""End states of a solve."""


@wp.struct
class Body:
    """Surface of a body, s nodes and f triangles."""

    free: wp.array(dtype=wp.vec3d)  # [node], positions without contact [m]
    last_free: wp.array(dtype=wp.vec3d)  # [node], positions of the last tick [m]
    scale: wp.float64  # of the compliance
    compliance: wp.array2d(dtype=wp.float64)  # [3 node, 3 node] [m/N]
    corners: wp.array2d(dtype=wp.int32)  # [triangle, 3]
    force: wp.array(dtype=wp.vec3d)  # [node] [N]
    moved: wp.array(dtype=wp.vec3d)  # [node], displacement of nodes nearby before this tick [m]


@wp.struct
class Points:
    """Contact points and the forces they carry."""

    first: wp.array(dtype=wp.int32)  # [triangle], its first point, -1 for none
    following: wp.array(dtype=wp.int32)  # [point], next point of the triangle, -1 after the last
    weight: wp.array(dtype=wp.vec3d)  # [point], barycentric
    area: wp.array(dtype=wp.float64)  # [point] [m2]
    tool_point: wp.array(dtype=wp.vec3d)  # [point], of a shell, now [m]
    tool_normal: wp.array(dtype=wp.vec3d)
    force: wp.array(dtype=wp.vec3d)  # [point], on the body [N]
    # [point], where the tool has carried the point's last place [m]
    anchor: wp.array(dtype=wp.vec3d)
    # [point, 5]: of the three nodes and of itself [m/N], and the inverse [N/m]
    response: wp.array2d(dtype=wp.mat33d)
    ready: wp.array(dtype=wp.int32)  # [point], 1 once the responses are there


NEARBY, WORKING, TICK = 0, 1, 2
"""Places in the counts of `Lists`: nearby triangles, working triangles, ticks."""


@wp.struct
class Lists:
    """Work lists."""

    count: wp.array(dtype=wp.int32)  # [3], see NEARBY
    near: wp.array(dtype=wp.int32)  # triangles
    working: wp.array(dtype=wp.int32)  # triangles
    working_mark: wp.array(dtype=wp.int32)  # [triangle], 1 while it works


@wp.func
def pose_of(pose: wp.array2d(dtype=wp.float64)):
    """Read a pose from rows: tip, rotation, last tip, last rotation."""
    now = Pose()
    now.tip = wp.vec3d(pose[0, 0], pose[0, 1], pose[0, 2])
    now.last_tip = wp.vec3d(pose[4, 0], pose[4, 1], pose[4, 2])
    for i in range(3):
        for j in range(3):
            now.turn[i, j] = pose[1 + i, j]
            now.last_turn[i, j] = pose[5 + i, j]
    return now


@wp.func
def block(body: Body, a: int, b: int):
    """Return the compliance between two nodes [m/N]."""
    compliance = body.compliance
    i = 3 * a
    j = 3 * b
    return body.scale * wp.mat33d(
        compliance[i, j],
        compliance[i, j + 1],
        compliance[i, j + 2],
        compliance[i + 1, j],
        compliance[i + 1, j + 1],
        compliance[i + 1, j + 2],
        compliance[i + 2, j],
        compliance[i + 2, j + 1],
        compliance[i + 2, j + 2],
    )


@wp.func
def distance_to(kind: int, size: wp.vec2d, pose: Pose, points: Points, point: int, place: wp.vec3d):
    """Compute the distance to the tool [m] and its gradient at a contact point."""
    if kind == SHELL:
        direction = points.tool_normal[point]
        return wp.dot(place - points.tool_point[point], direction), direction
    distance, direction = axis_distance(kind, size, pose, place)
    return distance, direction
