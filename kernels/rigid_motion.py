"""Motions of a rigid body: rotations as unit quaternions, and the path lengths of its points."""

import warp as wp

__all__ = ["motion_length", "pose_distance", "turn_between", "turned_by"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ZERO = wp.constant(wp.float64(0.0))
HALF = wp.constant(wp.float64(0.5))
SMALL = wp.constant(wp.float64(1.0e-8))
"""Angle [rad] or its sine below which a ratio of sines is its limit."""


@wp.func
def turned_by(turn: wp.vec3d, rotation: wp.quatd):
    """Return a rotation followed by a rotation about the vector ``turn`` [rad]."""
    angle = wp.length(turn)
    share = HALF
    if angle > SMALL:
        share = wp.sin(HALF * angle) / angle
    imaginary = share * turn
    return wp.normalize(
        wp.quatd(imaginary[0], imaginary[1], imaginary[2], wp.cos(HALF * angle)) * rotation
    )


@wp.func
def turn_between(start: wp.quatd, goal: wp.quatd):
    """Compute the rotation vector [rad] of the shortest turn from one rotation to another."""
    turn = goal * wp.quat_inverse(start)
    imaginary = wp.vec3d(turn[0], turn[1], turn[2])
    cosine = turn[3]
    if cosine < ZERO:
        imaginary = -imaginary
        cosine = -cosine
    sine = wp.length(imaginary)
    share = wp.float64(2.0)
    if sine > SMALL:
        share = wp.float64(2.0) * wp.atan2(sine, cosine) / sine
    return share * imaginary


@wp.func
def motion_length(shift: wp.vec3d, turn: wp.vec3d, reach: wp.float64):
    """Return the largest path length of a point within ``reach`` [m] of the tool's origin [m]."""
    return wp.length(shift) + reach * wp.length(turn)


@wp.func
def pose_distance(
    position: wp.vec3d,
    rotation: wp.quatd,
    goal_position: wp.vec3d,
    goal: wp.quatd,
    reach: wp.float64,
):
    """Return the largest path length of a point within ``reach`` [m] to its wanted position [m].

    A ``reach`` of 0 ignores rotations.
    """
    length = wp.length(goal_position - position)
    if reach > ZERO:
        length += reach * wp.length(turn_between(rotation, goal))
    return length
