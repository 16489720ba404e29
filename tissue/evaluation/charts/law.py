"""How far the linear law is from a neo-Hookean one on a scene's own motion: what no setting of an organ mends.

At some instants of the motion the body is brought to rest under both laws, on one mesh, with the tool where it is then
and without friction, so that the difference is the law's alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from math import isnan
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from meshes.base.arrays import Array, Ints
from meshes.base.cache import cached_arrays
from meshes.base.progress import Progress, silent
from meshes.shapes.polyline import arc_length, points_along
from meshes.tets.regions import faces_of
from tissue.builders.motions import motion_of
from tissue.builders.organ import elasticity_of
from tissue.builders.organ_law import coarser_mesh
from tissue.evaluation.charts.error_bounds import bound_row
from tissue.evaluation.charts.keys import machine, scene_text, sources
from tissue.evaluation.charts.measure import Measured
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Probe
from tissue.simulation.simulate import TICK_S

if TYPE_CHECKING:
    from tissue.fem.hyperelastic import Law
    from tissue.fem.newton import NewtonSolver

__all__ = ["LawError", "law_error"]

Instants = list[tuple[Array, Array, Array]]
INSTANTS = 4
"""Instants of the contact that are solved, in the middle of as many equal parts of it."""
POSES = 400
"""Poses of the motion at which contact is looked for."""
EDGES = (1.4, 2.0)
"""Edges of the mesh, and of a coarser one to compare with, over the scene's: liver-press takes 40 s of one core.

A graded slab with a nodule takes minutes: the nodule keeps its cells short, and the gradients take more iterations.
"""
TOLERANCE = 1e-4
"""Residual of a solve, and how far a node may be off the ball over its radius: the laws differ by per cents."""


@dataclass(frozen=True, eq=False)
class LawError:
    """Forces on the tool with the body at rest; NaN where a solve did not converge.

    Attributes
    ----------
    depth_m
        Depth of the tool in the undeformed body [m], shape (k,).
    linear_N, neo_N, coarse_N
        By the linear law, by the neo-Hookean one, and by that on a coarser mesh, where deepest [N], shape (k, 3).
    solve_us
        Time of a neo-Hookean solve one tick's path from one that is done [us], shape (k,).
    cells, took_s
        Tetrahedra, and time of all of it [s], shape ().
    """

    depth_m: Array
    linear_N: Array
    neo_N: Array
    coarse_N: Array
    solve_us: Array
    cells: Ints
    took_s: Array

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Instants at which both laws converged, shape (k,)."""
        return np.asarray(np.isfinite(self.linear_N + self.neo_N).all(axis=1))

    @property
    def error(self) -> float:
        """||F_linear - F_neo|| / ||F_neo|| over the instants; NaN if none was solved."""
        return self._off(self.linear_N)

    @property
    def gap(self) -> float:
        """Distance of the neo-Hookean force on the coarser mesh to that on the finer one; NaN where it is unknown."""
        return self._off(self.coarse_N)

    def _off(self, force_N: Array) -> float:
        on = np.isfinite(force_N + self.neo_N).all(axis=1)
        return force_error(force_N[on], self.neo_N[on]) if on.any() else float("nan")

    def rows(self, scene: Scene) -> tuple[Measured, ...]:
        """The law of all settings, and the neo-Hookean solve with its change on a coarser mesh; none if none was."""
        on = self.solved
        if not on.any():
            return ()
        solve_us = self.solve_us[on]
        return bound_row(scene, "linear law", "law", self.error), bound_row(
            scene,
            "neo-Hookean (statics)",
            "law",
            self.gap,
            leaves_out="friction",
            median_us=float(np.median(solve_us)),
            p99_us=float(np.percentile(solve_us, 99)),
            missed=int((solve_us > 1e3).sum()),
            elements=int(self.cells),
            built_s=float(self.took_s),
        )

    def line(self) -> str:
        """The error in words."""
        on = self.solved
        if not on.any():
            return f"the neo-Hookean law converged at none of {len(on)} instants of this motion"
        return (
            f"the linear law is {100.0 * self.error:.2g} % off a neo-Hookean one on this motion, whatever the setting: "
            f"{on.sum()} instants without friction, up to {1e3 * self.depth_m[on].max():.2g} mm deep"
            + ("" if on.all() else f", {len(on) - on.sum()} more did not converge")
            + f"; a neo-Hookean solve takes {1e-3 * np.median(self.solve_us[on]):.0f} ms"
            + ("" if isnan(self.gap) else f", coarser cells move its force by {100.0 * self.gap:.2g} %")
        )


def law_error(scene: Scene, *, report: Progress = silent) -> LawError | None:
    """Both laws on the motion of a scene, kept on disk; None where they cannot be compared.

    They can for a ball on a path into an organ that is isotropic, weightless and without a capsule.
    """
    anatomy, organ, tool = scene.anatomy, scene.organ, scene.tool
    if not isinstance(anatomy, SoftAnatomy) or not isinstance(scene.motion, PathMotion):
        return None
    if not isinstance(tool, Probe) or tool.kind != "sphere-probe":
        return None
    if organ.fibre_direction is not None or organ.capsule or organ.gravity:
        return None
    radius = 0.5e-3 * tool.size_mm

    def make() -> dict[str, NDArray[np.generic]]:
        """Both laws at the instants, as arrays that a file can hold."""
        from tissue.fem.hyperelastic import Law

        started = perf_counter()
        report(f"{scene.name}: linear law and neo-Hookean one", 0.99)
        linear, neo = _solvers(scene, EDGES[0], (Law.LINEAR, Law.NEO_HOOKEAN))
        (coarse,) = _solvers(scene, EDGES[1], (Law.NEO_HOOKEAN,))
        at = _instants(scene, linear, radius)
        force_N, depth_m, solve_us = _pressed(neo, at, radius)
        coarse_N = np.full(force_N.shape, np.nan)
        deepest = [int(depth_m.argmax())] if at else []
        coarse_N[deepest] = _pressed(coarse, [at[k] for k in deepest], radius)[0]
        return {
            "depth_m": depth_m,
            "linear_N": _pressed(linear, at, radius)[0],
            "neo_N": force_N,
            "coarse_N": coarse_N,
            "solve_us": solve_us,
            "cells": np.array(len(neo.body.space.cell_nodes)),
            "took_s": np.array(perf_counter() - started),
        }

    kept = cached_arrays("law", (scene_text(scene), INSTANTS, POSES, EDGES, TOLERANCE, machine(), sources()), make)
    return LawError(**{entry.name: kept[entry.name] for entry in fields(LawError)})  # type: ignore[arg-type]


def _solvers(scene: Scene, coarser: float, laws: "Sequence[Law]") -> "list[NewtonSolver]":
    """The scene's organ under each law, its edges longer by a factor."""
    from tissue.fem.hyperelastic import NonlinearBody
    from tissue.fem.newton import NewtonSolver
    from tissue.fem.space import Space

    assert isinstance(scene.anatomy, SoftAnatomy) and isinstance(scene.tool, Probe)
    edge_m = 1e-3 * (scene.anatomy.touch_edge_mm or 0.25 * scene.tool.size_mm)
    path = motion_of(scene, step_s=TICK_S).sweep_m()
    found = coarser_mesh(scene, path_m=path, touch_edge_m=edge_m, ratio=coarser, report=silent)
    space = Space(found.mesh, scene.organ.order)
    held = np.zeros((space.node_count, 3), dtype=bool)
    held[found.held] = True
    held[space.with_middles(faces_of(space.mesh, found.held))] = True
    lame, _ = elasticity_of(found.mesh, scene.anatomy, scene.organ, scene.constants)
    solvers: list[NewtonSolver] = []
    for law in laws:  # the stiffness at rest is the same for all
        known = solvers[0].precondition if solvers else None
        body = NonlinearBody(space, lame, law=law)
        solvers.append(NewtonSolver(body, held, tolerance=TOLERANCE, precondition=known))
    return solvers


def _instants(scene: Scene, solver: "NewtonSolver", radius_m: float) -> Instants:
    """Tips [m], directions that the tool comes along and its path in a tick [m], spread over the contact."""
    assert isinstance(scene.motion, PathMotion)
    motion = motion_of(scene, step_s=TICK_S)
    corners, axis = motion.sweep_m(), motion.rotations()[0][:, 2]
    wanted = np.linspace(0.0, arc_length(corners)[-1], POSES)

    surface = solver.body.nodes_m[np.unique(solver.body.space.faces)]
    away, _ = KDTree(surface).query(points_along(corners, wanted) + radius_m * axis)
    touching = wanted[away < radius_m]
    chosen = (
        touching[((np.arange(INSTANTS) + 0.5) / INSTANTS * len(touching)).astype(int)] if len(touching) else touching
    )
    tips = points_along(corners, chosen)
    steps = points_along(corners, chosen + 1e-3 * scene.motion.feed_mm_s * TICK_S) - tips
    return [(tip, -axis, step) for tip, step in zip(tips, steps, strict=True)]


def _pressed(solver: "NewtonSolver", at: Instants, radius_m: float) -> tuple[Array, Array, Array]:
    """Force on the ball at each instant [N], its depth [m], and the time of a solve a tick later [us]."""
    from tissue.fem.linear_limits import press_at

    found = []
    for tip, direction, step in at:
        solution, sphere, depth = press_at(solver, tip, direction, radius_m=radius_m, tolerance=TOLERANCE)
        force, took = np.full(3, np.nan), float("nan")
        if solution.converged:
            force = solution.tool_force_N
            sphere.move_to(sphere.centre_m + step)
            start = perf_counter()
            solver.solve(sphere=sphere, start_m=solution.displacement_m)
            took = 1e6 * (perf_counter() - start)
        found.append([*force, depth, took])
    table = np.array(found).reshape(-1, 5)
    return table[:, :3], table[:, 3], table[:, 4]
