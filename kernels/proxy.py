"""One tick of a proxy, a copy of the tool that follows the device as closely as obstacles allow.

The proxy is rigid. From its last pose, the proxy moves in steps towards the pose of the device. The
steps reduce the energy of the springs between proxy and device (a descent). The length of a step is
at most the distance that is certainly free of obstacles. Near an obstacle, the length is at most
half a voxel. In every step, the contact forces are computed. A step that ends too deep in an
obstacle is undone and halved. The proxy therefore stays on its side of an obstacle, even if the
device passes through the obstacle at any speed. Sources: Zilles and Salisbury 1995, IROS; Ruspini,
Kolarov and Khatib 1997, SIGGRAPH.
"""

import warp as wp

from kernels.arrays import Doubles
from kernels.constants import ZERO
from kernels.proxy_contacts import Contacts, Shell, collect
from kernels.proxy_descent import (
    AT_REST,
    GOES_ON,
    Descent,
    DescentSettings,
    Reaction,
    accept_trial,
    halve_motion,
    pose_distance,
    take_step,
)
from kernels.voxmap import Field

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

POSITION, ROTATION, TRAVEL, STATE = 0, 3, 7, 8
"""Indices into the state of the proxy, and number of its entries (`STATE`).

The entries are: position x, y, z [m], quaternion x, y, z, w, and path length since the proxy was
placed [m].
"""
CONVERGED, PRESSING, STEPS, SOLVES, FORCE, MOMENT, CENTRE, REPORT = 0, 1, 2, 3, 4, 7, 10, 13
"""Indices into the report of a tick, and number of its entries (`REPORT`).

The first entries are: 1 if converged, number of contacts with force, number of steps, and number of
linear systems solved. Force / stiffness [m], moment / stiffness [m2], and the centre of pressure
[m] follow, with three entries each. The centre of pressure is relative to the tool's origin, in
world axes.
"""
HALVINGS = 8
"""Largest number of times that a step is halved. After that, the proxy stops in this tick.

This number of halvings reduces a step of half a voxel to 0.002 voxels.
"""


@wp.func
def position_in(pose: Doubles):
    """Return the position [m] from the state of a proxy or from a goal pose."""
    return wp.vec3d(pose[POSITION], pose[POSITION + 1], pose[POSITION + 2])


@wp.func
def rotation_in(pose: Doubles):
    """Return the rotation from the state of a proxy or from a goal pose."""
    return wp.quatd(pose[ROTATION], pose[ROTATION + 1], pose[ROTATION + 2], pose[ROTATION + 3])


@wp.func
def begin_descent(state: Doubles, tolerance: wp.float64):
    """Return a new `Descent`, whose trial pose is the pose of the last tick."""
    descent = Descent()
    descent.position = position_in(state)
    descent.rotation = rotation_in(state)
    descent.trial_position = descent.position
    descent.trial_rotation = descent.rotation
    descent.travel = state[TRAVEL]
    # The first pose counts as free for any gap. The lowest energy so far is infinite.
    descent.deepest = wp.float64(-1.0e30)
    descent.lowest = wp.float64(1.0e300)
    descent.near = tolerance
    return descent


@wp.func
def write_state(descent: Descent, state_out: Doubles):
    """Write the last free pose and the path length of a `Descent` to the state."""
    for c in range(3):
        state_out[POSITION + c] = descent.position[c]
    for c in range(4):
        state_out[ROTATION + c] = descent.rotation[c]
    state_out[TRAVEL] = descent.travel


@wp.func
def write_reaction(reaction: Reaction, report_out: Doubles):
    """Write the sum of the contact forces and the centre of pressure to the report."""
    report_out[PRESSING] = wp.float64(reaction.pressing)
    for c in range(3):
        report_out[FORCE + c] = reaction.force[c]
        report_out[MOMENT + c] = reaction.moment[c]
        report_out[CENTRE + c] = reaction.centre[c]


@wp.kernel
def advance_proxy(
    # things and tool
    field: Field,
    shell: Shell,
    settings: DescentSettings,
    # device
    goal: Doubles,  # position xyz [m], quaternion xyzw
    # in and out
    contacts_out: Contacts,
    state_out: Doubles,
    report_out: Doubles,
):
    """Move the proxy in steps toward the goal, up to the last free pose that is found."""
    goal_position = position_in(goal)
    goal_rotation = rotation_in(goal)
    descent = begin_descent(state_out, settings.tolerance)
    reaction = Reaction()
    reaction.pressing = int(report_out[PRESSING])
    turning = shell.reach
    # If the tool does not turn, its rotation may differ from the rotation of the device.
    if settings.compliance == ZERO:
        turning = ZERO
    steps = int(0)
    ended = int(GOES_ON)
    while steps < settings.step_limit and ended == GOES_ON:
        steps += 1
        # Near an obstacle every step is short, so no point is checked for a long step.
        wanted = ZERO
        if reaction.pressing == 0:
            wanted = pose_distance(
                descent.trial_position,
                descent.trial_rotation,
                goal_position,
                goal_rotation,
                turning,
            )
        frame = wp.quat_to_matrix(descent.trial_rotation)
        count, gap, clear = collect(
            field,
            shell,
            contacts_out,
            descent.trial_position,
            frame,
            descent.travel,
            wanted,
            settings.step,
        )
        if gap < descent.deepest:
            if descent.halvings == HALVINGS:
                break
            descent = halve_motion(descent, shell.reach)
        else:
            descent = accept_trial(descent, gap, settings.step)
            descent, reaction, ended = take_step(
                descent,
                reaction,
                contacts_out,
                count,
                settings,
                goal_position,
                goal_rotation,
                gap,
                clear,
                field.spacing,
                shell.reach,
            )
    write_state(descent, state_out)
    write_reaction(reaction, report_out)
    report_out[CONVERGED] = wp.float64(ended == AT_REST)
    report_out[STEPS] = wp.float64(steps)
    report_out[SOLVES] = wp.float64(descent.solves)
