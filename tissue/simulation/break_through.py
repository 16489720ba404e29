"""Break-throughs: points where the tool left the bone ahead of it, and the plunge from there."""

from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.models.tissue_model import TICK_S
from tissue.simulation.trace import Table

__all__ = ["BreakThrough", "break_throughs"]

FORWARD = 0.5
"""Smallest share of a tick's travel along the tool's axis that counts as forward.

A tool that leaves the bone sideways breaks nothing.
"""


@dataclass(frozen=True)
class BreakThrough:
    """Break-through of the tool's tip.

    Attributes
    ----------
    time_s
        Time of the first break-through in this hole.
    plunge_mm
        Distance travelled along the axis after the break-through, until the run ended or the tool
        met bone again. It is the largest of all passes through the hole.
    """

    time_s: float
    plunge_mm: float


def break_throughs(volume: VoxelVolume, trace: Table, *, radius_m: float) -> list[BreakThrough]:
    """Return where the tool's tip passed from inside the uncut bone to the outside ahead.

    The surface is where interpolated voxels are half full. Its position within a tick is
    interpolated too. Each hole counts as one break-through. Bone counts as open wherever the tool
    has been before, within its radius of the axis and behind its tip.

    Parameters
    ----------
    volume
        The bone before any cut.
    trace
        Trace of the run.
    radius_m
        Radius of the tool [m].
    """
    from scipy.ndimage import map_coordinates

    tips = trace.vectors("tool", "mm")
    at = (1e-3 * tips - volume.origin_m) / volume.spacing_m - 0.5
    share = (
        map_coordinates(volume.fraction, at.T, output=np.float32, order=1, mode="constant") / FULL
    )
    x, y, z, w = (trace[f"tool_q{c}"] for c in "xyzw")
    axes = np.column_stack(
        [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)]
    )
    steps = np.diff(tips, axis=0)
    forward = -np.einsum("ij,ij->i", steps, axes[1:])
    travel = np.concatenate([[0.0], np.cumsum(forward)])
    leaves = (
        (share[:-1] >= 0.5)
        & (share[1:] < 0.5)
        & (forward > FORWARD * np.linalg.norm(steps, axis=1))
    )
    found: list[BreakThrough] = []
    exits_mm: list[Array] = []
    for row in np.flatnonzero(leaves):
        part = float((share[row] - 0.5) / (share[row] - share[row + 1]))
        exit_mm = tips[row] + part * steps[row]
        start = travel[row] + part * forward[row]
        again = np.flatnonzero(share[row + 1 :] >= 0.5)
        end = row + 1 + (int(again[0]) if len(again) else len(share))
        plunge_mm = float(travel[row + 1 : end].max() - start)
        if found and _was_there(
            exit_mm, tips[: row + 1], axes[: row + 1], radius_mm=1e3 * radius_m
        ):
            hole = int(np.argmin([np.linalg.norm(exit_mm - each) for each in exits_mm]))
            found[hole] = replace(found[hole], plunge_mm=max(found[hole].plunge_mm, plunge_mm))
            continue
        found.append(BreakThrough(float(row + part) * TICK_S, plunge_mm))
        exits_mm.append(exit_mm)
    return found


def _was_there(point_mm: Array, tips_mm: Array, axes: Array, *, radius_mm: float) -> bool:
    """Return whether a point lies in the space swept by a tool at one of some poses.

    That space lies within the tool's radius of its axis and behind its tip.
    """
    away = point_mm - tips_mm
    along = np.einsum("ij,ij->i", away, axes)
    across = np.linalg.norm(away - along[:, None] * axes, axis=1)
    return bool(((along > 0.0) & (across < radius_mm)).any())
