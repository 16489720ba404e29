"""What an enhancement costs in fidelity: how far its force is from plain scaling."""

import numpy as np

from tissue.simulation.trace import Table

__all__ = ["enhancement_cost"]


def enhancement_cost(trace: Table) -> dict[str, float]:
    """Fidelity cost of an enhanced run, at the device and before its range.

    Returns
    -------
    dict
        ``force_error``: ||F_enhanced - F|| / ||F|| over all ticks, F being the plain force; ``beside_a_gain``: the same
        against c F with the gain c that fits best, which is also returned as ``gain``. Zeros where nothing was touched.
    """
    plain, changed = trace.vectors("filtered_force", "N"), trace.vectors("enhanced_force", "N")
    size = float(np.linalg.norm(plain))
    if size == 0.0:
        return {"force_error": 0.0, "beside_a_gain": 0.0, "gain": 1.0}
    gain = float(np.sum(plain * changed)) / size**2
    return {
        "force_error": float(np.linalg.norm(changed - plain)) / size,
        "beside_a_gain": float(np.linalg.norm(changed - gain * plain)) / size,
        "gain": gain,
    }
