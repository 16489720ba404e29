"""A rigid sphere pressed into a nonlinear body, without friction.

Under the linear law there is no stiffening of pressed tissue and no turning of it near the tool. Under the neo-Hookean
one there is, and it judges; the corotational shows how much of the difference is rotation.
"""

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.fem.newton import NewtonSolution, NewtonSolver
from tissue.fem.obstacle import RigidSphere

__all__ = ["LONGEST", "NODES", "press_at", "resting_sphere"]

STIFFER = 10.0
"""Penalty of a surface node over its own stiffness."""
NODES = 1e-5
"""How far a node may be off the sphere, over its radius."""
LONGEST = 0.3
"""Longest step of the sphere over its radius."""


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
    sphere, touching = resting_sphere(solver, tip_m, direction, radius_m, tolerance)
    depth, now = -radius_m - touching, None
    for stop in np.linspace(touching, -radius_m, 2 + max(0, int(depth / (LONGEST * radius_m))))[1:]:
        sphere.move_to(tip_m + stop * direction)
        solution = solver.solve(sphere=sphere, start_m=now)
        if not solution.converged:
            break
        now = solution.displacement_m
    return solution, sphere, depth


def resting_sphere(
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
