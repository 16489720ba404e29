"""Normal and friction forces that keep a rigid tool above planes, from an active-set method.

The tool is held by a spring of stiffness k. A tool that may turn is also held by a rotational
spring of stiffness k l^2, with a length l. Let f_i be contact forces, divided by k, at the arms
r_i. They displace the tool from the pose of zero spring force. The tool's shift is ``t = t_free +
sum f_i``, and the tool's turn is ``w = w_free + sum (r_i x f_i) / l^2``. This result follows from
Gauss's principle of least constraint with the stiffness as metric (Ortega, Redon and Coquillart
2007, IEEE Trans. Vis. Comput. Graph. 13:458). At the displaced pose, the spring forces are in
equilibrium with the contact forces.

The normal forces are the Lagrange multipliers of this quadratic problem. In each iteration, the
most violated plane joins the active set, and the linear system for the forces of this set is
solved. A plane whose force would pull on the tool leaves the set (Lawson and Hanson 1974). A
Gauss-Seidel method is not used, because it would need about (l / d)^2 sweeps for two contacts at a
small distance d.

The friction of all contacts of the tool is computed as one force.

The friction force acts at the centre of pressure, perpendicular to the resultant normal force. Its
magnitude is at most ``mu`` times the sum of the normal forces. Below this limit, friction prevents
any motion of the centre of pressure, and the normal forces are computed accordingly. At the limit,
friction acts against the slip of the centre of pressure. Friction does not resist rotation about
the normal of a contact patch.
"""

import warp as wp

from kernels.constants import HALF, ONE, ZERO
from kernels.proxy_contacts import Contacts

wp.set_module_options({"max_unroll": 1})

MEMBERS = 8
"""Largest number of planes in the active set.

Six planes fix a rigid body, and one more plane may join the set before another plane leaves.
"""
ROUNDS = 64
"""Largest number of times that a plane joins the active set in one solve.

The number is several times `MEMBERS`, because a plane may leave and join again.
"""
TINY = wp.float64(1.0e-13)
"""Relative increase of the matrix diagonal, which regularises linearly dependent planes."""


@wp.func
def factorise(contacts: Contacts, members: int, compliance: wp.float64):
    """Compute the Cholesky factor of the compliance matrix of the planes in the active set.

    An entry of the matrix is the tool's motion along the normal of one plane, caused by a unit
    force at another plane.
    """
    for i in range(members):
        a = contacts.member[i]
        for j in range(i + 1):
            b = contacts.member[j]
            value = wp.dot(contacts.normal[a], contacts.normal[b])
            value += compliance * wp.dot(contacts.moment[a], contacts.moment[b])
            if i == j:
                value += TINY * value
            for k in range(j):
                value -= contacts.lower[i, k] * contacts.lower[j, k]
            if i == j:
                # Rounding may lead to a negative pivot if planes are dependent.
                contacts.lower[i, i] = wp.sqrt(wp.max(value, TINY * TINY))
            else:
                contacts.lower[i, j] = value / contacts.lower[j, j]


@wp.func
def solve_set(
    contacts: Contacts, members: int, shift: wp.vec3d, turn: wp.vec3d, gaps: wp.float64, column: int
):
    """Compute normal forces that cancel the effect of a shift and a turn at the active planes.

    The forces are written to a ``column`` of ``contacts.side``.

    If ``gaps`` is 1, the forces also close the gap between each plane and its point. If ``gaps`` is
    0, the gaps are ignored.
    """
    for i in range(members):
        c = contacts.member[i]
        value = (
            -gaps * contacts.gap[c]
            - wp.dot(contacts.normal[c], shift)
            - wp.dot(contacts.moment[c], turn)
        )
        for k in range(i):
            value -= contacts.lower[i, k] * contacts.side[k, column]
        contacts.side[i, column] = value / contacts.lower[i, i]
    for back in range(members):
        i = members - 1 - back
        value = contacts.side[i, column]
        for k in range(i + 1, members):
            value -= contacts.lower[k, i] * contacts.side[k, column]
        contacts.side[i, column] = value / contacts.lower[i, i]


@wp.func
def drop_member(contacts: Contacts, members: int, place: int):
    """Remove a plane from the active set (planes with force), and return the remaining number."""
    c = contacts.member[place]
    contacts.normal_force[contacts.slot[c]] = ZERO
    contacts.chosen[c] = 0
    contacts.member[place] = contacts.member[members - 1]
    return members - 1


@wp.func
def shrink_set(
    contacts: Contacts, start: int, compliance: wp.float64, shift: wp.vec3d, turn: wp.vec3d
):
    """Compute the normal forces that close the gaps of the planes in the active set.

    Planes whose force would pull on the tool are removed from the set one by one.

    Return the number of planes in the set and the number of linear systems solved.
    """
    members = start
    solves = int(0)
    blocked = int(1)
    while blocked == 1 and members > 0:
        blocked = int(0)
        factorise(contacts, members, compliance)
        solve_set(contacts, members, shift, turn, ONE, 0)
        solves += 1
        share = wp.float64(1.0)
        leaves = int(-1)
        for m in range(members):
            old = contacts.normal_force[contacts.slot[contacts.member[m]]]
            new = contacts.side[m, 0]
            # A plane would pull. Change the forces only until the first such force is 0, and remove
            # its plane.
            if new <= ZERO:
                part = wp.float64(0.0)
                if old > ZERO:
                    part = old / (old - new)
                if leaves < 0 or part < share:
                    share = part
                    leaves = m
        for m in range(members):
            slot = contacts.slot[contacts.member[m]]
            contacts.normal_force[slot] += share * (
                contacts.side[m, 0] - contacts.normal_force[slot]
            )
        if leaves >= 0:
            members = drop_member(contacts, members, leaves)
            blocked = int(1)
    return members, solves


@wp.func
def moved_by_set(
    contacts: Contacts, members: int, compliance: wp.float64, shift: wp.vec3d, turn: wp.vec3d
):
    """Compute the tool's shift and turn under the normal forces of the planes in the active set."""
    moved = shift
    turned = turn
    for m in range(members):
        c = contacts.member[m]
        normal_force = contacts.normal_force[contacts.slot[c]]
        moved += normal_force * contacts.normal[c]
        turned += compliance * normal_force * contacts.moment[c]
    return moved, turned


@wp.func
def normal_forces(
    contacts: Contacts,
    count: int,
    start: int,
    compliance: wp.float64,
    tolerance: wp.float64,
    shift: wp.vec3d,
    turn: wp.vec3d,
):
    """Compute the smallest normal forces that keep the tool above all planes.

    The method starts from the present active set of ``start`` planes. Return the number of planes
    in the new set and the number of linear systems solved.
    """
    members, solves = shrink_set(contacts, start, compliance, shift, turn)
    for _ in range(ROUNDS):
        moved, turned = moved_by_set(contacts, members, compliance, shift, turn)
        deepest = -tolerance
        worst = int(-1)
        for c in range(count):
            if contacts.chosen[c] == 0:
                gap = (
                    contacts.gap[c]
                    + wp.dot(contacts.normal[c], moved)
                    + wp.dot(contacts.moment[c], turned)
                )
                if gap < deepest:
                    deepest = gap
                    worst = c
        if worst < 0 or members == MEMBERS:
            break
        contacts.member[members] = worst
        contacts.chosen[worst] = 1
        members, more = shrink_set(contacts, members + 1, compliance, shift, turn)
        solves += more
        if contacts.chosen[worst] == 0:
            break
    return members, solves


FRICTION_ROUNDS = 4
"""Largest number of rounds in which friction and normal forces are computed alternately."""
STEPS = 50
"""Largest number of iterations for the friction force and the upper bound of this force.

The bound depends on the normal forces, and the normal forces depend on friction.
"""
NEWTON_STEPS = 30
"""Largest number of Newton steps in `slipping_force`, which converge quadratically."""
SOFT = wp.float64(1.0e-11)
"""Compliance that is added at a point, because planes may hold the point fixed.

At a point without compliance, the friction force would not be determined. For comparison, a free
point has a compliance of about 1.
"""
EXACT = wp.float64(1.0e-13)
"""Relative change of the friction force's upper bound at which the iteration ends."""


@wp.func
def holding_force(
    w00: wp.float64,
    w01: wp.float64,
    w11: wp.float64,
    v0: wp.float64,
    v1: wp.float64,
    softer: wp.float64,
):
    """Compute the friction force that cancels the slip v of a point: ``-(W + softer I)^-1 v``.

    W is the symmetric 2 x 2 compliance matrix of the point in the tangent plane.
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
    """Compute a friction force of magnitude ``bound`` that opposes the slip under this force.

    The solution applies Newton's method to the reciprocal of the force's magnitude (More and
    Sorensen 1983).
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
    """Compute the friction force of the active set, and the arm at which this force acts.

    The arm is the vector from the tool's origin to the point at which the force acts. The method
    accounts for the fact that the normal forces depend linearly on the friction force.
    """
    total = wp.float64(0.0)
    along = wp.vec3d()
    arm = wp.vec3d()
    for m in range(members):
        c = contacts.member[m]
        normal_force = contacts.normal_force[contacts.slot[c]]
        total += normal_force
        along += normal_force * contacts.normal[c]
        arm += normal_force * contacts.arm[c]
    if total <= ZERO or wp.length_sq(along) == ZERO:
        return wp.vec3d(), wp.vec3d()
    arm = arm / total
    normal = wp.normalize(along)
    side = wp.vec3d(ONE, ZERO, ZERO)
    # Use an axis more than 45 degrees from the normal, to avoid cancellation in the cross product.
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
    # sum of the normal forces: without friction, and change per unit of the two friction components
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
        for _ in range(STEPS):  # normal forces and cone depend on friction
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
    shift: wp.vec3d,  # shift to the pose of zero spring force [m]
    turn: wp.vec3d,  # [rad]
    last_tangential_force: wp.vec3d,  # last friction force [m] and its arm; start of the search
    last_arm: wp.vec3d,
    near: wp.float64,  # change at which the friction force counts as found [m]
):
    """Compute the normal and friction forces of all contacts.

    Forces are divided by the stiffness of the coupling spring, so their unit is m. Return the
    number of planes in the active set, the number of linear systems solved, the friction force [m],
    and the arm [m] at which the friction force acts. The normal forces are written to
    ``contacts.normal_force``.
    """
    members = int(0)
    for c in range(count):
        contacts.chosen[c] = 0
        if contacts.normal_force[contacts.slot[c]] > ZERO:
            # One entry is reserved for a plane that joins.
            if members < MEMBERS - 1:
                contacts.member[members] = c
                contacts.chosen[c] = 1
                members += 1
            else:
                contacts.normal_force[contacts.slot[c]] = ZERO
    tangential_force = last_tangential_force
    arm = last_arm
    dragged = turn + compliance * wp.cross(arm, tangential_force)
    members, solves = normal_forces(
        contacts, count, members, compliance, tolerance, shift + tangential_force, dragged
    )
    if friction > ZERO:
        for k in range(FRICTION_ROUNDS):
            before = tangential_force
            arm_before = arm
            tangential_force, arm = friction_force(
                contacts, members, compliance, friction, shift, turn, before
            )
            if k > 0:  # halve the change, so that two sets do not alternate
                tangential_force = HALF * (tangential_force + before)
                arm = HALF * (arm + arm_before)
            dragged = turn + compliance * wp.cross(arm, tangential_force)
            members, more = normal_forces(
                contacts, count, members, compliance, tolerance, shift + tangential_force, dragged
            )
            solves += more
            if wp.length(tangential_force - before) <= near:
                break
    if members == 0:
        tangential_force = wp.vec3d()
    return members, solves, tangential_force, arm
