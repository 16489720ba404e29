"""State and functions shared by the contact kernels.

The state consists of a body's surface, the contact points on the surface, and lists of triangles.
The results of a tick are stored in one array, whose indices this module defines. The functions
compute the distance of a point from a tool, and the contact force at one point with Coulomb
friction.

Distance: the functions return the signed distance of a point from the tool, and the gradient of
this distance. The tip of a tool is its lowest point, and the tool's z axis runs from the tip to the
shank. The surface of a sphere passes through the tip. A cylinder has a flat lower face through the
tip, a rounded edge, and no upper end. A shell consists of points on the tool's surface. Each shell
point has a plane that represents the tool's surface near the point.

Force: the contact force at a point of a compliant body keeps this point out of the tool. The force
follows the laws of Signorini and Coulomb.

W is the body's compliance at the point, n the tool's normal and f the force on the body. The gap is
the distance between point and tool. The gap is not negative, the normal force does not pull, and
the gap or the normal force is zero. The tangential force is at most ``mu`` times the normal force.
If the tangential force f_t reaches this bound, the point slips, and f_t acts against the slip s. A
sticking point leads to a linear system. A slipping point satisfies ``s = -l f_t`` with ``l >= 0``.
Elimination of the normal force gives ``(S + l I) f_t = -r``. S is the tangential Schur complement
of W, and r is the slip under the normal force alone. Newton's method inside a bracket finds the l
with ``|f_t| = mu f_n``. The method is applied to the reciprocals of the forces, because these
reciprocals are nearly linear in l (More and Sorensen 1983). The solver computes this force for one
contact point after another, in sweeps (Jourdan, Alart and Jean 1998, Comput. Methods Appl. Mech.
Eng. 155:31).
"""

import warp as wp

from kernels.arrays import Doubles, Doubles2D, Int32s, Int32s2D, Matrices2D, Vectors
from kernels.constants import HALF, ONE, TWO, ZERO

wp.set_module_options({"max_unroll": 1})


SPHERE = 0
CYLINDER = 1
SHELL = 2


@wp.struct
class Pose:
    """Form of a tool, and its pose in the present tick (1 ms step) and in the previous tick."""

    kind: int  # SPHERE, CYLINDER or SHELL
    size: wp.vec2d  # [m], see `tissue.models.organ.probe`
    tip: wp.vec3d  # [m]
    turn: wp.mat33d  # tool to world
    last_tip: wp.vec3d  # [m]
    last_turn: wp.mat33d


@wp.func
def axis_distance(pose: Pose, point: wp.vec3d):
    """Compute the signed distance [m], with its gradient, of a point from a sphere or cylinder.

    The distance is negative inside the tool. ``pose.size[0]`` is the radius of the tool [m]. For a
    cylinder, ``pose.size[1]`` is the radius of the rounded edge [m].
    """
    axis = wp.vec3d(pose.turn[0, 2], pose.turn[1, 2], pose.turn[2, 2])
    arm = point - pose.tip
    if pose.kind == SPHERE:
        arm -= pose.size[0] * axis
        length = wp.length(arm)
        direction = -axis
        if length > ZERO:
            direction = arm / length
        return length - pose.size[0], direction
    height = wp.dot(arm, axis)
    radial = arm - height * axis
    radius = wp.length(radial)
    out = wp.vec3d()
    if radius > ZERO:
        out = radial / radius
    outside = radius - pose.size[0] + pose.size[1]
    below = pose.size[1] - height
    direction = -axis
    distance = below - pose.size[1]
    # Near the rounded edge, the distance follows from the circle of the edge. Its centre lies
    # pose.size[1] inside the side and the face. Elsewhere, the nearer of side and face counts.
    if outside > ZERO and below > ZERO:
        corner = wp.sqrt(outside * outside + below * below)
        distance = corner - pose.size[1]
        direction = (outside * out - below * axis) / corner
    elif outside > below:
        distance = outside - pose.size[1]
        direction = out
    return distance, direction


FORCE, TORQUE, STATE, SWEEPS, CONTACTS, AREA, DEEPEST, LARGEST, RESULTS = (
    0,
    3,
    6,
    7,
    8,
    9,
    10,
    11,
    12,
)
"""Indices into the array of results, and number of entries of this array (`RESULTS`).

The force on the tool [N] and the torque on the tool [N m] have three entries each. The next entries
are: end state of the solver, number of sweeps, number of contact points with force, contact area
[m2], largest penetration [m], and largest displacement [m].
"""
DONE, RUN_OUT, IMMOVABLE = 0, 1, 2
"""End states of the solver: converged, too many sweeps, rigid point penetrated."""


@wp.struct
class Body:
    """Triangulated surface of a body, with compliance, nodal forces and nodal positions."""

    free: Vectors  # [node], positions without contact [m]
    last_free: Vectors  # [node], positions without contact in the last tick [m]
    scale: wp.float64  # factor of the compliance
    compliance: Doubles2D  # [3 node, 3 node] [m/N]
    corners: Int32s2D  # [triangle, 3]
    force: Vectors  # [node] [N]
    moved: Vectors  # [node], displacement of nearby nodes before this tick [m]


@wp.struct
class Points:
    """Contact points on the triangles of a body, and the contact forces at these points."""

    first: Int32s  # [triangle], its first point, -1 if it has no point
    following: Int32s  # [point], next point of the triangle, -1 after the last
    weight: Vectors  # [point], barycentric
    area: Doubles  # [point] [m2]
    tool_point: Vectors  # [point], present position of a shell's point [m]
    tool_normal: Vectors
    force: Vectors  # [point], force on the body [N]
    # [point], its last position, moved along with the tool [m]
    anchor: Vectors
    # [point, 5]: compliance of the three nodes and of the point [m/N], and the point's inverse
    # [N/m]
    response: Matrices2D
    ready: Int32s  # [point], 1 if `response` is up to date


NEARBY, WORKING, TICK = 0, 1, 2
"""Indices into `Lists.count`: numbers of nearby triangles, working triangles and ticks."""


@wp.struct
class Lists:
    """List of triangles near the tool, and list of working triangles, which the solver visits."""

    count: Int32s  # [3], see NEARBY
    near: Int32s  # triangles
    working: Int32s  # triangles
    working_mark: Int32s  # [triangle], 1 while it works


@wp.func
def pose_of(rows: Vectors, kind: int, size: wp.vec2d):
    """Convert 8 rows to a `Pose`.

    The rows are the tip and the three rows of the rotation matrix in this tick, and then in the
    previous tick.
    """
    pose = Pose()
    pose.kind = kind
    pose.size = size
    pose.tip = rows[0]
    pose.turn = wp.matrix_from_rows(rows[1], rows[2], rows[3])
    pose.last_tip = rows[4]
    pose.last_turn = wp.matrix_from_rows(rows[5], rows[6], rows[7])
    return pose


@wp.func
def block(body: Body, a: int, b: int):
    """Return the block [m/N], shape (3, 3), of the compliance matrix for nodes ``a`` and ``b``."""
    found = wp.mat33d()
    for i in range(3):
        for j in range(3):
            found[i, j] = body.compliance[3 * a + i, 3 * b + j]
    return body.scale * found


@wp.func
def distance_to(pose: Pose, points: Points, point: int, place: wp.vec3d):
    """Compute the signed distance [m], with its gradient, between the tool and a contact point."""
    # A shell is a set of points. The tangent plane at the contact point's own shell point is used.
    if pose.kind == SHELL:
        direction = points.tool_normal[point]
        return wp.dot(place - points.tool_point[point], direction), direction
    distance, direction = axis_distance(pose, place)
    return distance, direction


# Largest number of steps. Bisection, the fallback, reduces a bracket to rounding errors in 53
# steps.
NEWTON_STEPS = 60
EXACT = wp.float64(1e-13)
"""Relative distance of a slipping point's force from the friction cone at which iteration ends."""
TINY = wp.float64(1e-12)
"""Term added to the diagonal of a compliance that may be singular, relative to its trace."""


@wp.func
def safe_inverse(compliance: wp.mat33d):
    """Invert a compliance matrix, which is singular if the point cannot move in all directions."""
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
    """Compute the contact force [N], on the friction cone, at a slipping point.

    Without a contact force, the point would have the gap ``apart`` [m] (negative) and the
    tangential slip ``drift`` [m].
    """
    side = wp.vec3d(ONE, ZERO, ZERO)
    # Use an axis more than 45 degrees from the normal, to avoid cancellation in the cross product.
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
    angle = HALF * wp.atan2(TWO * s01, s00 - s11)
    turn = wp.cos(angle)
    lift = wp.sin(angle)
    along = turn * first + lift * second  # principal directions of S
    across = turn * second - lift * first
    a0 = turn * c0 + lift * c1
    a1 = turn * c1 - lift * c0
    k0 = turn * turn * s00 + TWO * turn * lift * s01 + lift * lift * s11
    k1 = s00 + s11 - k0
    r0 = wp.dot(along, drift) - a0 * apart * stiff
    r1 = wp.dot(across, drift) - a1 * apart * stiff
    low = wp.float64(0.0)
    high = wp.float64(-1.0)  # no upper end yet
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
        # Outside the bracket: bisect, or increase the value if there is no upper end yet. k0 + k1
        # sets the scale.
        if guess <= low or (high >= ZERO and guess >= high):
            guess = TWO * share + k0 + k1
            if high >= ZERO:
                guess = HALF * (low + high)
        share = guess
    return press * normal + f0 * along + f1 * across


@wp.func
def coulomb_force(
    compliance: wp.mat33d,  # W [m/N]
    inverse: wp.mat33d,
    old: wp.vec3d,  # force that acts now [N]
    gap: wp.float64,  # gap with this force [m]
    normal: wp.vec3d,  # out of the tool
    slip: wp.vec3d,  # motion relative to the tool since the last tick, with this force [m]
    friction: wp.float64,
):
    """Compute the contact force [N] at one point for constant forces at all other points."""
    back = compliance * old
    apart = gap - wp.dot(normal, back)
    force = wp.vec3d()
    # The point would lie in the tool if this force were zero.
    if apart < ZERO:
        if friction == ZERO:
            normal_compliance = wp.dot(normal, compliance * normal)
            if normal_compliance > ZERO:
                force = -apart / normal_compliance * normal
        else:
            sideways = slip - wp.dot(slip, normal) * normal
            force = old - inverse * (gap * normal + sideways)
            press = wp.dot(force, normal)
            # Sticking would need a pulling force, or a tangential force above the friction limit.
            if press < ZERO or wp.length(force - press * normal) > friction * press:
                drift = sideways - (back - wp.dot(back, normal) * normal)
                force = slipping_force(compliance, normal, apart, drift, friction)
    return force
