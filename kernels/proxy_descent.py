"""Steps of a proxy's descent toward its device.

A step is a motion that the contacts allow, and may be shortened or taken back.

A trial pose is one motion away from the last pose that was found to be free.

Rigid motions: rotations as unit quaternions, and the path lengths of points.
"""

import warp as wp

from kernels.proxy_contacts import ZERO, Contacts
from kernels.proxy_forces import resolve

__all__ = [
    "AT_REST",
    "GOES_ON",
    "Descent",
    "DescentSettings",
    "Reaction",
    "accept_trial",
    "halve_motion",
    "motion_length",
    "pose_distance",
    "take_step",
    "turn_between",
    "turned_by",
]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

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
    # Both quaternions are the same rotation; this one is the shorter turn.
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


GOES_ON, AT_REST, OUT_OF_SOLVES = 0, 1, 2
"""End states of a step."""
STALLS = 2
"""Number of steps in a row that hardly lower the springs' energy before the proxy may rest.

Near voxels the proxy swings over creases.
"""
LITTLE = wp.constant(wp.float64(1.0e-4))
"""Share of the springs' energy that a step near voxels must remove at least."""
TOO_DEEP = wp.constant(wp.float64(0.1))
"""Share of a step's length that a point may sink in before the step is taken back."""
ONE = wp.constant(wp.float64(1.0))
HALF = wp.constant(wp.float64(0.5))
TWO = wp.constant(wp.float64(2.0))


@wp.struct
class DescentSettings:
    """Springs, friction and limits of a tick's descent."""

    compliance: wp.float64  # 1 / l^2 [1/m2], 0 for a tool that does not turn
    friction: wp.float64
    step: wp.float64  # longest step near something [m]
    tolerance: wp.float64  # step below which the proxy has settled [m]
    step_limit: int
    solve_limit: int


@wp.struct
class Descent:
    """Progress of a tick's descent."""

    position: wp.vec3d  # the last pose found to be free [m]
    rotation: wp.quatd
    shift: wp.vec3d  # motion from there to the trial pose [m]
    turn: wp.vec3d  # [rad]
    trial_position: wp.vec3d  # [m]
    trial_rotation: wp.quatd
    arrived: int  # 1 where the trial pose is the goal
    travel: wp.float64  # largest path length of a point since the proxy was placed [m]
    deepest: wp.float64  # gap below which the trial is taken back [m]
    lowest: wp.float64  # smallest energy of the springs so far, over half their stiffness [m2]
    near: wp.float64  # change of the friction force at which it is found [m]
    halvings: int
    stalls: int
    solves: int


@wp.struct
class Reaction:
    """Contacts of the tool in sum, over the coupling's stiffness."""

    pressing: int
    force: wp.vec3d  # with friction [m]
    moment: wp.vec3d  # about the tool's origin [m2]
    centre: wp.vec3d  # of pressure, from the tool's origin in the world's axes [m]
    rub: wp.vec3d  # friction alone [m]
    arm: wp.vec3d  # where it acts, from the tool's origin [m]


@wp.func
def first_touch(contacts: Contacts, count: int, shift: wp.vec3d, turn: wp.vec3d):
    """Return the share of a motion until the first plane is touched, or 2 if no plane is."""
    share = wp.float64(2.0)
    for c in range(count):
        closing = -wp.dot(contacts.normal[c], shift) - wp.dot(contacts.moment[c], turn)
        if closing > contacts.gap[c]:
            share = wp.min(share, contacts.gap[c] / closing)
    return share


@wp.func
def contact_sums(contacts: Contacts, members: int):
    """Sum the contacts of the set.

    Return the number of members that press, the sums of their normal forces [m] and moments [m2],
    and their centre of pressure [m].
    """
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
def halve_motion(before: Descent, reach: wp.float64):
    """Return a descent whose trial pose is half as far from the last free pose."""
    descent = before
    descent.halvings = before.halvings + 1
    descent.arrived = 0
    descent.shift = HALF * before.shift
    descent.turn = HALF * before.turn
    descent.travel = before.travel + motion_length(descent.shift, descent.turn, reach)
    descent.trial_position = before.position + descent.shift
    descent.trial_rotation = turned_by(descent.turn, before.rotation)
    return descent


@wp.func
def accept_trial(before: Descent, gap: wp.float64, step: wp.float64):
    """Return a descent whose trial pose was found to be free, with this smallest gap [m]."""
    descent = before
    descent.halvings = 0
    descent.position = before.trial_position
    descent.rotation = before.trial_rotation
    descent.deepest = wp.min(gap, -TOO_DEEP * step)
    return descent


@wp.func
def aim_at(
    before: Descent,
    goal_position: wp.vec3d,
    goal_rotation: wp.quatd,
    compliance: wp.float64,
    spacing: wp.float64,
):
    """Return a descent with the motion that the springs want.

    It counts one more stall if the springs' energy has hardly fallen.

    Near exact solids, where the ``spacing`` of voxels is 0, no step counts as a stall.
    """
    descent = before
    descent.arrived = 0
    descent.shift = goal_position - before.position
    energy = wp.length_sq(descent.shift)
    if compliance > ZERO:
        descent.turn = turn_between(before.rotation, goal_rotation)
        energy += wp.length_sq(descent.turn) / compliance
    descent.stalls = before.stalls + 1
    if energy < (ONE - LITTLE) * before.lowest or spacing == ZERO:
        descent.stalls = 0
        descent.lowest = wp.min(before.lowest, energy)
    return descent


@wp.func
def react(
    contacts: Contacts, count: int, settings: DescentSettings, descent: Descent, last: Reaction
):
    """Compute contact forces on the wanted motion, over the stiffness, and the number of solves."""
    reaction = Reaction()
    compliance = settings.compliance
    members, solves, rub, arm = resolve(
        contacts,
        count,
        compliance,
        settings.friction,
        settings.tolerance,
        descent.shift,
        descent.turn,
        last.rub,
        last.arm,
        descent.near,
    )
    pressing, force, moment, centre = contact_sums(contacts, members)
    reaction.pressing = pressing
    reaction.force = force + rub
    reaction.moment = moment + wp.cross(arm, rub)
    reaction.centre = centre
    reaction.rub = rub
    reaction.arm = arm
    return reaction, solves


@wp.func
def constrain_motion(
    before: Descent,
    last: Reaction,
    contacts: Contacts,
    count: int,
    settings: DescentSettings,
    gap: wp.float64,
):
    """Return a descent with a motion that the contacts allow, their reaction, and a solved flag.

    The flag is 1 where the contacts were solved. Friction begins at the first contact, so the tool
    first moves there and no contact is solved.
    """
    descent = before
    if settings.friction > ZERO and last.pressing == 0 and gap > settings.tolerance:
        touch = first_touch(contacts, count, before.shift, before.turn)
        if touch < ONE:
            descent.shift = before.shift * touch
            descent.turn = before.turn * touch
            return descent, last, 0
    reaction, solves = react(contacts, count, settings, before, last)
    descent.solves = before.solves + solves
    descent.shift = before.shift + reaction.force
    descent.turn = before.turn + settings.compliance * reaction.moment
    return descent, reaction, 1


@wp.func
def next_trial(before: Descent, settings: DescentSettings, size: wp.float64, clear: wp.float64):
    """Return a descent and its trial pose.

    The motion of ``size`` is shortened to the ``clear`` path length [m].
    """
    descent = before
    descent.near = settings.tolerance
    if size > TWO * clear:
        descent.near = settings.step  # the next step finds another friction
    if size > clear:
        descent.shift = before.shift * (clear / size)
        descent.turn = before.turn * (clear / size)
    descent.travel = before.travel + wp.min(size, clear)
    descent.trial_position = before.position + descent.shift
    descent.trial_rotation = turned_by(descent.turn, before.rotation)
    return descent


@wp.func
def take_step(
    before: Descent,
    last: Reaction,
    contacts: Contacts,
    count: int,
    settings: DescentSettings,
    goal_position: wp.vec3d,
    goal_rotation: wp.quatd,
    gap: wp.float64,
    clear: wp.float64,
    spacing: wp.float64,
    reach: wp.float64,
):
    """Take one step from a free pose.

    Return the descent and reaction after it, and whether and how it ends here.
    """
    if before.solves >= settings.solve_limit:
        return before, last, OUT_OF_SOLVES
    # The goal itself is free.
    if before.arrived == 1 and gap >= -settings.tolerance:
        return before, last, AT_REST
    aimed = aim_at(before, goal_position, goal_rotation, settings.compliance, spacing)
    if aimed.stalls == STALLS:
        return aimed, last, AT_REST
    descent, reaction, solved = constrain_motion(aimed, last, contacts, count, settings, gap)
    size = motion_length(descent.shift, descent.turn, reach)
    small = size == ZERO or (size <= settings.tolerance and reaction.pressing > 0)
    if solved == 1 and small and descent.near == settings.tolerance:
        return descent, reaction, AT_REST
    trial = next_trial(descent, settings, size, clear)
    if solved == 1 and reaction.pressing == 0 and size <= clear:
        trial.arrived = 1
        trial.trial_position = goal_position
        if settings.compliance > ZERO:
            trial.trial_rotation = goal_rotation
    return trial, reaction, GOES_ON
