"""Steps of a proxy, which is a copy of the tool, toward the pose of the haptic device.

Each step reduces the energy of the springs between proxy and device. A step is a motion that the
contacts allow. It may be shortened or undone.

A pose is free if no point of the tool lies too deep in an obstacle. A trial pose is the pose at the
end of a step from the last free pose.

Rotations are unit quaternions. Path lengths are upper bounds for all points of the tool.
"""

import warp as wp

from kernels.constants import HALF, ONE, TWO, ZERO
from kernels.proxy_contacts import Contacts
from kernels.proxy_forces import resolve

wp.set_module_options({"max_unroll": 1})

SMALL = wp.float64(1.0e-8)
"""Angle [rad], or sine, below which a ratio of sines is replaced by its limit for angle 0."""


@wp.func
def turned_by(turn: wp.vec3d, rotation: wp.quatd):
    """Return ``rotation``, followed by the rotation with the rotation vector ``turn`` [rad]."""
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
    # The quaternions q and -q are the same rotation. Choose the one with the shorter turn.
    if cosine < ZERO:
        imaginary = -imaginary
        cosine = -cosine
    sine = wp.length(imaginary)
    share = wp.float64(2.0)
    if sine > SMALL:
        share = TWO * wp.atan2(sine, cosine) / sine
    return share * imaginary


@wp.func
def motion_length(shift: wp.vec3d, turn: wp.vec3d, reach: wp.float64):
    """Return an upper bound [m] of the path length of any point of the tool during a motion.

    All points of the tool lie within ``reach`` [m] of its origin.
    """
    return wp.length(shift) + reach * wp.length(turn)


@wp.func
def pose_distance(
    position: wp.vec3d,
    rotation: wp.quatd,
    goal_position: wp.vec3d,
    goal: wp.quatd,
    reach: wp.float64,
):
    """Return an upper bound [m] of the path that any point of the tool travels to a goal pose.

    All points of the tool lie within ``reach`` [m] of its origin.

    If ``reach`` is 0, rotations are ignored.
    """
    length = wp.length(goal_position - position)
    if reach > ZERO:
        length += reach * wp.length(turn_between(rotation, goal))
    return length


GOES_ON, AT_REST, OUT_OF_SOLVES = 0, 1, 2
"""End states of a step: more steps follow, proxy at rest, too many linear systems solved."""
STALLS = 2
"""Number of consecutive stalls after which the proxy may rest.

A stall is a step that hardly decreases the energy of the springs between proxy and device. Stalls
occur near voxels, where the proxy may oscillate across creases of the bone surface.
"""
LITTLE = wp.float64(1.0e-4)
"""Relative decrease of the spring energy below which a step near voxels counts as a stall."""
TOO_DEEP = wp.float64(0.1)
"""Penetration of a tool point, relative to the step length, above which the step is undone."""


@wp.struct
class DescentSettings:
    """Springs, friction and limits of the proxy's motion in a tick."""

    compliance: wp.float64  # 1 / l^2 [1/m2], 0 for a tool that does not turn
    friction: wp.float64
    step: wp.float64  # longest step near an obstacle [m]
    tolerance: wp.float64  # step below which the proxy has settled [m]
    step_limit: int
    solve_limit: int


@wp.struct
class Descent:
    """Progress of the proxy toward the device pose in a tick: poses, motion and counters."""

    position: wp.vec3d  # last free pose that was found [m]
    rotation: wp.quatd
    shift: wp.vec3d  # motion from the last free pose to the trial pose [m]
    turn: wp.vec3d  # [rad]
    trial_position: wp.vec3d  # [m]
    trial_rotation: wp.quatd
    arrived: int  # 1 if the trial pose is the goal
    travel: wp.float64  # largest path length of a point since the proxy was placed [m]
    deepest: wp.float64  # gap below which the trial is undone [m]
    lowest: wp.float64  # smallest spring energy so far / half the stiffness [m2]
    near: wp.float64  # change at which the friction force counts as found [m]
    halvings: int
    stalls: int
    solves: int


@wp.struct
class Reaction:
    """Resultant of the contact forces on the tool, divided by the coupling spring's stiffness."""

    pressing: int
    force: wp.vec3d  # with friction [m]
    moment: wp.vec3d  # about the tool's origin [m2]
    centre: wp.vec3d  # centre of pressure, from the tool's origin in world axes [m]
    tangential_force: wp.vec3d  # friction alone [m]
    arm: wp.vec3d  # point of action of the friction, from the tool's origin [m]


@wp.func
def first_touch(contacts: Contacts, count: int, shift: wp.vec3d, turn: wp.vec3d):
    """Return the fraction of a motion after which the first contact plane is touched.

    The result is 2 if no plane is touched.
    """
    share = wp.float64(2.0)
    for c in range(count):
        closing = -wp.dot(contacts.normal[c], shift) - wp.dot(contacts.moment[c], turn)
        if closing > contacts.gap[c]:
            share = wp.min(share, contacts.gap[c] / closing)
    return share


@wp.func
def reaction_of(contacts: Contacts, members: int, tangential_force: wp.vec3d, arm: wp.vec3d):
    """Return the resultant of normal and tangential (friction) forces of the active set.

    The active set consists of the planes with force. The tangential force acts at ``arm``.
    """
    pressing = int(0)
    force = wp.vec3d()
    moment = wp.vec3d()
    centre = wp.vec3d()
    total = wp.float64(0.0)
    for m in range(members):
        c = contacts.member[m]
        normal_force = contacts.normal_force[contacts.slot[c]]
        if normal_force > ZERO:
            pressing += 1
            force += normal_force * contacts.normal[c]
            moment += normal_force * contacts.moment[c]
            centre += normal_force * contacts.arm[c]
            total += normal_force
    if total > ZERO:
        centre /= total
    reaction = Reaction()
    reaction.pressing = pressing
    reaction.force = force + tangential_force
    reaction.moment = moment + wp.cross(arm, tangential_force)
    reaction.centre = centre
    reaction.tangential_force = tangential_force
    reaction.arm = arm
    return reaction


@wp.func
def halve_motion(before: Descent, reach: wp.float64):
    """Return a copy of a `Descent` (progress of the proxy) in which the trial motion is halved."""
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
    """Return a copy of a `Descent` in which the trial pose is the last obstacle-free pose.

    ``gap`` is the smallest gap [m] at the trial pose.
    """
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
    """Return a copy of a `Descent` whose motion leads from the last free pose to the goal.

    The goal is the pose at which the spring force is zero.

    If the spring energy is not clearly below the lowest energy so far, the number of stalls is
    increased by one. Otherwise, the number of stalls is reset to 0.

    If the obstacles have no voxels, ``spacing`` is 0 and no step counts as a stall.
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
def constrain_motion(
    before: Descent,
    last: Reaction,
    contacts: Contacts,
    count: int,
    settings: DescentSettings,
    gap: wp.float64,
):
    """Change the motion of a `Descent` such that it does not violate the contacts.

    If there is friction and the tool has no contact yet, the motion ends at the first contact
    plane, because friction starts there. Contact forces are not computed in this case. Return a
    changed copy of the `Descent`, the contact forces, and a flag that is 1 if contact forces were
    computed.
    """
    descent = before
    if settings.friction > ZERO and last.pressing == 0 and gap > settings.tolerance:
        touch = first_touch(contacts, count, before.shift, before.turn)
        if touch < ONE:
            descent.shift = before.shift * touch
            descent.turn = before.turn * touch
            return descent, last, 0
    members, solves, tangential_force, arm = resolve(
        contacts,
        count,
        settings.compliance,
        settings.friction,
        settings.tolerance,
        before.shift,
        before.turn,
        last.tangential_force,
        last.arm,
        before.near,
    )
    reaction = reaction_of(contacts, members, tangential_force, arm)
    descent.solves = before.solves + solves
    descent.shift = before.shift + reaction.force
    descent.turn = before.turn + settings.compliance * reaction.moment
    return descent, reaction, 1


@wp.func
def next_trial(before: Descent, settings: DescentSettings, size: wp.float64, clear: wp.float64):
    """Return a copy of a `Descent` whose trial pose is the end of the motion.

    ``size`` is the length of the motion [m]. If ``size`` exceeds the free path length ``clear``
    [m], the motion is shortened to ``clear``.
    """
    descent = before
    descent.near = settings.tolerance
    if size > TWO * clear:
        descent.near = settings.step  # the friction changes in the next step
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
    """Take one step of the proxy from a pose that is free of obstacles.

    Return the new `Descent`, the contact forces, and the end state of the step.
    """
    if before.solves >= settings.solve_limit:
        return before, last, OUT_OF_SOLVES
    # The goal is free and has been reached.
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
