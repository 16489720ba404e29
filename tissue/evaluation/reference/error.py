"""How far a run's force is from the reference: over ticks, over 50 ms, and on average."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.progress import Progress
from tissue.evaluation.reference.force import Resolution
from tissue.evaluation.reference.history import ReferenceForce, reference_force
from tissue.scene.scene import Scene
from tissue.simulation.run import Run

__all__ = ["ForceError", "error_of_force", "error_to_reference", "means_over_50_ms"]

Array = NDArray[np.float64]
WINDOW_TICKS = 50
"""Ticks of a mean over 50 ms."""


@dataclass(frozen=True)
class ForceError:
    """Error of a force to the reference, all as shares.

    Attributes
    ----------
    over_ticks
        ||F - F_ref|| / ||F_ref|| over all ticks.
    over_50_ms
        The same of means over 50 ms.
    bias
        Mean over the contact of the error along the reference force, by the mean size of the reference force.
    reference_uncertainty
        The reference's own error, as `over_ticks`.
    """

    over_ticks: float
    over_50_ms: float
    bias: float
    reference_uncertainty: float


def error_to_reference(
    scene: Scene, run: Run, *, resolution: Resolution | None = None, progress: Progress | None = None
) -> ForceError:
    """Error of a run's cutting force, before any device, to the force of the exact geometry on the same motion.

    Raises
    ------
    InputError
        If the scene's anatomy comes from a file.
    """
    reference = reference_force(scene, run.trace, resolution=resolution, progress=progress)
    return error_of_force(run.trace.vectors("model_force", "N"), reference)


def error_of_force(force_N: Array, reference: ReferenceForce) -> ForceError:
    """Error of a force at every tick [N], shape (n, 3)."""
    wanted = reference.force_N
    size = np.linalg.norm(wanted, axis=1)
    contact = size > 0.0
    along = ((force_N - wanted)[contact] * wanted[contact]).sum(axis=1) / size[contact]
    return ForceError(
        _relative(force_N, wanted),
        _relative(means_over_50_ms(force_N), means_over_50_ms(wanted)),
        float(along.sum() / max(size.sum(), 1e-300)),
        reference.uncertainty,
    )


def _relative(values: Array, wanted: Array) -> float:
    """Norm of the difference by the norm of what is wanted."""
    return float(np.linalg.norm(values - wanted)) / max(float(np.linalg.norm(wanted)), 1e-300)


def means_over_50_ms(values: Array) -> Array:
    """Means over 50 ms, shape (n // 50, 3); of a shorter run, its mean."""
    count = max(len(values) // WINDOW_TICKS, 1)
    return np.array([part.mean(axis=0) for part in np.split(values[: count * WINDOW_TICKS], count)])
