"""What the forces of a scene are held to: the exact geometry where it is known, else the finest of three grids.

How well the exact one is known is its own uncertainty; of the finest grid it is the grid-convergence index, which
bounds the error of the discretisation and none that all grids share.
"""

from importlib.metadata import version

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
from tissue.simulation.reference_force import ideal_force_N, played_force_N
from tissue.simulation.run import Run
from tissue.simulation.simulate import simulate

__all__ = ["force_and_reference_N", "grid_force_N", "of_model", "reference_gap", "reference_words"]


def of_model(scene: Scene) -> Scene:
    """The same scene moved by its script, without all that no script depends on."""
    return changed(scene, {"device": "none"})


def grid_force_N(scene: Scene, changes: Changes) -> Array:
    """Force on the tool over time by a scene's own model [N], shape (n, 3), kept on disk."""
    at = changed(of_model(scene), changes)
    forces = cached_arrays(
        "grid-force",
        (scene_text(at), sources(), version("warp-lang")),
        lambda: {"force_N": simulate(at).trace.vectors("model_force", "N")},
    )
    return np.asarray(forces["force_N"], dtype=np.float64)


def force_and_reference_N(run: Run, scene: Scene, *, quick: bool) -> tuple[Array, Array]:
    """Force of a run of a scene at some setting, and the one that it is held to on the same motion, each shape (n, 3).

    By hand what is played is held to a prompt loop with the finest model.
    """
    if scene.device is not None:
        return played_force_N(run.trace), ideal_force_N(run, finest(scene, quick=quick))
    force = run.trace.vectors("model_force", "N")
    if has_exact_geometry(scene):
        return force, reference_force(scene, run.trace).force_N
    return force, grid_force_N(scene, finest(scene, quick=quick))


def reference_gap(scene: Scene, *, quick: bool, by_hand: bool = False) -> float:
    """What the reference of a scene that is moved by its script leaves open: below it no difference is resolved.

    The uncertainty of the exact geometry's force; by hand, where runs are held to the finest grid, that grid's error.
    Where no exact geometry is known, the grid-convergence index of the finest grid.
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
    """What a scene's forces are held to, and what that leaves open."""
    model, percent = of_model(scene), f"{100.0 * gap:.2g} %"
    exact, by_hand = has_exact_geometry(model), scene.device is not None
    if exact and not by_hand:
        return f"the exact geometry (known to {percent})"
    if not grids(model, quick=True):
        return "a prompt loop with the model, which has no grid" if by_hand else "the model itself, which has no grid"
    grid = "a prompt loop with the finest grid" if by_hand else "the finest of three grids"
    if exact:
        return f"{grid} ({percent} off the exact geometry)"
    return f"{grid} (grid-convergence index {percent}, of the discretisation alone)"
