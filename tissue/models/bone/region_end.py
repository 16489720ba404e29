"""Detection of a tool that leaves the simulated part of a bone."""

import numpy as np

from meshes.base.arrays import Array, Flags
from meshes.shapes.sdf import Shape
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.models.tissue_model import StopsReporting, ToolMotion

__all__ = ["RegionEnd"]


class RegionEnd:
    """Watch on the end of the simulated region, beyond which voxels of the tissue are missing.

    The region is made around the scripted motion. A hand can leave this region within the tissue.
    The tool then meets no resistance, so that later results are not valid.

    Parameters
    ----------
    volume
        Voxels of the region before any cut.
    cutter
        The tool.
    margin_mm
        Value of ``voxels.margin_mm``, for the event.
    tissue
        The whole anatomy, in the frame of the region. If None, tissue at the end of the region is
        assumed to continue beyond it.
    reporters
        Objects that stop reporting when the tool has left the region.

    Attributes
    ----------
    left_tick
        Index of the tick in which the tool left the region; None before.
    """

    def __init__(
        self,
        volume: VoxelVolume,
        cutter: Cutter,
        *,
        margin_mm: float,
        tissue: Shape | None,
        reporters: tuple[StopsReporting, ...] = (),
    ) -> None:
        self.left_tick: int | None = None
        self._volume = volume
        self._margin_mm = margin_mm
        self._tissue = tissue
        self._reporters = reporters
        # `reach` uses the same distance for the region.
        self._points_m = cutter.shell(spacing_m=cutter.profile.radius_m / 8.0).points_m
        self._reach_m = float(np.linalg.norm(self._points_m, axis=1).max())
        # The outermost voxels do not count, because a voxel needs its neighbours on both sides.
        self._low_m = volume.origin_m + volume.spacing_m
        self._high_m = volume.origin_m + volume.spacing_m * (np.array(volume.shape) - 1.0)

    def check(self, tick: int, motion: ToolMotion) -> str:
        """Return an event in the tick in which the tool leaves the region, and "" otherwise."""
        if self.left_tick is not None or not self._has_left(motion.tip_m, motion.rotation):
            return ""
        self.left_tick = tick
        for each in self._reporters:
            each.stop_reporting()
        return (
            "the tool left the simulated region, and there is tissue beyond it. Later forces are "
            "not valid, and later break-throughs, exposures and breaches are not reported. "
            f"Use a voxels.margin_mm above {self._margin_mm:g}"
        )

    def _has_left(self, tip_m: Array, rotation: Array) -> bool:
        """Return whether a part of the cutting surface lies in tissue beyond the region."""
        inside = (tip_m - self._reach_m >= self._low_m) & (tip_m + self._reach_m <= self._high_m)
        if inside.all():
            return False
        points = tip_m + self._points_m @ rotation.T
        beyond = points[((points < self._low_m) | (points > self._high_m)).any(axis=1)]
        return bool(self._in_tissue(beyond).any())

    def _in_tissue(self, points_m: Array) -> Flags:
        """Return which points lie in tissue, shape (n,)."""
        if self._tissue is None:
            at = np.floor((points_m - self._volume.origin_m) / self._volume.spacing_m).astype(int)
            at = np.clip(at, 0, np.array(self._volume.shape) - 1)
            return np.asarray(self._volume.fraction[tuple(at.T)] > FULL // 2)
        # A signed distance is expensive, and most points outside the box are in the air.
        near = (points_m >= self._tissue.lower_m) & (points_m <= self._tissue.upper_m)
        return np.asarray(self._tissue.distance(points_m[near.all(axis=1)]) < 0.0)
