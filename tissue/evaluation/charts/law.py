"""Error of the linear elastic law of an organ, and the law that a demanded fidelity needs.

`law_error` solves the body at rest under the linear and the neo-Hookean law, at some instants of
the motion. Both solutions use the same mesh and no friction, so only the laws cause a difference.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from meshes.base.arrays import Array
from meshes.base.cache import Arrays, cached_arrays
from meshes.base.errors import InputError, counted
from meshes.base.progress import Progress, silent
from meshes.paths.toolpath import arc_length, points_along
from meshes.tets.regions import faces_of
from tissue.evaluation.charts.measure import of_model
from tissue.evaluation.charts.settings import edge_mm, scene_text, settings_of, sources
from tissue.evaluation.statistics.metrics import force_error
from tissue.models.organ.model import LINEAR_ERROR
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Probe
from tissue.simulation.builders.organ import HeldMesh, elasticity_of, held_mesh, hindrance
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.simulate import simulate

if TYPE_CHECKING:
    from tissue.fem.hyperelastic import Law
    from tissue.fem.newton import NewtonSolver

__all__ = ["LawError", "law_error", "linear_error", "with_law"]


LAW = "neo-hookean"
"""Law that replaces the linear law. It needs no constants beyond the small-strain constants."""
CITED_LAW = "exponential"
"""Law that replaces the linear law for a material with a published rate of this law."""
EXPONENTIAL_ERROR = ((0.1, 0.045), (0.2, 0.104), (0.3, 0.164), (0.5, 0.283), (0.75, 0.431))
"""Depth relative to the ball's radius, and error of the linear force against the exponential law.

The rate is 4.6, the published value of a pressed liver. The layer is ten radii thick
(`tests/tissue/evaluation/test_law_choice.py`). The errors are 1.2 times as large on a layer of five
radii, and 1.8 times on a layer of 2.5 radii.
"""
INSTANTS = 4
"""Number of instants at which the contact is solved.

Each instant lies in the middle of one of four equal parts of the contact.

Each instant takes two nonlinear solves of about 5 s in liver-press.
"""
POSES = 400
"""Number of poses of the motion that are searched for contact.

On a path of 40 mm the poses are 0.1 mm apart.
"""
COARSER = 1.4
"""Ratio of the edge lengths of the mesh for the comparison to those of the scene's mesh.

With this ratio, liver-press takes 40 s on one core. A graded slab with a nodule takes minutes: the
nodule needs short cells, and the gradients need more iterations.
"""
TOLERANCE = 1e-4
"""Residual of a solve, and distance of a node from the ball relative to its radius.

The forces of the two laws differ by several per cent, far more than this tolerance.
"""


@dataclass(frozen=True, eq=False)
class LawError:
    """Forces on the tool with the body at rest; NaN where a solve did not converge.

    Attributes
    ----------
    depth_m
        Depth of the tool in the undeformed body [m], shape (k,).
    linear_N, neo_N
        Forces by the linear and by the neo-Hookean law [N], shape (k, 3).
    """

    depth_m: Array
    linear_N: Array
    neo_N: Array

    @property
    def solved(self) -> NDArray[np.bool_]:
        """Instants at which both laws converged, shape (k,)."""
        return np.asarray(np.isfinite(self.linear_N + self.neo_N).all(axis=1))

    @property
    def error(self) -> float:
        """||F_linear - F_neo|| / ||F_neo|| over the instants; NaN if no instant was solved."""
        on = self.solved
        return force_error(self.linear_N[on], self.neo_N[on]) if on.any() else nan

    def line(self) -> str:
        """Return the error in words."""
        on = self.solved
        if not on.any():
            return f"the neo-Hookean law converged at none of {len(on)} instants of this motion"
        lost = "" if on.all() else f"; {len(on) - on.sum()} more did not converge"
        return (
            f"the force error of the linear law against the neo-Hookean law is "
            f"{100.0 * self.error:.2g} % on this motion, with every setting "
            f"({counted(on.sum(), 'instant')} without friction, at depths of up to "
            f"{1e3 * self.depth_m[on].max():.2g} mm{lost})"
        )


def law_error(scene: Scene, *, report: Progress = silent) -> LawError | None:
    """Compare both laws on the motion of a scene.

    The result is stored on disk.

    The comparison needs a ball on a path into an organ that is isotropic, weightless and without a
    capsule. The result is None for other scenes.
    """
    organ = scene.organ
    if not _pressed_by_a_ball(scene) or not isinstance(scene.motion, PathMotion):
        return None
    # the nonlinear solver has neither fibres nor capsules, and an organ without weight begins at
    # rest
    if organ.fibre_direction is not None or organ.capsule or organ.gravity:
        return None

    def make() -> Arrays:
        """Solve both laws at the instants."""
        from tissue.fem.hyperelastic import Law

        # the last step of the scene: its share of the progress is nearly complete
        report(f"{scene.name}: linear and neo-Hookean law", 0.99)
        solvers = _solvers(scene, (Law.LINEAR, Law.NEO_HOOKEAN))
        tips_m, direction = _touching(scene, solvers[0])
        assert isinstance(scene.tool, Probe)
        press = partial(
            _pressed, tips_m=tips_m, direction=direction, radius_m=0.5e-3 * scene.tool.size_mm
        )
        linear_N, depth_m = press(solvers[0])
        neo_N, _ = press(solvers[1])
        return {"depth_m": depth_m, "linear_N": linear_N, "neo_N": neo_N}

    key = (scene_text(scene), INSTANTS, POSES, COARSER, TOLERANCE, sources())
    return LawError(**cached_arrays("law", key, make))


def _pressed_by_a_ball(scene: Scene) -> bool:
    """Return whether a ball presses an organ."""
    tool = scene.tool
    return (
        isinstance(scene.anatomy, SoftAnatomy)
        and isinstance(tool, Probe)
        and tool.kind == "sphere-probe"
    )


def _solvers(scene: Scene, laws: "Sequence[Law]") -> "list[NewtonSolver]":
    """Return a solver of the scene's organ for each law, on a coarser mesh than the scene's."""
    from tissue.fem.hyperelastic import NonlinearBody
    from tissue.fem.newton import NewtonSolver
    from tissue.fem.space import Space

    assert isinstance(scene.anatomy, SoftAnatomy)
    found = _coarser_mesh(scene, scene.anatomy)
    space = Space(found.mesh, scene.organ.order)
    held = np.zeros((space.node_count, 3), dtype=bool)
    held[found.held] = True
    held[space.with_middles(faces_of(space.mesh, found.held))] = True
    lame, _ = elasticity_of(found.mesh, scene.anatomy, scene.organ, scene.constants)
    return [
        NewtonSolver(NonlinearBody(space, lame, law=law), held, tolerance=TOLERANCE) for law in laws
    ]


def _coarser_mesh(scene: Scene, anatomy: SoftAnatomy) -> HeldMesh:
    """Mesh a scene's organ with edges longer by `COARSER`.

    A nodule keeps the edge lengths of the scene. Tetrahedra from a file are not made coarser away
    from the tool.
    """
    longer_mm = anatomy.edge_mm * (1.0 if anatomy.nodule_mm else COARSER)
    # The key must not count as set: tetrahedra from a file have their own edges.
    given = anatomy.model_fields_set - {"edge_mm"}
    coarse = type(anatomy).model_construct(given, **(dict(anatomy) | {"edge_mm": longer_mm}))
    path_m = motion_of(scene).sweep_m()
    touch_edge_m = COARSER * (1e-3 * edge_mm(scene))
    return held_mesh(coarse, path_m=path_m, touch_edge_m=touch_edge_m, report=silent)


def _touching(scene: Scene, solver: "NewtonSolver") -> tuple[Array, Array]:
    """Return positions of the tip spread evenly over the contact [m], and the tool's direction.

    The contact is the contact with the undeformed body.
    """
    assert isinstance(scene.tool, Probe)
    motion = motion_of(scene)
    corners = motion.sweep_m()
    axis = motion.rotations()[0][:, 2]
    radius_m = 0.5e-3 * scene.tool.size_mm
    along = np.linspace(0.0, arc_length(corners)[-1], POSES)
    surface = solver.body.nodes_m[np.unique(solver.body.space.faces)]
    away, _ = KDTree(surface).query(points_along(corners, along) + radius_m * axis)
    touching = along[away < radius_m]
    # the path stays outside of the undeformed organ
    if not len(touching):
        return np.empty((0, 3)), -axis
    # the middle of each of the equal parts
    chosen = touching[((np.arange(INSTANTS) + 0.5) / INSTANTS * len(touching)).astype(int)]
    return points_along(corners, chosen), -axis


def _pressed(
    solver: "NewtonSolver", *, tips_m: Array, direction: Array, radius_m: float
) -> tuple[Array, Array]:
    """Compute the force on the ball [N] and its depth [m] at each position of the tip.

    The result is NaN where a solve does not converge.
    """
    from tissue.fem.newton import press_at

    rows = []
    for tip in tips_m:
        solution, _, depth = press_at(
            solver, tip, direction, radius_m=radius_m, tolerance=TOLERANCE
        )
        rows.append([*(solution.tool_force_N if solution.converged else np.full(3, np.nan)), depth])
    # three components of force and a depth in each row; the shape is also right without rows
    table = np.array(rows).reshape(-1, 4)
    return table[:, :3], table[:, 3]


def linear_error(depth: float, law: str = LAW) -> float:
    """Return the error of the linear force on a ball against the force of a law.

    The error is a function of depth over radius. It is interpolated between the depths of
    `LINEAR_ERROR` or `EXPONENTIAL_ERROR`, from zero at rest, and extrapolated beyond the last one.
    """
    known = EXPONENTIAL_ERROR if law == CITED_LAW else LINEAR_ERROR
    depths, errors = np.array([(0.0, 0.0), *known]).T
    # a press deeper than the last one in the table has a larger error: the last slope is continued
    beyond = (errors[-1] - errors[-2]) / (depths[-1] - depths[-2]) * max(depth - depths[-1], 0.0)
    return np.interp(depth, depths, errors) + beyond


def with_law(scene: Scene, wanted: Fidelity) -> tuple[Scene, str]:
    """Return a scene with the law that its forces need, and the reason in words.

    The reason is empty if no change of the law was requested.

    Parameters
    ----------
    scene
        Scene whose tool a script moves. Other scenes keep their law.
    wanted
        Demanded fidelity.

    Raises
    ------
    InputError
        If ticks with the needed law take longer than demanded.
    """
    organ = scene.organ
    needed = _law_of_material(scene)
    # only a demanded error can need another law, and `LINEAR_ERROR` is known for balls only
    if (
        wanted.force_error is None
        or scene.device is not None
        or organ.law not in ("linear", needed)
        or not _pressed_by_a_ball(scene)
    ):
        return scene, ""
    assert isinstance(scene.tool, Probe)
    depth = _largest_depth_mm(scene) / (0.5 * scene.tool.size_mm)
    error = linear_error(depth, needed)
    amount = f"{100.0 * error:.2g} % at a depth of {depth:.2g} ball radii"
    of_linear = f"the force error of the linear law is {amount}"
    if error <= wanted.force_error:
        return (
            changed(scene, {"organ.law": "linear"}),
            f"; organ.law = linear: its force error against the {needed} law is {amount}",
        )
    if organ.law == needed:
        return scene, f"; organ.law = {needed}: {of_linear}"
    if key := hindrance(organ):
        return (
            scene,
            f"; the linear law is kept, because organ.{key} excludes other laws: {of_linear}",
        )
    lawful = changed(scene, {"organ.law": needed})
    why = f"; organ.law = {needed}: {of_linear}"
    # the ticks of the chosen setting were measured with the linear law
    if wanted.tick_ms is not None:
        run = simulate(lawful)
        tick_ms = 1e-3 * float(
            # 99 %, as in the measurements of settings
            np.percentile(run.timing["tick_us"][run.trace["contact_mm2"] > 0.0], 99)
        )
        if tick_ms > wanted.tick_ms:
            raise InputError(
                "fidelity",
                f"be reachable with a law of {scene.name} on this machine",
                f"force_error = {wanted.force_error:g}, tick_ms = {wanted.tick_ms:g}",
                (
                    f"raise one of both: {of_linear}, and organ.law = {needed} needs "
                    f"tick_ms = {tick_ms:.2g}"
                ),
            )
        why += f". With organ.law = {needed}, 99 % of the ticks take at most {tick_ms:.2g} ms"
    return lawful, why


def _law_of_material(scene: Scene) -> str:
    """Return the nonlinear law that fits a scene's material without further constants."""
    organ = scene.organ
    known = scene.constants.constants("soft", organ.material)
    return CITED_LAW if "exponential_rate" in known and organ.young_kPa is None else LAW


def _largest_depth_mm(scene: Scene) -> float:
    """Return the largest indentation by the script [mm], on the coarsest cells.

    The result is stored on disk.
    """
    coarse = changed(of_model(scene), settings_of(scene, quick=True)[0].changes)

    def make() -> Arrays:
        return {"depth_mm": simulate(coarse).trace["indentation_mm"].max(keepdims=True)}

    return cached_arrays("depth", (scene_text(coarse), sources()), make)["depth_mm"][0]
