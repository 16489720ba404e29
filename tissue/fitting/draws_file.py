"""Draws of a posterior as a table, and how good they are as numbers."""

from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.nuts import Draws
from tissue.fitting.target import Target
from tissue.system.outputs import write_columns

__all__ = ["draws_numbers", "write_draws"]


def write_draws(draws: Draws, target: Target, path: Path) -> None:
    """Write draws as CSV, one row each: chain, constants, offset, and bias and noise of each channel, in their units.

    Parameters
    ----------
    draws
        What was drawn.
    target
        From which density.
    path
        File to write.
    """
    chains, each, _ = draws.u.shape
    unpacked = [target.unpacked(u) for u in draws.together]
    columns: dict[str, Array] = {"chain": np.repeat(np.arange(1, chains + 1), each)}
    for at, parameter in enumerate(target.forward.parameters):
        columns[parameter.name] = parameter.prior.x(draws.together[:, at])
    columns["offset_s"] = np.array([one.offset_s for one in unpacked])
    for at, channel in enumerate(target.log.channels):
        columns[f"bias_{channel}"] = np.array([one.bias[at] for one in unpacked])
        columns[f"noise_scale_{channel}"] = np.array([one.scale[at] for one in unpacked])
        columns[f"noise_correlation_{channel}"] = np.array([one.correlation[at] for one in unpacked])
        columns[f"noise_freedom_{channel}"] = np.array([one.freedom[at] for one in unpacked])
    write_columns(path, columns)


def draws_numbers(draws: Draws, target: Target) -> dict[str, object]:
    """How many draws there are and how good, for programs."""
    names = [each.name for each in target.forward.parameters]
    return {
        "chains": len(draws.u),
        "draws": len(draws.together),
        "divergences": draws.divergences,
        "r_hat": float(np.max(draws.r_hat)),
        "effective": float(np.min(draws.effective)),
        "of_constants": {
            name: {"r_hat": float(r_hat), "effective": float(effective)}
            for name, r_hat, effective in zip(names, draws.r_hat, draws.effective, strict=False)
        },
    }
