"""Error of the linear elastic law of an organ, and choice of a law for a demanded error."""

import numpy as np

from meshes.base.cache import Arrays, cached_arrays
from meshes.base.errors import InputError
from tissue.evaluation.charts.measure import of_model
from tissue.evaluation.charts.settings import scene_text, settings_of, sources
from tissue.models.organ.model import LINEAR_ERROR
from tissue.scene.coupling import Fidelity
from tissue.scene.load import changed
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Probe
from tissue.simulation.builders.organ import hindrance
from tissue.simulation.simulate import simulate

LAW = "neo-hookean"
"""Elastic law that replaces the linear law if the linear law is not accurate enough.

This law needs only the constants of linear elasticity.
"""
CITED_LAW = "exponential"
"""Elastic law that replaces the linear law if the exponential rate of the material is known."""
EXPONENTIAL_ERROR = ((0.1, 0.045), (0.2, 0.104), (0.3, 0.164), (0.5, 0.283), (0.75, 0.431))
"""Pairs of relative depth and relative error of the force by the linear elastic law.

The depth is the indentation by a ball, divided by the radius of the ball. The error is the
difference from the force of the exponential law, divided by this force.

The exponential law has a rate of 4.6, which was published for liver in compression. The layer of
tissue is ten radii thick (`tests/tissue/evaluation/test_law_choice.py`). On a layer of five radii,
the errors are 1.2 times as large. On a layer of 2.5 radii, they are 1.8 times as large.
"""


def _pressed_by_a_ball(scene: Scene) -> bool:
    """Return whether the tool of a scene is a spherical probe and its anatomy an organ."""
    tool = scene.tool
    return (
        isinstance(scene.anatomy, SoftAnatomy)
        and isinstance(tool, Probe)
        and tool.kind == "sphere-probe"
    )


def linear_error(depth: float, law: str = LAW) -> float:
    """Return the linear law's relative error of the force on a ball, compared with a nonlinear law.

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
    """Return a scene whose law satisfies a demanded force error, and the reason for this law.

    The reason is a text that is appended to a sentence. It is empty if this function keeps the law
    of the scene.

    Parameters
    ----------
    scene
        Scene. The law is chosen only if the scene's motion, not a hand, moves a spherical probe
        against an organ. Other scenes keep their law.
    wanted
        Demanded fidelity.

    Raises
    ------
    InputError
        If more than 1 % of the ticks with the needed law take longer than the demanded time.
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
                    f"raise one of these two values: {of_linear}, and organ.law = {needed} needs "
                    f"tick_ms = {tick_ms:.2g}"
                ),
            )
        why += f". With organ.law = {needed}, 99 % of the ticks take at most {tick_ms:.2g} ms"
    return lawful, why


def _law_of_material(scene: Scene) -> str:
    """Return the name of a nonlinear law whose constants are known for the scene's material."""
    organ = scene.organ
    known = scene.constants.constants("soft", organ.material)
    return CITED_LAW if "exponential_rate" in known and organ.young_kPa is None else LAW


def _largest_depth_mm(scene: Scene) -> float:
    """Return the largest indentation [mm] by the scripted tool, computed on the coarsest mesh.

    The result is stored on disk.
    """
    coarse = changed(of_model(scene), settings_of(scene, quick=True)[0].changes)

    def make() -> Arrays:
        return {"depth_mm": simulate(coarse).trace["indentation_mm"].max(keepdims=True)}

    return cached_arrays("depth", (scene_text(coarse), sources()), make)["depth_mm"][0]
