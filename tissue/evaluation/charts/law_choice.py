"""Which elastic law the forces of an organ need: the linear one as long as the tool stays shallow."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError
from tissue.builders.organ_law import hindrance
from tissue.evaluation.charts.keys import scene_text, sources
from tissue.evaluation.charts.reference import of_model
from tissue.evaluation.charts.settings import settings_of
from tissue.models.organ.model import LINEAR_ERROR
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.simulate import simulate

__all__ = ["linear_error", "with_law"]

LAW = "neo-hookean"
"""The law that is taken, which needs no constants beside those of small strains."""


def linear_error(depth: float) -> float:
    """Share by which the linear force on a ball is off a neo-Hookean one, by depth over radius.

    Between the depths of `LINEAR_ERROR`, from none at rest, and beyond the last by the slope between the last two.
    """
    depths, errors = np.array([(0.0, 0.0), *LINEAR_ERROR]).T
    beyond = (errors[-1] - errors[-2]) / (depths[-1] - depths[-2]) * max(depth - depths[-1], 0.0)
    return float(np.interp(depth, depths, errors)) + float(beyond)


def with_law(scene: Scene, wanted: Fidelity) -> tuple[Scene, str]:
    """A scene at a setting, under the law that its forces need, and in words why; none where the law is known to do.

    Parameters
    ----------
    scene
        A scene that is moved by its script; others keep their law.
    wanted
        What is demanded.

    Raises
    ------
    InputError
        If the law that is needed takes longer ticks than are demanded.
    """
    organ, tool = scene.organ, scene.tool
    if wanted.force_error is None or scene.device is not None or not isinstance(scene.anatomy, SoftAnatomy):
        return scene, ""
    if organ.law != "linear" or not isinstance(tool, Probe) or tool.kind != "sphere-probe":
        return scene, ""
    depth = _greatest_depth_mm(scene) / (0.5 * tool.size_mm)
    error = linear_error(depth)
    if error <= wanted.force_error:
        return scene, f"; linear law, {100.0 * error:.2g} % off a neo-Hookean one {depth:.2g} radii deep"
    if key := hindrance(organ):
        return scene, (
            f"; the linear law is {100.0 * error:.2g} % off a neo-Hookean one {depth:.2g} radii deep, which "
            f"organ.{key} leaves as it is"
        )
    lawful = changed(scene, {"organ.law": LAW})
    why = f"; organ.law = {LAW}, for the linear one is {100.0 * error:.2g} % off {depth:.2g} radii deep"
    if wanted.tick_ms is not None:
        run = simulate(lawful)
        tick_ms = 1e-3 * float(np.percentile(run.timing["tick_us"][run.trace["contact_mm2"] > 0.0], 99))
        if tick_ms > wanted.tick_ms:
            raise InputError(
                f"fidelity must be met by a law of {scene.name} on this machine, got force_error = "
                f"{wanted.force_error:g}, tick_ms = {wanted.tick_ms:g}: the linear law is {100.0 * error:.2g} % off "
                f"{depth:.2g} radii deep, with organ.law = {LAW} tick_ms = {tick_ms:.2g}"
            )
        why += f", with which 99 % of the ticks take {tick_ms:.2g} ms"
    return lawful, why


def _greatest_depth_mm(scene: Scene) -> float:
    """How deep the tool presses on its script, on the coarsest cells; kept on disk."""
    coarse = changed(of_model(scene), settings_of(scene, quick=True)[0].changes)

    def make() -> dict[str, NDArray[np.generic]]:
        return {"depth_mm": simulate(coarse).trace["indentation_mm"].max(keepdims=True)}

    return float(np.asarray(cached_arrays("depth", (scene_text(coarse), sources()), make)["depth_mm"])[0])
