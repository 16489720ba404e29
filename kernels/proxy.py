"""Motion of a proxy in one tick (1 ms). A proxy is a copy of the tool that avoids obstacles.

The proxy is rigid, and follows the haptic device as closely as obstacles allow. From its last pose,
the proxy moves in steps towards the pose of the device. The steps reduce the energy of the springs
between proxy and device. The length of a step is at most the distance that is certainly free of
obstacles. Near an obstacle, a step is at most half a voxel long. Contact forces are computed in
every step. A step that ends too deep in an obstacle is undone, and repeated with half the length.
The proxy therefore stays on its side of an obstacle, even if the device passes through the obstacle
at any speed. Sources: Zilles and Salisbury 1995, IROS; Ruspini, Kolarov and Khatib 1997, SIGGRAPH.
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

wp.set_module_options({"max_unroll": 1})

POSITION, ROTATION, TRAVEL, STATE = 0, 3, 7, 8
"""Indices into the proxy's state array, and number of entries of this array (`STATE`).

The entries are: position x, y, z [m], quaternion x, y, z, w, and path length since the proxy was
placed [m].
"""
CONVERGED, PRESSING, STEPS, SOLVES, FORCE, MOMENT, CENTRE, REPORT = 0, 1, 2, 3, 4, 7, 10, 13
"""Indices into the array of results of a tick, and number of entries of this array (`REPORT`).

The first entries are: a flag (1 if the proxy converged), the number of contacts with force, the
number of steps, and the number of linear systems solved. Then follow force / coupling stiffness
[m], moment / coupling stiffness [m2] and centre of pressure [m], with three entries each. The
centre of pressure is relative to the tool's origin, in world axes.
"""
HALVINGS = 8
"""Largest number of halvings of a step. If more are needed, the proxy stops until the next tick.

Eight halvings reduce a step of half a voxel to 0.002 voxels.
"""


@wp.func
def position_in(pose: Doubles):
    """Return the position [m] in the state of a proxy or in a goal pose."""
    return wp.vec3d(pose[POSITION], pose[POSITION + 1], pose[POSITION + 2])


@wp.func
def rotation_in(pose: Doubles):
    """Return the rotation in the state of a proxy or in a goal pose."""
    return wp.quatd(pose[ROTATION], pose[ROTATION + 1], pose[ROTATION + 2], pose[ROTATION + 3])


@wp.func
def begin_descent(state: Doubles, tolerance: wp.float64):
    """Return a new `Descent` (progress of the motion) that starts at the last tick's pose."""
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
    """Write the last obstacle-free pose and the path length of a `Descent` to the proxy's state."""
    for c in range(3):
        state_out[POSITION + c] = descent.position[c]
    for c in range(4):
        state_out[ROTATION + c] = descent.rotation[c]
    state_out[TRAVEL] = descent.travel


@wp.func
def write_reaction(reaction: Reaction, report_out: Doubles):
    """Write the sum of the contact forces and the centre of pressure to the results of the tick."""
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
    """Move the proxy in steps toward the goal pose.

    The last pose that was found free of obstacles is written to the state.
    """
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
