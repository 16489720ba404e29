"""A log of a cut as a fit takes it."""

from collections.abc import Sequence

from meshes.base.errors import names_of_caller
from meshes.base.progress import Progress
from tissue.fitting.averaged import block_averages, block_ticks
from tissue.fitting.cutting import cutting_forward
from tissue.fitting.cutting_candidates import cutting_candidates
from tissue.fitting.log import MeasuredLog
from tissue.fitting.problem import Problem
from tissue.fitting.signs import require_signs
from tissue.models.tissue_model import TICK_S
from tissue.scene.scene import Scene

__all__ = ["cutting_problem"]

REFERENCE = "reference_density_kg_m3"
"""The density at which coefficients are stated."""


def cutting_problem(
    scene: Scene, log: MeasuredLog, free: Sequence[str], *, cores: int | None, progress: Progress
) -> Problem:
    """A cut through bone or a tooth; see `tissue.fitting.fit.fit_scene`."""
    progress("recording the geometry of the log", 0.0)
    with names_of_caller({"motion": "measured"}):
        forward = cutting_forward(
            scene, log.times_s, log.tips_m, log.quaternions_of(scene), free=free, cores=cores, progress=progress
        )
    ticks = block_ticks(float(log.load_times_s[-1] - log.load_times_s[0]), log.load_period_s)
    measured = block_averages(log.load_times_s, log.loads, log.channels, ticks)
    forward, measured = forward.averaged_as(measured)
    require_signs(forward, measured)
    layers = {each.name.split(".")[1] for each in forward.parameters if each.name.startswith("cutting.")}
    constants = {layer: scene.constants.layer_constants(layer, bone=scene.cutting.material) for layer in sorted(layers)}
    return Problem(
        forward,
        measured,
        ticks * TICK_S,
        lambda _: list(cutting_candidates(forward).items()),
        forward.notes,
        {f"cutting.{layer}.{REFERENCE}": known[REFERENCE].value for layer, known in constants.items()},
    )
