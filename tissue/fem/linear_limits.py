"""Where linear elasticity stops being enough: a sphere pressed into a body under the three laws, no friction.

The linear law has no stiffening of pressed tissue and no turning of it near the tool. Neo-Hookean does, and
judges; corotational shows how much of the difference is rotation. A scene may choose by the depth it presses to.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.base.errors import InputError, require_positive
from tissue.fem.hyperelastic import Law, NonlinearBody
from tissue.fem.newton import NewtonSolution, NewtonSolver
from tissue.fem.obstacle import RigidSphere
from tissue.fem.space import Space

__all__ = ["LinearLimits", "linear_limits", "press", "press_at"]

Array = NDArray[np.float64]
STIFFER = 10.0
"""Penalty of a surface node over its own stiffness."""
TOLERANCE = 1e-6
"""Residual of a solve; with nodes `NODES` off, forces hold to about 1e-5."""
NODES = 1e-5
"""How far a node may be off the sphere, over its radius."""
LONGEST = 0.3
"""Longest step of the sphere over its radius."""


@dataclass(frozen=True, eq=False)
class LinearLimits:
    """Forces on a sphere by depth under each law.

    Attributes
    ----------
    depth_m
        Depths pressed to [m], shape (d,), rising.
    force_N
        Force against the press [N], shape (d,), of each law; NaN where a solve did not converge.
    """

    depth_m: Array
    force_N: dict[Law, Array]

    def error(self, law: Law) -> Array:
        """Force over the neo-Hookean one, less 1, shape (d,)."""
        return self.force_N[law] / self.force_N[Law.NEO_HOOKEAN] - 1.0

    def passed_at_m(self, share: float, law: Law = Law.LINEAR) -> float:
        """Depth [m] at which the error first passes a share, between two depths in proportion; NaN if it does not."""
        depths, errors = np.append(0.0, self.depth_m), np.append(0.0, np.abs(self.error(law)))
        for (near, low), (far, high) in pairwise(zip(depths, errors, strict=True)):
            if low <= share < high:
                return float(near + (far - near) * (share - low) / (high - low))
        return float("nan")


def press(
    body: NonlinearBody,
    held: NDArray[np.bool_],
    *,
    point_m: ArrayLike,
    inward: ArrayLike,
    radius_m: float,
    depths_m: Iterable[float],
    solver: NewtonSolver | None = None,
) -> list[NewtonSolution]:
    """Equilibria with a rigid sphere at each depth, one from the other, up to the first that does not converge.

    Parameters
    ----------
    body
        Body and law.
    held
        Fixed nodes, shape (n,).
    point_m, inward
        Where on the surface the sphere is aimed [m], and along which direction, shapes (3,).
    radius_m
        Radius of the sphere [m].
    depths_m
        Path length of the sphere from where it first touches a node [m], positive and rising.
    solver
        Solver to use, for its factorisation; default: a new one.

    Raises
    ------
    InputError
        If the direction has no length, depths do not rise, no node of the surface lies in the sphere's path, or nothing
        is held.
    """
    start, direction = np.asarray(point_m, dtype=np.float64), np.asarray(inward, dtype=np.float64)
    length = float(np.linalg.norm(direction))
    if not length > 0.0:
        raise InputError(f"inward must have a length, got {direction}: use (0, 0, -1)")
    direction = direction / length
    depths = np.fromiter(depths_m, dtype=np.float64)
    if not (np.diff(depths, prepend=0.0) > 0.0).all() or not np.isfinite(depths).all():
        raise InputError(f"depths_m must be positive, finite and rising, got {depths}: use (1e-3, 2e-3, 4e-3)")
    solver = solver or NewtonSolver(body, np.repeat(held[:, None], 3, axis=1))
    sphere, touching = _resting(solver, start, direction, radius_m, NODES)
    solutions: list[NewtonSolution] = []
    now, reached = None, 0.0
    for depth in depths:
        # A sphere that jumped by its radius would find nodes behind its centre and keep them there.
        stops = np.linspace(reached, depth, 2 + int((depth - reached) / (LONGEST * sphere.radius_m)))[1:]
        for stop in stops:
            sphere.move_to(start + (touching + stop) * direction)
            solution = solver.solve(sphere=sphere, start_m=now)
            now = solution.displacement_m
            if not solution.converged:
                return [*solutions, solution]
        solutions.append(solution)
        reached = depth
    return solutions


def press_at(
    solver: NewtonSolver, tip_m: Array, direction: Array, *, radius_m: float, tolerance: float = NODES
) -> tuple[NewtonSolution, RigidSphere, float]:
    """Equilibrium with a rigid sphere that comes straight to its place, the body being at rest before.

    Parameters
    ----------
    solver
        Solver of the body.
    tip_m, direction
        Foremost point of the sphere at its place [m], and the unit direction that it comes along, shapes (3,).
    radius_m
        Radius of the sphere [m].
    tolerance
        Depth of a node in the sphere that is allowed, over the radius.

    Returns
    -------
    The equilibrium, the first that did not converge if one does not; the sphere; its path from the first touch [m],
    not positive where it does not reach the body.

    Raises
    ------
    InputError
        If the radius is not positive or no node of the surface lies in the sphere's path.
    """
    sphere, touching = _resting(solver, tip_m, direction, radius_m, tolerance)
    depth, now = -radius_m - touching, None
    for stop in np.linspace(touching, -radius_m, 2 + max(0, int(depth / (LONGEST * radius_m))))[1:]:
        sphere.move_to(tip_m + stop * direction)
        solution = solver.solve(sphere=sphere, start_m=now)
        if not solution.converged:
            break
        now = solution.displacement_m
    return solution, sphere, depth


def _resting(
    solver: NewtonSolver, point_m: Array, direction: Array, radius_m: float, tolerance: float
) -> tuple[RigidSphere, float]:
    """A sphere aimed at a point [m] where it first touches a node, and how far beyond the point its centre is [m]."""
    radius, body = require_positive("radius_m", radius_m, "use 0.01"), solver.body
    surface = np.unique(body.space.faces)
    offset = body.nodes_m[surface] - point_m
    near = np.linalg.norm(offset, axis=1) < 3.0 * radius
    surface, offset = surface[near], offset[near]
    along = offset @ direction
    aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
    inside = aside < radius
    if not inside.any():
        raise InputError(f"point_m must lie on the surface, got {point_m}: no node of it is in the sphere's path")
    touching = float((along[inside] - np.sqrt(radius**2 - aside[inside] ** 2)).min())
    penalty = STIFFER * solver.rest_diagonal.reshape(-1, 3)[surface].mean(axis=1)
    centre = point_m + touching * direction
    return RigidSphere(surface, penalty, radius_m=radius, centre_m=centre, tolerance=tolerance), touching


def linear_limits(
    space: Space,
    lame_Pa: ArrayLike,
    held: NDArray[np.bool_],
    *,
    point_m: ArrayLike,
    inward: ArrayLike,
    radius_m: float,
    depths_m: ArrayLike,
    laws: Iterable[Law] = tuple(Law),
) -> LinearLimits:
    """Press a sphere under each law; arguments as of `press`, Lame constants [Pa] as of `NonlinearBody`."""
    depths = np.asarray(depths_m, dtype=np.float64)
    direction = np.asarray(inward, dtype=np.float64) / np.linalg.norm(inward)
    precondition, forces = None, {}
    for law in laws:
        solver = NewtonSolver(
            NonlinearBody(space, lame_Pa, law=law), np.repeat(held[:, None], 3, axis=1),
            tolerance=TOLERANCE, precondition=precondition,
        )  # fmt: skip
        precondition = solver.precondition  # the stiffness at rest is the same for all
        found = press(
            solver.body, held, point_m=point_m, inward=inward, radius_m=radius_m, depths_m=depths, solver=solver
        )
        force = [-float(s.tool_force_N @ direction) if s.converged else np.nan for s in found]
        forces[law] = np.array(force + [np.nan] * (len(depths) - len(force)))
    return LinearLimits(depths, forces)
