"""Where a tool came out of bone again ahead of it, and how far it plunged from there."""

from dataclasses import dataclass

import numpy as np

from meshes.voxels.volume import FULL, VoxelVolume
from tissue.models.tissue_model import TICK_S
from tissue.simulation.trace import Table

__all__ = ["BreakThrough", "break_throughs"]

FORWARD = 0.5
"""Least part of a tick's travel that must lead ahead along the tool's axis: a tool that leaves aside breaks nothing."""


@dataclass(frozen=True)
class BreakThrough:
    """The tip left the bone ahead of it.

    Attributes
    ----------
    time_s
        When.
    plunge_mm
        How far it went on from there along its axis, until the end or until it met bone again.
    """

    time_s: float
    plunge_mm: float


def break_throughs(volume: VoxelVolume, trace: Table) -> list[BreakThrough]:
    """Where the tip of a tool passed from the inside of the bone, as it was before any cut, to its outside ahead.

    The surface is where interpolated voxels are half full; its place along a tick is interpolated too.
    """
    from scipy.ndimage import map_coordinates

    tips = trace.vectors("tool", "mm")
    at = (1e-3 * tips - volume.origin_m) / volume.spacing_m - 0.5
    share = map_coordinates(volume.fraction, at.T, output=np.float32, order=1, mode="constant") / FULL
    x, y, z, w = (trace[f"tool_q{c}"] for c in "xyzw")
    axes = np.column_stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)])
    steps = np.diff(tips, axis=0)
    forward = -np.einsum("ij,ij->i", steps, axes[1:])
    travel = np.concatenate([[0.0], np.cumsum(forward)])
    leaves = (share[:-1] >= 0.5) & (share[1:] < 0.5) & (forward > FORWARD * np.linalg.norm(steps, axis=1))
    found = []
    for row in np.flatnonzero(leaves):
        part = float((share[row] - 0.5) / (share[row] - share[row + 1]))
        start = travel[row] + part * forward[row]
        again = np.flatnonzero(share[row + 1 :] >= 0.5)
        end = row + 1 + (int(again[0]) if len(again) else len(share))
        found.append(BreakThrough(float(row + part) * TICK_S, float(travel[row + 1 : end].max() - start)))
    return found
