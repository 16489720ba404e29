"""Error of the linear elastic law of an organ, and choice of the law for a demanded fidelity.

`law_error` computes the static force on the tool by the linear and by the neo-Hookean law, at
several instants of the motion. Both solutions use the same mesh and no friction, so a difference is
caused only by the law.
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
"""Default law that replaces the linear law.

This law needs only the constants of linear elasticity.
"""
CITED_LAW = "exponential"
"""Law that replaces the linear law for a material with a published exponential rate."""
EXPONENTIAL_ERROR = ((0.1, 0.045), (0.2, 0.104), (0.3, 0.164), (0.5, 0.283), (0.75, 0.431))
"""Pairs of depth and relative error of the linear force.

The depth is the indentation by a ball, divided by the radius of the ball. The error is the
difference from the force of the exponential law, divided by this force.

The exponential law has a rate of 4.6, the published value of a compressed liver. The layer of
tissue is ten radii thick (`tests/tissue/evaluation/test_law_choice.py`). On a layer of five radii,
the errors are 1.2 times as large. On a layer of 2.5 radii, they are 1.8 times as large.
"""
INSTANTS = 4
"""Number of instants at which the contact is solved.

Each instant lies in the middle of one of four equal parts of the contact.

Each instant takes two nonlinear solves of about 5 s in liver-press.
"""
POSES = 400
"""Number of poses along the motion that are tested for contact.

On a path of 40 mm, the poses are 0.1 mm apart.
"""
COARSER = 1.4
"""Edge lengths of the mesh for the comparison, divided by the edge lengths of the scene's mesh.

With this ratio, the comparison of the scene liver-press takes 40 s on one core. That of a graded
slab with a nodule takes minutes, because the nodule needs short edges, and the graded stiffness
needs more iterations.
"""
TOLERANCE = 1e-4
"""Relative tolerance of a solve, and of the distance of a node in contact from the ball.

The distance is relative to the radius of the ball. The forces of the two laws differ by several per
cent, far more than this tolerance.
"""


@dataclass(frozen=True, eq=False)
class LawError:
    """Static forces on the tool by two elastic laws, at k instants of a motion.

    A force is NaN if its solve did not converge.

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
        """True for instants at which the solves of both laws converged, shape (k,)."""
        return np.asarray(np.isfinite(self.linear_N + self.neo_N).all(axis=1))

    @property
    def error(self) -> float:
        """||F_linear - F_neo|| / ||F_neo|| over the instants of `solved`; NaN if there are none."""
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
    """Compare the forces of the linear and of the neo-Hookean law on the motion of a scene.

    The result is stored on disk.

    The comparison needs a spherical probe that moves along a path into an organ. The organ must be
    isotropic, without weight and without a capsule. The result is None for other scenes.
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
    """Return whether the tool of a scene is a spherical probe and its anatomy an organ."""
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
    """Mesh a scene's organ with edges that are `COARSER` times as long as in the scene.

    In an anatomy with a nodule, and in tetrahedra from a file, only the edges near the path of the
    tool are made longer.
    """
    longer_mm = anatomy.edge_mm * (1.0 if anatomy.nodule_mm else COARSER)
    # The key must not count as set: tetrahedra from a file have their own edges.
    given = anatomy.model_fields_set - {"edge_mm"}
    coarse = type(anatomy).model_construct(given, **(dict(anatomy) | {"edge_mm": longer_mm}))
    path_m = motion_of(scene).sweep_m()
    touch_edge_m = COARSER * (1e-3 * edge_mm(scene))
    return held_mesh(coarse, path_m=path_m, touch_edge_m=touch_edge_m, report=silent)


def _touching(scene: Scene, solver: "NewtonSolver") -> tuple[Array, Array]:
    """Return tip positions [m] spread evenly over the contact, and the unit direction of pressing.

    These are poses along the path in which the ball overlaps the undeformed body.
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

    A force is NaN if its solve did not converge.
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
    """Return the relative error of the linear force on a ball against the force of a nonlinear law.

    ``depth`` is the indentation divided by the radius of the ball. The error is interpolated in the
    table `LINEAR_ERROR` or `EXPONENTIAL_ERROR`, and is zero at zero depth. Beyond the last depth of
    the table, the error is extrapolated linearly.
    """
    known = EXPONENTIAL_ERROR if law == CITED_LAW else LINEAR_ERROR
    depths, errors = np.array([(0.0, 0.0), *known]).T
    # a press deeper than the last one in the table has a larger error: the last slope is continued
    beyond = (errors[-1] - errors[-2]) / (depths[-1] - depths[-2]) * max(depth - depths[-1], 0.0)
    return np.interp(depth, depths, errors) + beyond


def with_law(scene: Scene, wanted: Fidelity) -> tuple[Scene, str]:
    """Return a scene with the elastic law that a demanded force error needs, and the reason.

    The reason is a text that continues a sentence. It is empty if the law was not chosen here.

    Parameters
    ----------
    scene
        Scene. The law is chosen only if a script moves a spherical probe against an organ. Other
        scenes keep their law.
    wanted
        Demanded fidelity.

    Raises
    ------
    InputError
        If 99 % of the ticks with the needed law do not stay within the demanded time.
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
    """Return the nonlinear law whose constants are all known for a scene's material."""
    organ = scene.organ
    known = scene.constants.constants("soft", organ.material)
    return CITED_LAW if "exponential_rate" in known and organ.young_kPa is None else LAW


def _largest_depth_mm(scene: Scene) -> float:
    """Return the largest indentation by the scripted motion [mm], computed on the coarsest mesh.

    The result is stored on disk.
    """
    coarse = changed(of_model(scene), settings_of(scene, quick=True)[0].changes)

    def make() -> Arrays:
        return {"depth_mm": simulate(coarse).trace["indentation_mm"].max(keepdims=True)}

    return cached_arrays("depth", (scene_text(coarse), sources()), make)["depth_mm"][0]
