"""Bone or tooth for cutters: its coefficients, and voxels made at once or where a tool reaches."""

from collections.abc import Callable, Iterator

import numpy as np
import warp as wp

from kernels.bricks import FULL
from meshes.base.arrays import Array, Bytes
from meshes.base.errors import InputError
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.materials.constants import CuttingCoefficients
from tissue.materials.scene_constants import Materials
from tissue.models.bone.bricks import BrickStore
from tissue.models.bone.bricks_on_demand import Boxes, BricksOnDemand
from tissue.models.bone.model import BoneModel, Removal
from tissue.scene.scene import Cutting

__all__ = ["VoxelBone", "element_spacing_m", "tool_boxes"]

Pose = tuple[Array, Array]
"""Tip [m], shape (3,), and rotation from tool to world, shape (3, 3)."""
STRIDE_M = 1e-3
"""Largest distance between poses at which the bone is made ready [m]; chosen.

Poses are inserted between two given ones that are further apart.
"""
SAME = 1e-9
"""Largest difference between poses that count as equal [m]."""
SCATTER = 0.7
"""Largest relative error of the force of N elements in bone, times N ** 0.75.

The comparison with quadrature gave 0.57, for balls of 3 to 8 mm in slots 0.1 to 0.3 mm deep,
upright and tilted by up to 60 degrees. With the margin the error is 0.9 % where 1 % is requested.
"""
MARGIN_VOXELS = 4
"""Voxels around a tool that its carving and its force read."""
MOST_ELEMENTS = 1_000_000
"""Largest number of elements of a cutter.

They take about 1 GB, and a tenth of a second for each pose on one core.
"""


class VoxelBone:
    """Voxels with their materials, which several tools may cut in turn.

    Parameters
    ----------
    voxels
        A volume, whose bricks are all made now, or bricks that are made where a tool first reaches.
    coefficients
        Cutting coefficients of each layer, in their order.
    compute
        Warp device name.

    Attributes
    ----------
    store
        The bricks.
    coefficients
        Cutting coefficients of each layer.
    left_at
        Final pose of the last tool returned by `under`: tip [m] and rotation.
    """

    def __init__(
        self,
        voxels: VoxelVolume | BricksOnDemand,
        coefficients: tuple[CuttingCoefficients, ...],
        *,
        compute: str = "cpu",
    ) -> None:
        self._compute = compute
        self.coefficients = coefficients
        self.on_demand = voxels if isinstance(voxels, BricksOnDemand) else None
        self.store = (
            BrickStore.from_volume(voxels, device=compute)
            if isinstance(voxels, VoxelVolume)
            else voxels.store
        )
        self._was_cut = False
        self._last: BoneModel | None = None
        self.left_at: Pose | None = None

    @classmethod
    def stated(
        cls,
        voxels: VoxelVolume | BricksOnDemand,
        cutting: Cutting,
        constants: Materials,
        *,
        compute: str = "cpu",
    ) -> "VoxelBone":
        """Return bone with the cited coefficients of its layers, changed by a scene's table."""
        grid = voxels if isinstance(voxels, VoxelVolume) else voxels.store.grid
        changes = cutting.model_dump(exclude={"material"})
        coefficients = constants.coefficients(grid.layer_names, changes, bone=cutting.material)
        return cls(voxels, coefficients, compute=compute)

    def reach(self, boxes: Boxes) -> bool:
        """Make the bricks that boxes touch, given their corners [m].

        Returns whether models have to record their launches again.
        """
        return self.on_demand is not None and self.on_demand.make(boxes)

    @property
    def bounds_m(self) -> Array:
        """Lowest and highest corner of a box around the bone before any cut [m], shape (2, 3)."""
        if self.on_demand is not None:
            shape = self.on_demand.anatomy.shape
            return np.array([shape.lower_m, shape.upper_m])
        volume, _ = self.whole
        held = np.argwhere(volume.fraction)
        return np.asarray(
            volume.origin_m + volume.spacing_m * np.stack([held.min(axis=0), held.max(axis=0) + 1])
        )

    @property
    def whole(self) -> tuple[VoxelVolume, Bytes]:
        """Volume before any cut and the bone that is left of it (255 = full).

        It is available only when all voxels of the bone are made.
        """
        assert self.store.volume is not None
        return self.store.volume, self.store.fraction()

    def cut_parts(self) -> Iterator[tuple[VoxelVolume, Bytes]]:
        """Yield the parts that tools have cut, before any cut and now.

        It is available only for bone that is made where tools reach.
        """
        assert self.on_demand is not None
        return self.on_demand.cut_parts()

    @property
    def removed_m3(self) -> Array:
        """Volume that tools have removed from each layer so far [m3], shape (layers,)."""
        steps = self.store.start_steps - self.store.steps_by_layer()
        return np.asarray(steps * (self.store.grid.spacing_m**3 / FULL), dtype=np.float64)

    def under(
        self, cutter: Cutter, boxes: Boxes, start: Pose, *, shell_spacing_m: float | None = None
    ) -> tuple[BoneModel, bool]:
        """Return the bone under a cutter in boxes, and whether it continues from its last pose."""
        grown = self.reach(boxes)
        last = self._last
        if (
            last is not None
            and last.cutter == cutter
            and shell_spacing_m in (None, last.shell_spacing_m)
            and self.left_at is not None
            and all(
                np.allclose(a, b, rtol=0.0, atol=SAME)
                for a, b in zip(start, self.left_at, strict=True)
            )
        ):
            if grown:
                last.record()
            return last, True
        self._last = self.model(cutter, shell_spacing_m=shell_spacing_m)
        return self._last, False

    def around(
        self, cutter: Cutter, tip_m: Array, axis: Array, *, reach_m: float
    ) -> tuple[BoneModel, Callable[[Array], None]]:
        """Return the bone under a cutter, and a function that makes more of it as the tool moves.

        At first the bone is made as far as `reach_m` around the cutter. The function is called with
        the tip [m] before a tick.
        """
        made_at = tip_m.copy()

        def boxes(tip_m: Array) -> Boxes:
            """Return the boxes around a tip."""
            return tool_boxes(
                cutter,
                tip_m[None],
                axis[None],
                spacing_m=self.store.grid.spacing_m,
                around_m=reach_m,
            )

        self.reach(boxes(tip_m))
        model = self.model(cutter)

        def keep_ready(tip_m: Array) -> None:
            """Make more bone once half of the reach is used up; such a tick takes longer."""
            moved = tip_m - made_at
            # Half of the reach: the tool never meets bone that is not made.
            if moved.dot(moved) > (0.5 * reach_m) ** 2:
                made_at[:] = tip_m
                if self.reach(boxes(tip_m)):
                    model.record()

        return model, keep_ready

    def model(
        self,
        cutter: Cutter,
        *,
        removal: Removal = "subvoxel",
        shell_spacing_m: float | None = None,
        cores: int | None = None,
    ) -> BoneModel:
        """Return the bone under a cutter.

        Earlier removal is booked as older cuts.
        """
        store = self.store
        # Cuts of another tool are older cuts for this one.
        if self._was_cut:
            wp.copy(store.older, store.swept)
        self._was_cut = True
        return BoneModel(
            store,
            cutter,
            self.coefficients,
            removal=removal,
            shell_spacing_m=shell_spacing_m,
            device=self._compute,
            cores=cores,
        )


def _between(tips_m: Array, axes: Array, *, most_m: float) -> tuple[Array, Array]:
    """Insert poses on straight lines where poses are further apart than `most_m` [m]."""
    steps = np.linalg.norm(np.diff(tips_m, axis=0), axis=1)
    if not (steps > most_m).any():
        return tips_m, axes
    parts = np.maximum(np.ceil(steps / most_m), 1.0)
    at = np.concatenate([[0.0], np.cumsum(parts)])
    wanted = np.arange(int(at[-1]) + 1, dtype=np.float64)
    tips = np.column_stack([np.interp(wanted, at, column) for column in tips_m.T])
    turned = np.column_stack([np.interp(wanted, at, column) for column in axes.T])
    # 1e-12: the mean of two opposite axes vanishes.
    return tips, turned / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)


def tool_boxes(
    cutter: Cutter, tips_m: Array, axes: Array, *, spacing_m: float, around_m: float = 0.0
) -> Boxes:
    """Return boxes that a cutter reads and carves: corners [m], shape (n, 3) both.

    They cover the poses and the straight lines between them.

    Parameters
    ----------
    tips_m, axes
        Tips [m] and directions from tip to shank, shape (n, 3) both.
    spacing_m
        Edge of a voxel [m].
    around_m
        Additional margin around each box [m].
    """
    tips_m, axes = _between(tips_m, axes, most_m=STRIDE_M)
    low, high = cutter.profile.height_range_m
    aside = cutter.profile.radius_m * np.sqrt(np.clip(1.0 - axes**2, 0.0, 1.0))
    aside += MARGIN_VOXELS * spacing_m + around_m
    ends = low * axes, high * axes
    return tips_m + np.minimum(*ends) - aside, tips_m + np.maximum(*ends) + aside


def element_spacing_m(cutter: Cutter, *, depth_m: float, tolerance: float) -> float:
    """Return the element distance at which a cutter's force meets a tolerance [m].

    Parameters
    ----------
    depth_m
        Depth of the cut [m].
    tolerance
        Relative error of the force.

    Raises
    ------
    InputError
        If the cutter would have more than `MOST_ELEMENTS` elements.
    """
    # Solved for N: the error is SCATTER / N ** 0.75.
    wanted = (SCATTER / tolerance) ** (4.0 / 3.0)
    # a ball's cap engages with half of its area
    engaged_m2 = np.pi * cutter.profile.radius_m * min(depth_m, cutter.profile.radius_m)
    spacing_m = float(np.sqrt(engaged_m2 / wanted))
    count = cutter.cutting_area_m2 / spacing_m**2
    if count > MOST_ELEMENTS:
        raise InputError(
            f"depth_mm = {1e3 * depth_m:g} with tolerance = {tolerance:g} needs {count:.2g} "
            "elements on this cutter, "
            f"more than {MOST_ELEMENTS}. Use a larger tolerance or depth_mm."
        )
    return spacing_m
