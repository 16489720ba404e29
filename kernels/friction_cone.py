"""Contact force at one point of a compliant body, by the laws of Signorini and Coulomb.

The force keeps the point out of the tool.

W is the body's compliance at the point, n the tool's normal and f the force on the body. The gap is
not negative, the force does not pull, and one of them is zero. The tangential force is at most
``mu`` times the normal force, and reaches that bound only against the slip. Sticking is a linear
system. Slipping is ``s = -l f_t`` with ``l >= 0``: without the normal force, ``(S + l I) f_t = -r``
with S the tangential Schur complement. The l with ``|f_t| = mu f_n`` is found by Newton's method on
the reciprocals, which are nearly straight lines, kept in its bracket (Jourdan, Alart and Jean 1998,
Comput. Methods Appl. Mech. Eng. 155:31, for the sweeps that call this; More and Sorensen 1983 for
the reciprocals).
"""

import warp as wp

__all__ = ["coulomb_force", "safe_inverse"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
HALF = wp.constant(wp.float64(0.5))
NEWTON_STEPS = 60
EXACT = wp.constant(wp.float64(1e-13))
"""Relative distance to the friction cone at which slipping is solved."""
TINY = wp.constant(wp.float64(1e-12))
"""Share of its trace that a compliance gets on its diagonal where a support leaves it singular."""


@wp.func
def safe_inverse(compliance: wp.mat33d):
    """Invert a compliance, also where the point cannot move in one direction."""
    size = TINY * wp.trace(compliance)
    inverse = wp.mat33d()
    if size > ZERO:
        inverse = wp.inverse(compliance + wp.diag(wp.vec3d(size, size, size)))
    return inverse


@wp.func
def slipping_force(
    compliance: wp.mat33d,
    normal: wp.vec3d,
    apart: wp.float64,
    drift: wp.vec3d,
    friction: wp.float64,
):
    """Compute the force on the edge of the friction cone.

    Without the force, the gap is ``apart`` < 0 and the tangential slip is ``drift``.
    """
    side = wp.vec3d(ONE, ZERO, ZERO)
    if wp.abs(normal[0]) > wp.float64(0.7):
        side = wp.vec3d(ZERO, ONE, ZERO)
    first = wp.normalize(wp.cross(normal, side))
    second = wp.cross(normal, first)
    moved = compliance * normal
    stiff = ONE / wp.dot(normal, moved)
    c0 = wp.dot(first, moved)
    c1 = wp.dot(second, moved)
    s00 = wp.dot(first, compliance * first) - c0 * c0 * stiff
    s11 = wp.dot(second, compliance * second) - c1 * c1 * stiff
    s01 = wp.dot(first, compliance * second) - c0 * c1 * stiff
    angle = HALF * wp.atan2(wp.float64(2.0) * s01, s00 - s11)
    turn = wp.cos(angle)
    lift = wp.sin(angle)
    along = turn * first + lift * second  # principal directions of S
    across = turn * second - lift * first
    a0 = turn * c0 + lift * c1
    a1 = turn * c1 - lift * c0
    k0 = turn * turn * s00 + wp.float64(2.0) * turn * lift * s01 + lift * lift * s11
    k1 = s00 + s11 - k0
    r0 = wp.dot(along, drift) - a0 * apart * stiff
    r1 = wp.dot(across, drift) - a1 * apart * stiff
    low = wp.float64(0.0)
    high = wp.float64(-1.0)  # not known yet
    share = wp.float64(0.0)
    f0 = wp.float64(0.0)
    f1 = wp.float64(0.0)
    press = wp.float64(0.0)
    for _ in range(NEWTON_STEPS):
        d0 = ONE / (k0 + share + TINY * (k0 + k1))
        d1 = ONE / (k1 + share + TINY * (k0 + k1))
        f0 = -r0 * d0
        f1 = -r1 * d1
        press = -(apart + a0 * f0 + a1 * f1) * stiff
        size = wp.sqrt(f0 * f0 + f1 * f1)
        excess = size - friction * press
        if wp.abs(excess) <= EXACT * size:
            break
        guess = wp.float64(-1.0)
        if excess > ZERO:
            low = share
        else:
            high = share
        if press > ZERO and size > ZERO:
            bend = -(f0 * f0 * d0 + f1 * f1 * d1) / size
            tilt = -(a0 * r0 * d0 * d0 + a1 * r1 * d1 * d1) * stiff
            rise = -bend / (size * size) + tilt / (friction * press * press)
            if rise > ZERO:
                guess = share - (ONE / size - ONE / (friction * press)) / rise
        if guess <= low or (high >= ZERO and guess >= high):
            guess = wp.float64(2.0) * share + k0 + k1
            if high >= ZERO:
                guess = HALF * (low + high)
        share = guess
    return press * normal + f0 * along + f1 * across


@wp.func
def coulomb_force(
    compliance: wp.mat33d,  # W [m/N]
    inverse: wp.mat33d,
    old: wp.vec3d,  # force that acts now [N]
    gap: wp.float64,  # with that force [m]
    normal: wp.vec3d,  # out of the tool
    slip: wp.vec3d,  # motion relative to the tool since the last tick, with that force [m]
    friction: wp.float64,
):
    """Compute the force [N] that solves the contact while all others stay."""
    back = compliance * old
    apart = gap - wp.dot(normal, back)
    force = wp.vec3d()
    if apart < ZERO:
        if friction == ZERO:
            normal_compliance = wp.dot(normal, compliance * normal)
            if normal_compliance > ZERO:
                force = -apart / normal_compliance * normal
        else:
            sideways = slip - wp.dot(slip, normal) * normal
            force = old - inverse * (gap * normal + sideways)
            press = wp.dot(force, normal)
            if press < ZERO or wp.length(force - press * normal) > friction * press:
                drift = sideways - (back - wp.dot(back, normal) * normal)
                force = slipping_force(compliance, normal, apart, drift, friction)
    return force
