"""Reference forces of a scene, by exact geometry if it is known, else by the finest of three grids.

The exact force has its own uncertainty. The uncertainty of the finest grid is the grid-convergence
index. It bounds the error of the discretisation, but not an error that all grids share.
"""

from importlib.metadata import version
from math import nan

import numpy as np

from meshes.base.arrays import Array
from meshes.base.cache import cached_arrays
from tissue.evaluation.charts.keys import scene_text, sources
from tissue.evaluation.charts.settings import Changes, finest, grids, shares
from tissue.evaluation.reference.grid_index import grid_index
from tissue.evaluation.reference.history import has_exact_geometry, reference_force
from tissue.evaluation.statistics.metrics import force_error
from tissue.scene.load import changed
from tissue.scene.scene import Scene
from tissue.scene.tool import PathMotion, Tool
from tissue.simulation.reference_force import ideal_force_N, played_force_N
from tissue.simulation.run import Run
from tissue.simulation.simulate import simulate

__all__ = [
    "float32_error",
    "force_and_reference_N",
    "grid_force_N",
    "of_model",
    "reference_gap",
    "reference_words",
]

LAST_PLACE_MM = float(np.spacing(np.float32(10.0)))
"""Last place of a float32 at 10 mm, the size of a path: 1 nm."""


def of_model(scene: Scene) -> Scene:
    """Return the scene moved by its script, without all that no script depends on."""
    return changed(scene, {"device": "none"})


def grid_force_N(scene: Scene, changes: Changes) -> Array:
    """Compute the force on the tool over time by the model of a scene [N], shape (n, 3).

    The result is kept on disk.
    """
    at = changed(of_model(scene), changes)
    forces = cached_arrays(
        "grid-force",
        (scene_text(at), sources(), version("warp-lang")),
        lambda: {"force_N": simulate(at).trace.vectors("model_force", "N")},
    )
    return np.asarray(forces["force_N"], dtype=np.float64)


def force_and_reference_N(run: Run, scene: Scene, *, quick: bool) -> tuple[Array, Array]:
    """Return the force of a run and its reference on the same motion, each shape (n, 3) [N].

    By hand it is the played force, and its reference is a loop without delay on the finest model.
    """
    if scene.device is not None:
        return played_force_N(run.trace), ideal_force_N(run, finest(scene, quick=quick))
    force = run.trace.vectors("model_force", "N")
    if has_exact_geometry(scene):
        return force, reference_force(scene, run.trace).force_N
    return force, grid_force_N(scene, finest(scene, quick=quick))


def reference_gap(scene: Scene, *, quick: bool, by_hand: bool = False) -> float:
    """Return the uncertainty of the reference: differences below it are not resolved.

    With an exact geometry it is the uncertainty of its force. By hand, the finest grid is the
    reference, and the uncertainty is the error of this grid. Without an exact geometry it is the
    grid-convergence index of the finest grid.
    """
    model = of_model(scene)
    if not has_exact_geometry(model):
        changes = grids(model, quick=quick)
        if not changes:
            return 0.0
        forces = [grid_force_N(model, each) for each in changes]
        return grid_index(forces, shares(model, quick=quick)).over_ticks.index[-1]
    run = simulate(changed(model, finest(model, quick=quick) if by_hand else {"stress": None}))
    exact = reference_force(model, run.trace)
    if not by_hand:
        return exact.uncertainty
    return force_error(run.trace.vectors("model_force", "N"), exact.force_N)


def reference_words(scene: Scene, gap: float) -> str:
    """Return the reference of a scene and its uncertainty in words."""
    model = of_model(scene)
    percent = f"{100.0 * gap:.2g} %"
    exact = has_exact_geometry(model)
    by_hand = scene.device is not None
    if exact and not by_hand:
        return f"the exact geometry (known to {percent})"
    if not grids(model, quick=True):
        return (
            "a prompt loop with the model, which has no grid"
            if by_hand
            else "the model itself, which has no grid"
        )
    grid = "a prompt loop with the finest grid" if by_hand else "the finest of three grids"
    if exact:
        return f"{grid} ({percent} off the exact geometry)"
    return f"{grid} (grid-convergence index {percent}, of the discretisation alone)"


def float32_error(scene: Scene) -> float:
    """Return the relative change of a cutting force for a path moved by a float32's last place.

    Voxels are cut in float32, which rounds all coordinates to about this length. If a tool only
    grazes voxels, the rounding decides whether it touches. The change is then much larger than the
    last place of a force. The result is NaN for models that compute in float64: organs, needles and
    walls.
    """
    motion = scene.motion
    if not isinstance(scene.tool, Tool) or not isinstance(motion, PathMotion):
        return nan
    path = tuple(
        (x + LAST_PLACE_MM, y - LAST_PLACE_MM, z - LAST_PLACE_MM) for x, y, z in motion.points_mm
    )
    shifted = scene.model_copy(update={"motion": motion.model_copy(update={"points_mm": path})})
    return force_error(
        grid_force_N(shifted, {"stress": None}), grid_force_N(scene, {"stress": None})
    )
