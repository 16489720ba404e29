"""One tick of a proxy: a rigid tool goes as near to where its device is as the things around it allow.

From its last pose the tool descends in steps no longer than the way that is surely free, or half a voxel beside
something; every step solves the contacts at hand, and one that ends too deep is taken back and halved. So the proxy
stays on the side of a wall on which it was, however fast the device went through (Zilles and Salisbury 1995, IROS;
Ruspini, Kolarov and Khatib 1997, SIGGRAPH). Turns are applied on the group, as unit quaternions.
"""

import warp as wp

from kernels.proxy_contacts import Contacts, Shell, collect
from kernels.proxy_friction import resolve
from kernels.voxmap import Field

__all__ = ["REPORT", "STATE", "advance_proxy"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

STATE = 8
"""Position xyz [m], quaternion xyzw, travel [m]."""
REPORT = 14
"""1 when settled, contacts that press, steps, solves, least gap [m], force [m] and moment [m2] over the stiffness, and
the centre of pressure from the tool's origin, in the world's axes [m]."""
HALVINGS = 8
STALLS = 2
"""Steps in a row that hardly lower the springs' energy: beside voxels the proxy swings over creases, and may rest."""
LITTLE = wp.constant(wp.float64(1.0e-4))
"""Share of the springs' energy by which a step must lower it beside voxels."""
TOO_DEEP = wp.constant(wp.float64(0.1))
"""Share of a step by which a point may sink in before the step is taken back."""
ZERO = wp.constant(wp.float64(0.0))
ONE = wp.constant(wp.float64(1.0))
HALF = wp.constant(wp.float64(0.5))
TWO = wp.constant(wp.float64(2.0))
SMALL = wp.constant(wp.float64(1.0e-8))


@wp.func
def turned_by(turn: wp.vec3d, rotation: wp.quatd):
    """Rotation followed by one about the rotation vector ``turn`` [rad]."""
    angle = wp.length(turn)
    share = HALF
    if angle > SMALL:
        share = wp.sin(HALF * angle) / angle
    way = share * turn
    return wp.normalize(wp.quatd(way[0], way[1], way[2], wp.cos(HALF * angle)) * rotation)


@wp.func
def turn_between(start: wp.quatd, goal: wp.quatd):
    """Rotation vector [rad] of the shortest turn from one rotation to another."""
    turn = goal * wp.quat_inverse(start)
    way = wp.vec3d(turn[0], turn[1], turn[2])
    cosine = turn[3]
    if cosine < ZERO:
        way = -way
        cosine = -cosine
    sine = wp.length(way)
    share = wp.float64(2.0)
    if sine > SMALL:
        share = wp.float64(2.0) * wp.atan2(sine, cosine) / sine
    return share * way


@wp.func
def contact_sums(contacts: Contacts, members: int):
    """How many members press, their normal forces [m] and moments [m2] in sum, and their centre of pressure [m]."""
    pressing = int(0)
    force = wp.vec3d()
    moment = wp.vec3d()
    centre = wp.vec3d()
    total = wp.float64(0.0)
    for m in range(members):
        c = contacts.member[m]
        press = contacts.press[contacts.slot[c]]
        if press > ZERO:
            pressing += 1
            force += press * contacts.normal[c]
            moment += press * contacts.moment[c]
            centre += press * contacts.arm[c]
            total += press
    if total > ZERO:
        centre /= total
    return pressing, force, moment, centre


@wp.func
def first_touch(contacts: Contacts, count: int, shift: wp.vec3d, turn: wp.vec3d):
    """Share of a motion after which the first plane is met, 2 where none is."""
    share = wp.float64(2.0)
    for c in range(count):
        closing = -wp.dot(contacts.normal[c], shift) - wp.dot(contacts.moment[c], turn)
        if closing > contacts.gap[c]:
            share = wp.min(share, contacts.gap[c] / closing)
    return share


@wp.func
def pose_distance(position: wp.vec3d, rotation: wp.quatd, target: wp.vec3d, target_turn: wp.quatd, reach: wp.float64):
    """Greatest way of a point within ``reach`` [m] to where it is wanted [m]; a reach of 0 leaves turns out."""
    way = wp.length(target - position)
    if reach > ZERO:
        way += reach * wp.length(turn_between(rotation, target_turn))
    return way


@wp.func
def write_pose(state_out: wp.array(dtype=wp.float64), position: wp.vec3d, rotation: wp.quatd, travel: wp.float64):
    """Write the state."""
    for c in range(3):
        state_out[c] = position[c]
    for c in range(4):
        state_out[3 + c] = rotation[c]
    state_out[7] = travel


@wp.func
def write_contact(report_out: wp.array(dtype=wp.float64), force: wp.vec3d, moment: wp.vec3d, centre: wp.vec3d):
    """Write what the contacts push, and where."""
    for c in range(3):
        report_out[5 + c] = force[c]
        report_out[8 + c] = moment[c]
        report_out[11 + c] = centre[c]


@wp.kernel
def advance_proxy(
    # things and tool
    field: Field,
    shell: Shell,
    contacts: Contacts,
    # numbers
    compliance: wp.float64,  # 1 / l^2 [1/m2], 0 for a tool that does not turn
    friction: wp.float64,
    step: wp.float64,  # [m]
    tolerance: wp.float64,  # [m]
    step_limit: int,
    solve_limit: int,
    # device
    goal: wp.array(dtype=wp.float64),  # position xyz [m], quaternion xyzw
    # out
    state_out: wp.array(dtype=wp.float64),
    report_out: wp.array(dtype=wp.float64),
):
    """Bring the proxy toward the goal; it ends at the last pose that was found to be free."""
    target = wp.vec3d(goal[0], goal[1], goal[2])
    target_turn = wp.quatd(goal[3], goal[4], goal[5], goal[6])
    good = wp.vec3d(state_out[0], state_out[1], state_out[2])
    good_turn = wp.quatd(state_out[3], state_out[4], state_out[5], state_out[6])
    travel = state_out[7]
    position = good
    rotation = good_turn
    shift = wp.vec3d()
    turn = wp.vec3d()
    force = wp.vec3d()
    moment = wp.vec3d()
    centre = wp.vec3d()
    rub = wp.vec3d()
    arm = wp.vec3d()
    best = wp.float64(1.0e300)
    least = wp.float64(0.0)
    deepest = wp.float64(-1.0e30)
    steps = int(0)
    solves = int(0)
    halvings = int(0)
    stalls = int(0)
    pressing = int(report_out[1])
    arrived = int(0)
    converged = int(0)
    near = tolerance
    reach = shell.reach
    if compliance == ZERO:
        reach = ZERO
    while steps < step_limit:
        steps += 1
        wanted = ZERO  # beside something every step is short, so that no point needs to wake for a long one
        if pressing == 0:
            wanted = pose_distance(position, rotation, target, target_turn, reach)
        frame = wp.quat_to_matrix(rotation)
        count, gap, clear = collect(field, shell, contacts, position, frame, travel, wanted, step)
        if gap < deepest:
            if halvings == HALVINGS:
                break
            halvings += 1
            arrived = int(0)
            shift = HALF * shift
            turn = HALF * turn
            travel += wp.length(shift) + shell.reach * wp.length(turn)
            position = good + shift
            rotation = turned_by(turn, good_turn)
            continue
        halvings = int(0)
        good = position
        good_turn = rotation
        least = gap
        deepest = wp.min(gap, -TOO_DEEP * step)
        if solves >= solve_limit:
            break
        if arrived == 1 and gap >= -tolerance:
            converged = int(1)
            break
        arrived = int(0)
        shift = target - position
        stored = wp.length_sq(shift)
        if compliance > ZERO:
            turn = turn_between(rotation, target_turn)
            stored += wp.length_sq(turn) / compliance
        stalls += 1
        if stored < (ONE - LITTLE) * best or field.spacing == ZERO:
            stalls = int(0)
            best = wp.min(best, stored)
        if stalls == STALLS:
            converged = int(1)
            break
        touch = wp.float64(2.0)
        if friction > ZERO and pressing == 0 and gap > tolerance:
            touch = first_touch(contacts, count, shift, turn)
        if touch < ONE:  # friction begins where something is met, so the tool first goes there
            shift *= touch
            turn *= touch
        else:
            members, used, rub, arm = resolve(
                contacts, count, compliance, friction, tolerance, shift, turn, rub, arm, near
            )
            solves += used
            pressing, force, moment, centre = contact_sums(contacts, members)
            force += rub
            moment += wp.cross(arm, rub)
            shift += force
            turn += compliance * moment
        size = wp.length(shift) + shell.reach * wp.length(turn)
        if touch >= ONE and near == tolerance and (size == ZERO or (size <= tolerance and pressing > 0)):
            converged = int(1)
            break
        near = tolerance
        if size > TWO * clear:
            near = step  # the next step finds another friction
        if size > clear:
            shift *= clear / size
            turn *= clear / size
        elif pressing == 0 and touch >= ONE:
            arrived = int(1)
        travel += wp.min(size, clear)
        position = good + shift
        rotation = turned_by(turn, good_turn)
        if arrived == 1:
            position = target
            if compliance > ZERO:
                rotation = target_turn
    write_pose(state_out, good, good_turn, travel)
    write_contact(report_out, force, moment, centre)
    report_out[0] = wp.float64(converged)
    report_out[1] = wp.float64(pressing)
    report_out[2] = wp.float64(steps)
    report_out[3] = wp.float64(solves)
    report_out[4] = least
