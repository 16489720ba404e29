"""Detection of a tool that leaves the simulated part of a bone."""

from math import ceil

import numpy as np

from meshes.base.arrays import Array, Flags
from meshes.shapes.sdf import Shape
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.models.tissue_model import TICK_S, StopsReporting, ToolMotion

MOST_POINTS = 1000
"""Largest number of points on the tool that are tested for tissue outside the region.

Without this limit a ball burr has 805 points. A drill of 30 mm has 7593 points; a test of all these
points takes 20 ms in the vertebra scene.
"""
POSES_TOGETHER = 500
"""Number of poses whose boxes are computed together.

With `MOST_POINTS`, an array then takes 12 MB.
"""


class RegionEnd:
    """Detector of a tool that leaves the simulated region of a tissue.

    The region contains the planned motion. A tool that is moved by a hand can leave the region at a
    place where the tissue continues. Outside the region there are no voxels and no forces, so later
    results are not valid.

    Parameters
    ----------
    volume
        Voxels of the region before any cut.
    cutter
        The tool.
    margin_mm
        Value of ``voxels.margin_mm`` in the scene, which the text of the event quotes.
    tissue
        The whole anatomy, in the frame of the region. If None, tissue at the border of the region
        is assumed to continue beyond the border.
    reporters
        Objects whose `stop_reporting` is called when the tool leaves the region.

    Attributes
    ----------
    left_tick
        Index of the tick in which the tool left the region. None if it has not left.
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
        points_m = cutter.coarse_surface_m()
        self._points_m = points_m[:: -(-len(points_m) // MOST_POINTS)]
        self._heights_m = np.ascontiguousarray(self._points_m[:, 2])
        self._radii_m = np.linalg.norm(self._points_m[:, :2], axis=1)
        # The outermost voxels do not count, because a voxel needs its neighbours on both sides.
        low_m = volume.origin_m + volume.spacing_m
        high_m = volume.origin_m + volume.spacing_m * (np.array(volume.shape) - 1.0)
        # Most faces of the region lie outside the tissue. The tool may cross these faces.
        if tissue is None:
            at_low, at_high = (
                np.array([volume.fraction.take(end, axis).max() > FULL // 2 for axis in range(3)])
                for end in (0, -1)
            )
        else:
            at_low = np.array(tissue.lower_m) < low_m
            at_high = np.array(tissue.upper_m) > high_m
        self._low_m = np.where(at_low, low_m, -np.inf)
        self._high_m = np.where(at_high, high_m, np.inf)

    @property
    def left_s(self) -> float | None:
        """Time at which the tool left the region [s]; None if it has not left."""
        return None if self.left_tick is None else self.left_tick * TICK_S

    def sufficient_margin_mm(self, tips_m: Array, axes: Array) -> float:
        """Return a value of ``voxels.margin_mm`` that makes the region large enough for a motion.

        The value is rounded up to 0.1 mm.

        Parameters
        ----------
        tips_m, axes
            Tip positions [m] and axis directions of the tool poses, each of shape (n, 3).
        """
        beyond_m = 0.0
        for start in range(0, len(tips_m), POSES_TOGETHER):
            poses = slice(start, start + POSES_TOGETHER)
            low, high = self._box(tips_m[poses], axes[poses])
            below_m = float((self._low_m - low).max())
            above_m = float((high - self._high_m).max())
            beyond_m = max(beyond_m, below_m, above_m)
        # 1e-9 mm: a value with one decimal must not be rounded up.
        return ceil(10.0 * (self._margin_mm + 1e3 * beyond_m - 1e-9)) / 10.0

    def check(self, tick: int, motion: ToolMotion) -> str:
        """Return a sentence if the tool leaves the region in this tick, else an empty string."""
        if self.left_tick is not None or not self._has_left(motion.tip_m, motion.rotation):
            return ""
        self.left_tick = tick
        for each in self._reporters:
            each.stop_reporting()
        return (
            "the tool left the simulated region, and there is tissue beyond it. Later forces and "
            "temperatures are not valid, and later break-throughs, exposures and breaches are not "
            f"reported. Use a voxels.margin_mm above {self._margin_mm:g}"
        )

    def _has_left(self, tip_m: Array, rotation: Array) -> bool:
        """Return True if a part of the tool's surface lies in tissue outside the region."""
        # A box around the tool is in the region at nearly every tick. This test takes about 20 us,
        # and the test of all points 0.1 to 2 ms.
        low, high = self._box(tip_m, rotation[:, 2])
        if (low >= self._low_m).all() and (high <= self._high_m).all():
            return False
        # Not a matrix product: BLAS would start threads in a tick.
        points = tip_m + np.einsum("nj,ij->ni", self._points_m, rotation)
        beyond = points[((points < self._low_m) | (points > self._high_m)).any(axis=1)]
        return bool(self._in_tissue(beyond).any())

    def _box(self, tip_m: Array, axis: Array) -> tuple[Array, Array]:
        """Return the lowest and highest corner [m] of a box that contains the tool.

        The box contains the circle that each point of the tool describes about the tool's axis. A
        box around the bounding cylinder would be larger, by up to 9.6 mm for the reamer of the
        scene ``glenoid`` with its axis along (0.6, 0, 0.8). Tip, axis and corners have the shape
        (3,) for one pose, and (n, 3) for several poses.
        """
        across = np.sqrt(np.maximum(1.0 - axis**2, 0.0))
        along_m = axis[..., None] * self._heights_m
        radius_m = across[..., None] * self._radii_m
        low_m = (along_m - radius_m).min(axis=-1)
        high_m = (along_m + radius_m).max(axis=-1)
        return tip_m + low_m, tip_m + high_m

    def _in_tissue(self, points_m: Array) -> Flags:
        """Return a mask of the points that lie in tissue, shape (n,)."""
        if self._tissue is None:
            at = np.floor((points_m - self._volume.origin_m) / self._volume.spacing_m).astype(int)
            at = np.clip(at, 0, np.array(self._volume.shape) - 1)
            return np.asarray(self._volume.fraction[tuple(at.T)] > FULL // 2)
        # A signed distance is expensive, and most points outside the box are in the air.
        near = (points_m >= self._tissue.lower_m) & (points_m <= self._tissue.upper_m)
        return np.asarray(self._tissue.distance(points_m[near.all(axis=1)]) < 0.0)
