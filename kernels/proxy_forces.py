"""Forces that keep a rigid tool above many planes, by an active set of at most eight.

The tool is held by a spring of stiffness k and, where it may turn, by a rotational spring of
stiffness k l^2. Forces f_i, here divided by k, move it from the pose of zero spring force:
``t = t_free + sum f_i`` and ``w = w_free + sum (r_i x f_i) / l^2``. This is Gauss's principle of
least constraint with the springs as metric (Ortega, Redon and Coquillart 2007, IEEE Trans. Vis.
Comput. Graph. 13:458), so the spring forces equal the contact forces.

The normal forces are the multipliers of that quadratic problem. The plane most violated joins the
set, the set's linear system is solved, and a force that would turn into a pull leaves it (Lawson
and Hanson 1974). Sweeping from contact to contact instead would need (l / distance)^2 sweeps for
two contacts close together.
"""

import warp as wp

from kernels.proxy_contacts import Contacts

__all__ = ["MEMBERS", "factorise", "normal_forces", "solve_set"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

MEMBERS = 8
"""Planes in the set: six hold a rigid body, and one more waits while another leaves."""
ROUNDS = 64
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
TINY = wp.constant(wp.float64(1.0e-13))
"""Relative increase of the set's matrix that makes dependent planes solvable."""


@wp.func
def factorise(contacts: Contacts, members: int, compliance: wp.float64):
    """Compute the Cholesky factor of the coupling between planes.

    The matrix holds each plane's effect on the tool's motion along the normals of the others.
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
                contacts.lower[i, i] = wp.sqrt(wp.max(value, TINY * TINY))
            else:
                contacts.lower[i, j] = value / contacts.lower[j, j]


@wp.func
def solve_set(
    contacts: Contacts, members: int, shift: wp.vec3d, turn: wp.vec3d, gaps: wp.float64, column: int
):
    """Solve for the forces of the set that undo a shift and a turn, into a column.

    With ``gaps`` 1 they also close the gaps.
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
    """Remove a plane from the set and return the number left."""
    c = contacts.member[place]
    contacts.press[contacts.slot[c]] = ZERO
    contacts.chosen[c] = 0
    contacts.member[place] = contacts.member[members - 1]
    return members - 1


@wp.func
def shrink_set(
    contacts: Contacts, start: int, compliance: wp.float64, shift: wp.vec3d, turn: wp.vec3d
):
    """Solve for the forces of the set that close its gaps, removing pulling forces one by one.

    Return the size of the set and the number of solves.
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
            old = contacts.press[contacts.slot[contacts.member[m]]]
            new = contacts.side[m, 0]
            if new <= ZERO:
                part = wp.float64(0.0)
                if old > ZERO:
                    part = old / (old - new)
                if leaves < 0 or part < share:
                    share = part
                    leaves = m
        for m in range(members):
            slot = contacts.slot[contacts.member[m]]
            contacts.press[slot] += share * (contacts.side[m, 0] - contacts.press[slot])
        if leaves >= 0:
            members = drop_member(contacts, members, leaves)
            blocked = int(1)
    return members, solves


@wp.func
def moved_by_set(
    contacts: Contacts, members: int, compliance: wp.float64, shift: wp.vec3d, turn: wp.vec3d
):
    """Compute the shift and turn of the tool under the set's forces."""
    moved = shift
    turned = turn
    for m in range(members):
        c = contacts.member[m]
        press = contacts.press[contacts.slot[c]]
        moved += press * contacts.normal[c]
        turned += compliance * press * contacts.moment[c]
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
    """Compute the smallest normal forces that keep all planes, starting from the present set.

    Return the size of the set and the number of solves.
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
