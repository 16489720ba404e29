"""Friction of all contacts of a rigid tool together, and the total force of the contacts.

Friction acts on the resultant: at the centre of pressure, across the resultant normal force, no
more than ``mu`` times the sum of the normal forces. It holds that point where it can, while every
normal force adapts. Beyond the cone it acts against the slip of the point. A patch does not resist
a spin about its own normal.
"""

import warp as wp

from kernels.proxy_contacts import Contacts
from kernels.proxy_forces import MEMBERS, factorise, normal_forces, solve_set

__all__ = ["friction_force", "resolve"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

ROUNDS = 4
"""Number of rounds in which friction and normal forces are solved in turn."""
STEPS = 50
NEWTON_STEPS = 30
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
HALF = wp.constant(wp.float64(0.5))
SOFT = wp.constant(wp.float64(1.0e-11))
"""Compliance given to a point that the planes hold, relative to about 1 of a free point.

The friction of a held point is not determined.
"""
EXACT = wp.constant(wp.float64(1.0e-13))
"""Relative change of the friction force at which the iteration ends."""


@wp.func
def holding_force(
    w00: wp.float64,
    w01: wp.float64,
    w11: wp.float64,
    v0: wp.float64,
    v1: wp.float64,
    softer: wp.float64,
):
    """Compute the force that undoes the slip v of a point with compliance W: -(W + softer)^-1 v.

    The compliance is increased by ``softer``.
    """
    more = softer + SOFT
    a = w00 + more
    d = w11 + more
    share = ONE / (a * d - w01 * w01)
    return share * (w01 * v1 - d * v0), share * (w01 * v0 - a * v1)


@wp.func
def slipping_force(
    w00: wp.float64,
    w01: wp.float64,
    w11: wp.float64,
    v0: wp.float64,
    v1: wp.float64,
    bound: wp.float64,
):
    """Compute the force of size ``bound`` against the remaining slip.

    The solution uses Newton's method on reciprocals (More and Sorensen 1983).
    """
    f0 = wp.float64(0.0)
    f1 = wp.float64(0.0)
    softer = wp.float64(0.0)
    if bound > ZERO:
        for _ in range(NEWTON_STEPS):
            f0, f1 = holding_force(w00, w01, w11, v0, v1, softer)
            size = wp.sqrt(f0 * f0 + f1 * f1)
            if size <= bound * (ONE + EXACT):
                break
            g0, g1 = holding_force(w00, w01, w11, -f0, -f1, softer)
            softer += (size / bound - ONE) * size * size / (f0 * g0 + f1 * g1)
    return f0, f1


@wp.func
def friction_force(
    contacts: Contacts,
    members: int,
    compliance: wp.float64,
    friction: wp.float64,
    shift: wp.vec3d,  # without any contact force
    turn: wp.vec3d,
    last: wp.vec3d,
):
    """Compute the friction of the set's resultant and its arm from the tool's origin.

    The normal forces respond linearly.
    """
    total = wp.float64(0.0)
    along = wp.vec3d()
    arm = wp.vec3d()
    for m in range(members):
        c = contacts.member[m]
        press = contacts.press[contacts.slot[c]]
        total += press
        along += press * contacts.normal[c]
        arm += press * contacts.arm[c]
    if total <= ZERO or wp.length_sq(along) == ZERO:
        return wp.vec3d(), wp.vec3d()
    arm = arm / total
    normal = wp.normalize(along)
    side = wp.vec3d(ONE, ZERO, ZERO)
    if wp.abs(normal[0]) > wp.float64(0.7):
        side = wp.vec3d(ZERO, ONE, ZERO)
    first = wp.normalize(wp.cross(normal, side))
    second = wp.cross(normal, first)
    factorise(contacts, members, compliance)
    solve_set(contacts, members, shift, turn, ONE, 0)
    solve_set(contacts, members, first, compliance * wp.cross(arm, first), ZERO, 1)
    solve_set(contacts, members, second, compliance * wp.cross(arm, second), ZERO, 2)
    slip = shift + wp.cross(turn, arm)
    response_first = first + compliance * wp.cross(wp.cross(arm, first), arm)
    response_second = second + compliance * wp.cross(wp.cross(arm, second), arm)
    # sum of the normal forces: without friction, and per unit of both friction forces
    hold = wp.vec3d()
    for m in range(members):
        c = contacts.member[m]
        normal_response = contacts.normal[c] + compliance * wp.cross(contacts.moment[c], arm)
        slip += contacts.side[m, 0] * normal_response
        response_first += contacts.side[m, 1] * normal_response
        response_second += contacts.side[m, 2] * normal_response
        hold += wp.vec3d(contacts.side[m, 0], contacts.side[m, 1], contacts.side[m, 2])
    w00 = wp.dot(first, response_first)
    w11 = wp.dot(second, response_second)
    w01 = wp.dot(first, response_second)
    v0 = wp.dot(first, slip)
    v1 = wp.dot(second, slip)
    f0, f1 = holding_force(w00, w01, w11, v0, v1, ZERO)
    bound = friction * wp.max(hold[0] + hold[1] * f0 + hold[2] * f1, ZERO)
    if f0 * f0 + f1 * f1 > bound * bound:
        f0 = wp.dot(first, last)
        f1 = wp.dot(second, last)
        for _ in range(STEPS):  # the normal forces answer to the friction, and so does the cone
            before = bound
            bound = friction * wp.max(hold[0] + hold[1] * f0 + hold[2] * f1, ZERO)
            f0, f1 = slipping_force(w00, w01, w11, v0, v1, bound)
            if wp.abs(bound - before) <= EXACT * bound:
                break
    return f0 * first + f1 * second, arm


@wp.func
def resolve(
    contacts: Contacts,
    count: int,  # candidates
    compliance: wp.float64,  # 1 / l^2 [1/m2], 0 where the tool does not turn
    friction: wp.float64,
    tolerance: wp.float64,  # [m]
    shift: wp.vec3d,  # where the springs would have the tool [m]
    turn: wp.vec3d,  # [rad]
    last_rub: wp.vec3d,  # friction force found before [m] and its arm, from which the search starts
    last_arm: wp.vec3d,
    near: wp.float64,  # change of the friction at which it is found [m]
):
    """Return size of the set, number of solves, and friction force [m] with its arm.

    The normal forces are written to ``press``.
    """
    members = int(0)
    for c in range(count):
        contacts.chosen[c] = 0
        if contacts.press[contacts.slot[c]] > ZERO:
            if members < MEMBERS - 1:
                contacts.member[members] = c
                contacts.chosen[c] = 1
                members += 1
            else:
                contacts.press[contacts.slot[c]] = ZERO
    rub = last_rub
    arm = last_arm
    dragged = turn + compliance * wp.cross(arm, rub)
    members, solves = normal_forces(
        contacts, count, members, compliance, tolerance, shift + rub, dragged
    )
    if friction > ZERO:
        for k in range(ROUNDS):
            before = rub
            arm_before = arm
            rub, arm = friction_force(contacts, members, compliance, friction, shift, turn, before)
            if k > 0:  # halve it, so that two sets of planes do not alternate
                rub = HALF * (rub + before)
                arm = HALF * (arm + arm_before)
            dragged = turn + compliance * wp.cross(arm, rub)
            members, more = normal_forces(
                contacts, count, members, compliance, tolerance, shift + rub, dragged
            )
            solves += more
            if wp.length(rub - before) <= near:
                break
    if members == 0:
        rub = wp.vec3d()
    return members, solves, rub, arm
