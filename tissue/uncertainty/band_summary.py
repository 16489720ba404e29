"""What ``summary.json`` holds of a band beside its intervals: how it was made, of which constants, their indices."""

import numpy as np

from tissue.scene.scene import Scene
from tissue.simulation.run_summary import Summary
from tissue.uncertainty.figures import LOADS, Figure
from tissue.uncertainty.sample import Ranges
from tissue.uncertainty.sobol import SobolIndices

__all__ = ["about", "without"]

SAME_EVERYWHERE = (
    "does not vary with the constants: the path is given, so that the run's own figure holds in every sample"
)
NEEDS_RUNS = "depends on constants, and the loads alone were reweighed: it needs a run of each sample, --each-run"


def about(
    asked: int, seed: int, how: str, ranges: Ranges, indices: SobolIndices, figures: tuple[Figure, ...] = LOADS
) -> Summary:
    """How many samples were asked for, how the band was made, its constants, and their indices."""
    return {
        "asked": asked,
        "seed": seed,
        "how": how,
        "constants": _constants(ranges),
        "sobol": _indices(indices, ranges, figures),
    }


def without(scene: Scene) -> dict[str, str]:
    """What has no interval where loads are reweighed, and why."""
    names = ["removed_mm3", "contact_share"] + ["keep_clear"] * (scene.keep_clear is not None)
    found = dict.fromkeys([*names, "break_through", "events"], SAME_EVERYWHERE)
    if scene.heat:
        found |= dict.fromkeys(("greatest_pulp_rise_K", "events"), NEEDS_RUNS)
    if scene.stress is not None:
        found["stress"] = NEEDS_RUNS
    return found


def _constants(ranges: Ranges) -> dict[str, dict[str, float]]:
    return {
        name: {"value": prior.value, "low": prior.low, "high": prior.high}
        for name, prior in zip(ranges.names, ranges.priors, strict=True)
    }


def _indices(
    found: SobolIndices, ranges: Ranges, figures: tuple[Figure, ...]
) -> dict[str, dict[str, dict[str, object]]]:
    """Indices by figure and group; none of a figure that does not vary."""
    return {
        ".".join(figure): {
            group: {
                "first": float(found.first[row, column]),
                "first_90": found.first_ends[:, row, column].tolist(),
                "total": float(found.total[row, column]),
                "total_90": found.total_ends[:, row, column].tolist(),
            }
            for row, group in enumerate(ranges.group_names)
        }
        for column, figure in enumerate(figures)
        if np.isfinite(found.total[:, column]).all()
    }
