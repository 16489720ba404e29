"""Reference cutting force of a whole run, and grid-convergence index of simulated forces.

The reference force is evaluated at selected ticks and interpolated between them. It is stored on
disk.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.base.cache import Arrays, cached_arrays
from tissue.cutters.cutter import Cutter
from tissue.evaluation.reference.force import Resolution, Solid, wrench_at
from tissue.evaluation.reference.path import ToolPath
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.builders.cutting import cutter_of
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.builders.voxels import is_procedural, solid_of
from tissue.simulation.trace import Table

COARSEST_TICKS = 32
"""Largest number of ticks between two evaluations of the reference force.

The value is below 50 ms, because means of the force over 50 ms are reported.
"""
INTERPOLATION = 2e-3
"""Largest interpolation error between two force evaluations, relative to the mean force.

Intervals with a larger error are halved. With this value, the uncertainty of the reference force in
the built-in scenes is 0.01 to 0.03 %, including the interpolation error
(``tests/bench/bench_reference.py``).
"""
JUMP = 0.05
"""Relative change of velocity from tick to tick above which the force may be discontinuous.

Such changes occur only at corners of the tool path.
"""
CHECKED = 32
"""Number of ticks at which the reference force is computed again with twice the resolution.

The differences give the uncertainty of the reference force. Twice the resolution takes four times
as long.
"""
WINDOW_TICKS = 50
"""Number of ticks in a mean over 50 ms."""


@dataclass(frozen=True)
class ReferenceForce:
    """Reference force and torque of a run, computed on the exact geometry.

    Attributes
    ----------
    wrench
        Force on the tool [N] and torque about its tip [N m] at every tick, in the world frame,
        shape (n, 6).
    uncertainty
        Relative error of the reference force. The error is estimated as the difference from a
        computation at twice the resolution, and includes the interpolation error. Error and force
        are root mean squares over a sample of the ticks in contact.
    """

    wrench: Array
    uncertainty: float

    @property
    def force_N(self) -> Array:
        """Force on the tool [N], shape (n, 3)."""
        return self.wrench[:, :3]


def path_of_trace(trace: Table, cutter: Cutter) -> ToolPath:
    """Return poses and velocities of the tool from the trace of a run."""
    low, high = cutter.profile.height_range_m
    quaternions = np.column_stack([trace[f"tool_q{c}"] for c in "xyzw"])
    return ToolPath(
        1e-3 * trace.vectors("tool", "mm"),
        Rotation.from_quat(quaternions).as_matrix(),
        1e-3 * trace.vectors("velocity", "mm_s"),
        trace.vectors("angular_velocity", "rad_s"),
        reach_m=float(np.hypot(cutter.profile.radius_m, max(abs(low), abs(high)))),
    )


def has_exact_geometry(scene: Scene) -> bool:
    """Return whether a scene's tool cuts an anatomy that is known as a function of position."""
    return isinstance(scene.tool, Tool) and scene.tool.spin_rpm > 0.0 and is_procedural(scene.bone)


def solid_of_scene(scene: Scene) -> Solid:
    """Return the solid that a scene's tool cuts, described by functions of position.

    Raises InputError if the anatomy comes from a file.
    """
    anatomy, minus = solid_of(scene, motion_of(scene))
    changes = scene.cutting.model_dump(exclude={"material"})
    layers = scene.constants.coefficients(anatomy.layer_names, changes, bone=scene.cutting.material)
    return Solid(anatomy, layers, minus)


def reference_force(
    scene: Scene, trace: Table, *, resolution: Resolution | None = None
) -> ReferenceForce:
    """Compute the reference force on the exact geometry along the motion in a trace.

    The result is stored on disk; it is reused for the same motion, anatomy and tool.

    Raises
    ------
    InputError
        If the anatomy comes from a file.
    """
    assert isinstance(scene.tool, Tool)
    cutter = cutter_of(scene.tool)
    path = path_of_trace(trace, cutter)
    solid = solid_of_scene(scene)
    cache_key = (
        scene.bone,
        scene.tool.model_copy(update={"shell_spacing_mm": None}),
        solid.coefficients,
    )
    return force_on_path(path, cutter, solid, cache_key=cache_key, resolution=resolution)


def force_on_path(
    path: ToolPath,
    cutter: Cutter,
    solid: Solid,
    *,
    cache_key: tuple[object, ...] = (),
    resolution: Resolution | None = None,
) -> ReferenceForce:
    """Compute the reference force on the exact geometry along a tool path.

    Parameters
    ----------
    cache_key
        Values that identify the cutter and the solid in the disk cache. If the tuple is empty, the
        result is not stored.
    """
    fine = resolution or Resolution()

    def make() -> Arrays:
        """Return the wrench [N], [N m] at every tick, and relative errors at sampled ticks."""
        wrench = _over_ticks(
            lambda tick: wrench_at(tick, path, cutter, solid, resolution=fine), path
        )
        contact = np.flatnonzero(wrench.any(axis=1))
        checked = (
            contact[np.unique(np.linspace(0, len(contact) - 1, CHECKED).astype(int))]
            if len(contact)
            else contact
        )
        again = [
            wrench_at(int(tick), path, cutter, solid, resolution=fine.finer())[:3]
            for tick in checked
        ]
        off = np.linalg.norm(np.array(again) - wrench[checked, :3]) if len(checked) else 0.0
        # without contact both are zero
        error = off / max(float(np.linalg.norm(wrench[checked, :3])), 1e-300)
        return {"wrench": wrench, "uncertainty": np.array(error)}

    key = (
        path.tips_m,
        path.rotations,
        path.velocities,
        path.turnings,
        *cache_key,
        fine,
        INTERPOLATION,
        COARSEST_TICKS,
    )
    found = cached_arrays("reference-force", key, make) if cache_key else make()
    return ReferenceForce(found["wrench"], found["uncertainty"].item())


def _over_ticks(evaluate: Callable[[int], Array], path: ToolPath) -> Array:
    """Compute force and torque at every tick, shape (n, 6), from few evaluations.

    The path is divided into parts where the velocity jumps. A part is halved until the value at its
    middle agrees with linear interpolation between its ends. If contact begins or ends in a part,
    the part is halved down to single ticks.
    """
    wrench = np.zeros((len(path.tips_m), 6))
    waiting: list[tuple[int, int]] = []
    for first, last in _stretches(path):
        knots = np.unique(np.append(np.arange(first, last, COARSEST_TICKS), last)).tolist()
        for tick in knots:
            wrench[tick] = evaluate(tick)
        waiting += pairwise(knots)
    sizes = np.linalg.norm(wrench[:, :3], axis=1)
    allowed = INTERPOLATION * sizes[sizes > 0.0].mean() if sizes.any() else 0.0
    while waiting:
        first, last = waiting.pop()
        middle = (first + last) // 2
        # neighbouring ticks have none between them
        if middle == first:
            continue
        line = wrench[first] + (middle - first) / (last - first) * (wrench[last] - wrench[first])
        # The force has a kink where contact begins. A line over the kink can agree with the middle
        # by chance, and would then give a force before the contact.
        begins_or_ends = wrench[first].any() != wrench[last].any()
        wrench[middle] = evaluate(middle)
        if np.linalg.norm((wrench[middle] - line)[:3]) > allowed or begins_or_ends:
            waiting += [(first, middle), (middle, last)]
        else:
            _fill(wrench, first, middle)
            _fill(wrench, middle, last)
    return wrench


def _stretches(path: ToolPath) -> list[tuple[int, int]]:
    """Divide a path at jumps of the velocity; return the first and the last tick of each part.

    Within a part, the force is continuous.
    """
    motion = np.hstack([path.velocities, path.reach_m * path.turnings])
    speed = np.linalg.norm(motion, axis=1)
    jumps = np.linalg.norm(np.diff(motion, axis=0), axis=1) > JUMP * np.maximum(
        speed[1:], speed[:-1]
    )
    begins = [0, *(np.flatnonzero(jumps) + 1).tolist()]
    return list(zip(begins, [*(first - 1 for first in begins[1:]), len(speed) - 1], strict=True))


def _fill(wrench: Array, first: int, last: int) -> None:
    """Fill the ticks between two evaluated ticks by linear interpolation."""
    share = (np.arange(first + 1, last) - first)[:, None] / (last - first)
    wrench[first + 1 : last] = wrench[first] + share * (wrench[last] - wrench[first])


def means_over_50_ms(values: Array) -> Array:
    """Return the means over successive intervals of 50 ms, shape (n // 50, 3).

    The values have shape (n, 3), one row per tick of 1 ms. If n is below 50, one mean is returned.
    """
    count = max(len(values) // WINDOW_TICKS, 1)
    return np.array([part.mean(axis=0) for part in np.split(values[: count * WINDOW_TICKS], count)])


FORMAL_ORDER = 2.0
"""Formal order of convergence of the force; a convergence index uses no larger order."""
ASYMPTOTIC = 0.5, 2.2
"""Range of observed orders of convergence that counts as asymptotic.

The lower end is 0.5 (Eça and Hoekstra 2014, J. Comput. Phys. 262, 104-130). The upper end is 10 %
above the formal order (Oberkampf and Roy 2010, Verification and Validation in Scientific
Computing).
"""
SAFETY = 1.25
SAFETY_OUTSIDE = 3.0
"""Safety factor of a grid-convergence index (Roache) outside the asymptotic range.

`SAFETY` is the factor within the asymptotic range.
"""
STEEPEST = 30.0
"""Largest absolute value of an observed order of convergence; larger orders count as infinite.

For spacings in the ratio 1.2, an order of 30 means: the forces on the coarse and middle grids
differ 240 times as much as the forces on the middle and fine grids.
"""


@dataclass(frozen=True)
class Order:
    """Convergence of the forces on three grids.

    Differences are norms over all ticks, relative to the norm of the force on the finest grid.

    Attributes
    ----------
    order
        Observed order of convergence. It is infinite if the forces on the two finer grids agree,
        and NaN if all three forces agree. It is negative if the forces on the two finer grids lie
        farther apart than those on the two coarser grids.
    index
        Grid-convergence index of each grid, coarsest first.
    distance
        Difference of the force on each grid from the force on the finest grid, coarsest first.
    """

    order: float
    index: tuple[float, ...]
    distance: tuple[float, ...]

    @property
    def asymptotic(self) -> bool:
        """True if the observed order is in the range `ASYMPTOTIC`, or the forces are all equal."""
        return np.isnan(self.order) or ASYMPTOTIC[0] <= self.order <= ASYMPTOTIC[1]


def grid_index(forces_N: Sequence[Array], spacings: Sequence[float]) -> Order:
    """Compute the grid-convergence index of the forces of one motion on three grids.

    Parameters
    ----------
    forces_N
        Force at every tick on each grid [N], each shape (n, 3).
    spacings
        Spacings of the three grids, all different, in any unit. All other numerical lengths, such
        as the distance between cutting elements, must be proportional to the spacing.
    """
    order = np.argsort(spacings)[::-1]
    h = [float(spacings[k]) for k in order]
    coarse, middle, fine = (np.asarray(forces_N[k], dtype=np.float64) for k in order)
    # a motion without force has no size, and its differences are zero
    size = max(float(np.linalg.norm(fine)), 1e-300)
    distance = tuple(float(np.linalg.norm(each - fine)) / size for each in (coarse, middle, fine))
    observed = observed_order(float(np.linalg.norm(coarse - middle)) / size, distance[1], h)
    safety = SAFETY if Order(observed, (), distance).asymptotic else SAFETY_OUTSIDE
    # an order above the formal one is not trusted, nor one below the asymptotic range
    used = float(np.clip(np.nan_to_num(observed, nan=FORMAL_ORDER), ASYMPTOTIC[0], FORMAL_ORDER))
    left = distance[1] / ((h[1] / h[2]) ** used - 1.0)
    return Order(observed, tuple(safety * (each + left) for each in distance), distance)


def observed_order(coarse: float, fine: float, spacings: Sequence[float]) -> float:
    """Compute the order p of an error C h^p from the differences between the forces on three grids.

    ``coarse`` is the difference between the forces on the grids with the spacings h3 and h2.
    ``fine`` is the difference between the forces on the grids with h2 and h1.

    Parameters
    ----------
    spacings
        Spacings h3, h2 and h1, in decreasing order.
    """
    # equal forces on all grids have no order; equal forces on two of them have an infinite one
    if coarse == fine == 0.0:
        return float("nan")
    if fine == 0.0 or coarse == 0.0:
        return float("inf") if fine == 0.0 else float("-inf")
    h = np.log(np.array(spacings) / spacings[1])  # the middle one has h^p = 1

    def excess(p: float) -> float:
        # at p = 0 both differences vanish; the ratio has this limit
        ratio = -np.expm1(p * h[0]) / np.expm1(p * h[2]) if abs(p) > 1e-9 else -h[0] / h[2]
        return float(np.log(ratio) - np.log(coarse / fine))

    if excess(STEEPEST) < 0.0:
        return float("inf")
    if excess(-STEEPEST) > 0.0:
        return float("-inf")
    # far below the digits of an order that anybody reads
    return float(brentq(excess, -STEEPEST, STEEPEST, xtol=1e-10))
