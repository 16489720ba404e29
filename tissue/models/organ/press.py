"""Press of a tool on a soft organ: a straight motion from the first touch, then a hold."""

from dataclasses import dataclass
from math import ceil

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from tissue.fem.fields import Frame
from tissue.models.organ.contact import SurfaceContact, contact_points
from tissue.models.organ.model import ContactSolution, OrganModel
from tissue.models.organ.probe import ProbeShape, ShellProbe
from tissue.models.organ.soft_organ import SoftOrgan, ToolPath, linear_triangles
from tissue.models.tissue_model import ToolMotion

STEPS = 100
"""Smallest number of steps from the first touch to the final depth.

Every step gives one row of `PressCurve`. Even with friction, 10 or 400 steps change the force of a
slanted press by only 0.01 %.
"""
TOLERANCE = 1e-5
SWEEPS = 5000
"""Largest number of sweeps of the contact solver; a press need not run in real time.

With this limit, the error of the stress in a rod under a flat punch is below 1 %.
"""
PER_RELAXATION = 5
"""Smallest number of steps within the shortest relaxation time of an organ; chosen."""
LAW_STEPS = 25
"""Number of steps of a press under a hyperelastic law."""
SOLVES = 3
LAST_SOLVES = 20
"""Largest number of times that contact and law are solved in the last step of a press.

In the earlier steps, the limit is `SOLVES`.
"""
UNSETTLED = 0.01
"""Relative change of the force in the last solution, above which a notice is reported."""
POSES = 60
"""Number of poses along the press at which surface nodes near the tool are searched for.

The force of a slanted press is the same for 5 to 240 poses, because only the last poses matter.
"""
CLEARANCES = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 4.0)
"""Start distances of the tool from the target, divided by the tool's radius.

The first distance at which the tool does not touch the organ is used.
"""
SLANTED = 0.5
"""Largest distance from the first touch to the target, divided by the tool's radius.

The distance is 0.41 for a ball that approaches at 45 degrees.
"""
HALVINGS = 30
"""Number of halvings of the path in the search for the first touch; the error is then 1 nm."""


@dataclass(frozen=True, eq=False)
class PressCurve:
    """Result of a press. The arrays have one row for each step from the first touch.

    Attributes
    ----------
    time_s
        Time since the first touch [s], shape (n,).
    depth_m
        Travel of the tool since the first touch [m], shape (n,).
    force_N
        Force on the tool [N], shape (n, 3).
    area_m2
        Area of the contact [m2], shape (n,).
    tip_m, rotation
        Pose of the tool at the end: its tip [m], shape (3,), and its rotation from tool to world,
        shape (3, 3).
    frame
        Displacement and stress of the organ at the end.
    notices
        Events, one sentence each.
    """

    time_s: Array
    depth_m: Array
    force_N: Array
    area_m2: Array
    tip_m: Array
    rotation: Array
    frame: Frame
    notices: tuple[str, ...]


def press(
    organ: SoftOrgan,
    probe: ProbeShape,
    point_m: Array,
    rotation: Array,
    *,
    depth_m: float,
    speed_m_s: float,
    hold_s: float,
    report: Progress = silent,
) -> PressCurve:
    """Press a tool along its axis towards a point on an organ's surface, then hold the tool.

    Parameters
    ----------
    organ, probe
        The organ, and the tool.
    point_m
        Target of the tool's tip on the surface [m], shape (3,).
    rotation
        Rotation from tool to world, shape (3, 3). The tool moves along its negative z axis.
    depth_m
        Travel of the tool after its first touch [m].
    speed_m_s, hold_s
        Speed of the tool [m/s] and duration of the hold [s]. Both matter only for an organ that
        relaxes.
    report
        Function that is called with the name of the present task and its completed share (0 to 1).

    Raises
    ------
    InputError
        If the organ blocks the path of the tool to the target, or if the target lies on a support.
    """
    along = -rotation[:, 2]
    start_m = point_m - _clearance_m(organ, probe, point_m, rotation) * along
    end_m = point_m + depth_m * along
    tips = start_m + np.linspace(0.0, 1.0, POSES)[:, None] * (end_m - start_m)
    steps = STEPS if organ.law is None else LAW_STEPS
    if organ.prony is not None:
        relaxations = depth_m / speed_m_s / min(organ.prony.tau_s)
        steps = max(steps, ceil(PER_RELAXATION * relaxations))
    step_s = depth_m / speed_m_s / steps
    turns = np.broadcast_to(rotation, (POSES, 3, 3))
    model = OrganModel(
        organ,
        ToolPath(probe, tips, turns),
        ContactSolution(tolerance=TOLERANCE, sweeps=SWEEPS),
        # Any finite interval: the single frame is stored at the end.
        interval_s=1.0,
        step_s=step_s,
        report=report,
    )
    touch_m = _first_touch(model.contact, start_m, end_m, rotation)
    before_m = float((point_m - touch_m) @ along)
    if before_m > SLANTED * probe.size_m[0]:
        raise InputError(
            "point_m",
            "be the first point that the tool touches",
            f"a tool that touches the organ {1e3 * before_m:.3g} mm before this point",
            "approach along another direction, or use a smaller tool",
        )
    motion = ToolMotion(tip_m=start_m.copy(), rotation=rotation.copy())
    model.place(motion)
    depths = np.append(
        np.linspace(0.0, depth_m, steps + 1), np.full(ceil(hold_s / step_s), depth_m)
    )
    force = np.zeros((len(depths), 3))
    area = np.zeros(len(depths))
    last = len(depths) - 1
    for row, depth in enumerate(depths):
        report("pressing", row / len(depths))
        motion.tip_m[:] = touch_m + depth * along
        model.advance(motion)
        changed = model.converge(motion, limit=LAST_SOLVES if row == last else SOLVES)
        response = model.respond(motion)
        force[row] = response.wrench[:3]
        area[row] = response.engaged_m2.sum()
    times = (step_s * np.arange(len(depths))).astype(np.float64)
    model.start_background(float(times[-1]), motion)
    model.finish()
    if changed > UNSETTLED:
        model.notices.append(
            f"the force at the end still changes by {changed:.0%} from one solve of the law to the "
            "next: press less deep or refine the mesh"
        )
    return PressCurve(
        times,
        depths,
        force,
        area,
        motion.tip_m,
        rotation,
        model.fields.frames[-1],
        tuple(model.notices),
    )


def surface_points_m(organ: SoftOrgan, probe: ProbeShape) -> Array:
    """Return points [m], shape (n, 3), on the part of an organ's surface that a tool may touch."""
    nodes = organ.space.nodes_m + organ.rest[1]
    triangles = linear_triangles(organ.space.faces)
    # A shell has its own contact points, so no points on the organ are needed.
    if isinstance(probe, ShellProbe):
        return nodes[np.unique(triangles)]
    places, weights, _ = contact_points(nodes, triangles, probe.spacing_m)
    return np.einsum("pk,pkx->px", weights, nodes[triangles[places]])


def _clearance_m(organ: SoftOrgan, probe: ProbeShape, point_m: Array, rotation: Array) -> float:
    """Return a distance from the target at which the tool does not touch the organ [m]."""
    points = surface_points_m(organ, probe)
    for share in CLEARANCES:
        clear = share * probe.size_m[0]
        if probe.distance((points - point_m - clear * rotation[:, 2]) @ rotation).min() > 0.0:
            return clear
    raise InputError(
        "point_m",
        "have a free path in front of it",
        f"a tool that touches the organ elsewhere {1e3 * clear:.3g} mm before this point",
        "approach along another direction, or use a smaller tool",
    )


def _first_touch(contact: SurfaceContact, start_m: Array, end_m: Array, rotation: Array) -> Array:
    """Return the tip position at the first touch [m], shape (3,).

    At this position the tool does not touch the organ yet. The contact begins at most 1 nm farther
    along the path.
    """

    def touches(share: float) -> bool:
        contact.forget()
        return contact.solve(start_m + share * (end_m - start_m), rotation).contacts > 0

    before = 0.0
    after = 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (before + after)
        before, after = (before, middle) if touches(middle) else (middle, after)
    contact.forget()
    return start_m + before * (end_m - start_m)
