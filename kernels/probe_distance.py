"""Signed distance to a tool and the direction in which it grows.

A tool's tip is its lowest point and its z axis runs from the tip to the shank. A sphere touches the
tip. A cylinder ends in a flat face through the tip with a rounded edge and has no upper end. A
shell is a set of planes; each plane represents the tool around one of its points.
"""

import warp as wp

__all__ = ["CYLINDER", "SHELL", "SPHERE", "Pose", "axis_distance"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

SPHERE = 0
CYLINDER = 1
SHELL = 2
ZERO = wp.constant(wp.float64(0.0))


@wp.struct
class Pose:
    """Pose of a tool now and one tick ago."""

    tip: wp.vec3d  # [m]
    turn: wp.mat33d  # tool to world
    last_tip: wp.vec3d  # [m]
    last_turn: wp.mat33d


@wp.func
def axis_distance(kind: int, size: wp.vec2d, pose: Pose, point: wp.vec3d):
    """Compute the distance [m], negative inside, and its gradient.

    ``size[0]`` is the radius and ``size[1]`` the radius of a cylinder's edge [m].
    """
    axis = wp.vec3d(pose.turn[0, 2], pose.turn[1, 2], pose.turn[2, 2])
    arm = point - pose.tip
    if kind == SPHERE:
        arm -= size[0] * axis
        length = wp.length(arm)
        direction = -axis
        if length > ZERO:
            direction = arm / length
        return length - size[0], direction
    height = wp.dot(arm, axis)
    radial = arm - height * axis
    radius = wp.length(radial)
    out = wp.vec3d()
    if radius > ZERO:
        out = radial / radius
    outside = radius - size[0] + size[1]
    below = size[1] - height
    direction = -axis
    distance = below - size[1]
    if outside > ZERO and below > ZERO:
        corner = wp.sqrt(outside * outside + below * below)
        distance = corner - size[1]
        direction = (outside * out - below * axis) / corner
    elif outside > below:
        distance = outside - size[1]
        direction = out
    return distance, direction
