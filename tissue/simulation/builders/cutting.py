"""Build the voxels of bone or tooth that a cutter removes: all at once, or near the tool."""

from collections.abc import Callable, Iterator
from math import pi, radians
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from kernels.bricks import FULL
from meshes.base.arrays import Array, Bytes
from meshes.base.errors import PRESENT, InputError
from meshes.base.progress import Progress, silent
from meshes.paths.toolpath import arc_length, points_along
from meshes.voxels.volume import VoxelVolume
from tissue.cutters import profile
from tissue.cutters.cutter import Cutter
from tissue.materials.constants import CUT_AS, CuttingCoefficients
from tissue.materials.scene_constants import Materials, energy_note
from tissue.models.bone.bricks import BrickStore
from tissue.models.bone.bricks_on_demand import Boxes, BricksOnDemand
from tissue.models.bone.model import BoneModel, Removal
from tissue.models.tissue_model import TissueModel
from tissue.motion.motion import Motion
from tissue.scene.anatomy import MolarAnatomy, Tooth
from tissue.scene.part import is_given
from tissue.scene.registry import CUTTERS
from tissue.scene.scene import Cutting, Scene
from tissue.scene.tool import PathMotion, ReplayMotion, Tool
from tissue.simulation.builders.keep_clear import watch
from tissue.simulation.builders.parts import (
    Parts,
    far_note,
    motion_of,
    recorded_file,
    require_outside,
    require_touch,
    w_first_notice,
)
from tissue.simulation.builders.voxels import volume_of

if TYPE_CHECKING:
    from tissue.haptics.proxy.probing_tool import ProbedBone

SI = {"mm": ("m", 1e-3), "deg": ("rad", radians(1.0))}
"""SI units and conversion factors, keyed by the units in the tool table of a scene."""
Pose = tuple[Array, Array]
"""Tip [m], shape (3,), and rotation from tool to world, shape (3, 3)."""
STRIDE_M = 1e-3
"""Largest distance between successive tool poses at which boxes of bone are made [m].

Poses are inserted between given poses that are farther apart. The value was chosen by judgement.
"""
POSE_TOLERANCE_M = 1e-9
"""Largest difference between two poses that count as equal [m]."""
SCATTER = 0.7
"""Largest relative error of the force of N cutting elements, multiplied by N ** 0.75.

A comparison with numerical quadrature gave 0.57. The comparison covers ball cutters of 3 to 8 mm
diameter in slots of 0.1 to 0.3 mm depth, with tilts of 0 to 60 degrees. The value 0.7 contains a
margin: for a requested error of 1 %, the measured error is 0.9 %.
"""
MARGIN_VOXELS = 4
"""Margin around a tool within which carving and force computation read voxels [voxels]."""
MOST_ELEMENTS = 1_000_000
"""Largest number of cutting elements of a cutter.

A million cutting elements take about 1 GB of memory, and 0.1 s for each pose on one core.
"""


def milled(
    scene: Scene,
    motion: Motion,
    *,
    step_s: float,
    compute: str,
    cores: int | None,
    report: Progress,
) -> Parts:
    """Build the objects that simulate a scene in which a cutter removes voxels of bone or tooth.

    Raises
    ------
    InputError
        If a file cannot be used, the voxels would not fit in memory, the tool never touches the
        bone, or the tool neither rotates nor is held by a hand.
    """
    assert isinstance(scene.tool, Tool)
    cutter = cutter_of(scene.tool)
    notes = dict[str, str]()
    report("building the anatomy", 0.0)
    volume = volume_of(scene, cutter, motion, notes=notes, report=report)
    require_touch(volume, cutter, motion)
    # A recorded tool may have started in contact. A note reports such a start; see
    # `w_first_notice`.
    if isinstance(scene.anatomy, Tooth) and not isinstance(scene.motion, ReplayMotion):
        require_outside(volume, cutter, motion)
    if isinstance(scene.motion, PathMotion) and (far := far_note(volume, scene.motion.points_mm)):
        notes["far path"] = far
    report("compiling kernels (the first time on a machine)", 0.0)
    tissue: TissueModel
    if cutter.spin_rad_s == 0.0:
        tissue = _probed(volume, cutter, motion, compute=compute)
        notes["tool"] = (
            "it does not turn: the contact is rigid, nothing is cut, and no stress and "
            "no heat are computed"
        )
    else:
        _require_chips(scene, cutter)
        # Names of the layers that have bone in the volume.
        layers = [volume.layer_names[at] for at in np.unique(volume.layer[volume.fraction > 0])]
        _require_effect(scene, volume, layers)
        notes.update(_replaced_note(scene, layers))
        notes["specific cutting energy"] = energy_note(
            tuple(volume.layer_names[at] for at in np.unique(volume.layer)),
            scene.constants,
            bone=scene.cutting.material,
            changes=scene.cutting.model_dump(exclude={"material"}),
        )
        spacing_mm = scene.tool.shell_spacing_mm
        spacing_m = None if spacing_mm is None else spacing_mm * 1e-3
        bone = VoxelBone.stated(volume, scene.cutting, scene.constants, compute=compute)
        tissue = milling = bone.model(
            cutter, removal=scene.voxels.removal, shell_spacing_m=spacing_m, cores=cores
        )
        if "pulp" in volume.layer_names:
            from tissue.simulation.builders.around_cut import tooth_around

            tissue = tooth_around(scene, milling, motion, compute=compute, report=report)
        elif scene.heat:
            from tissue.simulation.builders.around_cut import heated_bone

            tissue = heated_bone(scene, milling, motion, compute=compute, report=report)
    parts = Parts(
        motion,
        tissue,
        cutter=cutter,
        volume=volume,
        placement=volume.placement,
        notes=notes,
    )
    watch(scene, parts, report=report)
    file = recorded_file(scene)
    if file and (notice := w_first_notice(volume, cutter, motion, file)):
        parts.events.append((0.0, notice))
    return parts


def milled_voxels(scene: Scene) -> VoxelVolume:
    """Return the voxels of a milling scene before the first cut.

    The function raises the same errors as `milled`.
    """
    assert isinstance(scene.tool, Tool)
    return volume_of(scene, cutter_of(scene.tool), motion_of(scene), notes={}, report=silent)


def cutter_of(tool: Tool) -> Cutter:
    """Return the cutter that the tool table of a scene describes, in SI units.

    A positive spin is clockwise, seen from the shank.
    """
    sizes = {}
    entry = CUTTERS[tool.kind]
    for key in ("diameter_mm", *entry.keys):
        name, _, unit = key.rpartition("_")
        si, factor = SI[unit]
        value = getattr(tool, key)
        sizes[f"{name}_{si}"] = None if value is None else factor * value
    section = entry.profile or getattr(profile, tool.kind.replace("-", "_"))
    return Cutter(section(**sizes), tool.flutes, -tool.spin_rpm * 2.0 * pi / 60.0)


def _require_chips(scene: Scene, cutter: Cutter) -> None:
    """Raise an error if the feed makes chips that are thicker than the radius of the tool."""
    # Only for a path is the feed known before the run. Other runs report an event.
    if scene.device is not None or not isinstance(scene.motion, PathMotion):
        return
    chip_mm = scene.motion.feed_mm_s * cutter.chip_per_speed_s
    radius_mm = 1e3 * cutter.profile.radius_m
    if chip_mm > radius_mm:
        raise InputError(
            "motion.feed_mm_s",
            f"keep the chips of each tooth thinner than the tool's radius of {radius_mm:.3g} mm",
            f"{scene.motion.feed_mm_s:g}, which makes chips of {chip_mm:.3g} mm",
            "use a slower feed, or a higher tool.spin_rpm",
        )


def _replaced_note(scene: Scene, layers: list[str]) -> dict[str, str]:
    """Return a note if the scene's cutting keys apply to layers of different materials."""
    given = scene.cutting.model_dump(exclude={"material"}, exclude_none=True)
    cut_as = [CUT_AS.get(layer, scene.cutting.material) for layer in layers]
    if not given or len(set(cut_as)) < 2:
        return {}
    keys = ", ".join(f"cutting.{key}" for key in given)
    return {
        "cutting": f"the scene sets {keys} for all layers: {', '.join(layers)}. To change the "
        "layers of one material only, use a file of materials with a table such as "
        f"[cutting.{cut_as[0]}]"
    }


def _require_effect(scene: Scene, volume: VoxelVolume, layers: list[str]) -> None:
    """Raise an error for keys that have no effect on the voxels that the tool can reach."""
    anatomy = scene.anatomy
    cutting = scene.cutting
    if is_given(cutting, "density_exponent"):
        filled = volume.fraction > 0
        cited = scene.constants.coefficients(volume.layer_names, {}, bone=cutting.material)
        reference = np.array([each.reference_density_kg_m3 for each in cited])
        if (volume.density_kg_m3[filled] == reference[volume.layer[filled]]).all():
            raise InputError(
                "cutting.density_exponent",
                (
                    "be left out if all bone in reach of the tool has the reference density of "
                    "the coefficients"
                ),
                f"{cutting.density_exponent:g}",
                "set another coefficient such as cutting.tangential_chip_N_mm2, or remove "
                "cutting.density_exponent",
            )
    if is_given(cutting, "material") and set(layers) <= set(CUT_AS):
        raise InputError(
            "cutting.material",
            (
                "be left out if the tool reaches no bone, because the layers of a tooth "
                "have their own material"
            ),
            cutting.material,
            "set a coefficient such as cutting.tangential_chip_N_mm2, or remove cutting.material",
        )
    if (
        isinstance(anatomy, MolarAnatomy)
        and "ligament" not in layers
        and scene.stress is None
        and is_given(anatomy, "ligament_thickness_mm")
    ):
        raise InputError(
            "anatomy.ligament_thickness_mm",
            "be left out if the tool reaches no ligament and no stress is computed",
            f"{anatomy.ligament_thickness_mm:g}",
            "add [stress], or remove anatomy.ligament_thickness_mm",
        )


def _probed(volume: VoxelVolume, cutter: Cutter, motion: Motion, *, compute: str) -> "ProbedBone":
    """Return a model of rigid bone for a hand-held tool that does not rotate."""
    from tissue.haptics.hand_motion import HandMotion
    from tissue.haptics.proxy.probing_tool import ProbedBone, ProbingTool
    from tissue.haptics.proxy.proxy import ToolShell

    if not (isinstance(motion, HandMotion) and isinstance(motion.tool, ProbingTool)):
        raise InputError(
            "tool.spin_rpm",
            (
                "not be 0 without a device, because the given motion would push a tool "
                "that cuts nothing through the bone"
            ),
            PRESENT,
            "use a spin such as 500, or set device = touch",
        )
    shell = ToolShell.of_cutter(cutter)
    return ProbedBone(
        volume, shell, area_m2=cutter.cutting_area_m2, tool=motion.tool, device=compute
    )


class VoxelBone:
    """Voxels of bone with cutting coefficients, which several tools may cut one after another.

    Parameters
    ----------
    voxels
        Either a volume, whose bricks (blocks of 8 x 8 x 8 voxels) are all made at once, or a store
        that makes bricks only near a tool.
    coefficients
        Cutting coefficients of each layer, in the order of the layers.
    compute
        Warp device name.

    Attributes
    ----------
    store
        Store of the bricks.
    coefficients
        Cutting coefficients of each layer.
    left_at
        Pose at which the last cut ended: tip [m] and rotation.
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
        """Return bone whose layers have the cutting coefficients of `constants`.

        Coefficients that are given in the scene table `cutting` take precedence.
        """
        grid = voxels if isinstance(voxels, VoxelVolume) else voxels.store.grid
        changes = cutting.model_dump(exclude={"material"})
        coefficients = constants.coefficients(grid.layer_names, changes, bone=cutting.material)
        return cls(voxels, coefficients, compute=compute)

    def reach(self, boxes: Boxes) -> bool:
        """Make the missing bricks (blocks of 8 x 8 x 8 voxels) that the given boxes touch.

        The boxes are given by their corners [m]. The method returns True if recorded kernel
        launches of this bone's models are no longer valid.
        """
        return self.on_demand is not None and self.on_demand.make(boxes)

    @property
    def bounds_m(self) -> Array:
        """Lowest and highest corner of a box around the bone before any cut [m], shape (2, 3)."""
        if self.on_demand is not None:
            shape = self.on_demand.anatomy.shape
            return np.array([shape.lower_m, shape.upper_m])
        return np.array(self.whole[0].bone_bounds_m)

    @property
    def whole(self) -> tuple[VoxelVolume, Bytes]:
        """Volume before any cut, and the bone left in each voxel (255 = full).

        The property is available only if all voxels of the bone were made at once.
        """
        assert self.store.volume is not None
        return self.store.volume, self.store.fraction()

    def cut_parts(self) -> Iterator[tuple[VoxelVolume, Bytes]]:
        """Yield the parts of the bone that tools have cut.

        Each part is a pair: the volume before any cut, and the bone left in each voxel (255 =
        full).

        The method is available only if the voxels are made near the tool.
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
        """Return a model of the bone in some boxes, and True if the model continues the last cut.

        The model of the last cut is used again if the same cutter starts at the pose at which the
        last cut ended.
        """
        grown = self.reach(boxes)
        last = self._last
        if (
            last is not None
            and last.cutter == cutter
            and shell_spacing_m in (None, last.shell_spacing_m)
            and self.left_at is not None
            and all(
                np.allclose(a, b, rtol=0.0, atol=POSE_TOLERANCE_M)
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
        """Return a model of the bone, and a function that makes bricks as the tool moves.

        At first, the bricks within `reach_m` around the cutter are made. Call the function with the
        position of the tip [m] before each tick.
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
            """Make more bone when the tool has moved by half of the reach; such a call takes
            longer.
            """
            moved = tip_m - made_at
            # At half of the reach, the tool cannot yet be in bone that is not made.
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
        """Return a model of the bone under a cutter.

        Material that an earlier tool removed counts as removed before the current pass of the tool.
        """
        store = self.store
        if self._was_cut:
            wp.copy(store.middle, store.swept)
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


def _with_between(tips_m: Array, axes: Array, *, every_m: float) -> tuple[Array, Array]:
    """Return the given poses, followed by interpolated poses at equal distances [m]."""
    along = arc_length(tips_m)
    wanted = np.arange(0.0, along[-1], every_m)
    turned = np.column_stack([np.interp(wanted, along, column) for column in axes.T])
    # The mean of two opposite axes is zero, and 1e-12 avoids the division by zero.
    turned /= np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-12)
    return np.concatenate([tips_m, points_along(tips_m, wanted)]), np.concatenate([axes, turned])


def tool_boxes(
    cutter: Cutter, tips_m: Array, axes: Array, *, spacing_m: float, around_m: float = 0.0
) -> Boxes:
    """Return the boxes within which a cutter reads and carves voxels.

    The result is the lowest and the highest corner of each box [m], each of shape (n, 3).

    The boxes cover the cutter at the given poses and on the straight lines between successive
    poses.

    Parameters
    ----------
    tips_m, axes
        Tips [m] and directions from tip to shank, each of shape (n, 3).
    spacing_m
        Edge of a voxel [m].
    around_m
        Additional margin around each box [m].
    """
    tips_m, axes = _with_between(tips_m, axes, every_m=STRIDE_M)
    low, high = cutter.profile.height_range_m
    aside = cutter.profile.radius_m * np.sqrt(np.clip(1.0 - axes**2, 0.0, 1.0))
    aside += MARGIN_VOXELS * spacing_m + around_m
    ends = low * axes, high * axes
    return tips_m + np.minimum(*ends) - aside, tips_m + np.maximum(*ends) + aside


def element_spacing_m(cutter: Cutter, *, depth_m: float, tolerance: float) -> float:
    """Return the distance between cutting elements [m] at which the force error is `tolerance`.

    Parameters
    ----------
    depth_m
        Depth of the cut [m].
    tolerance
        Accepted relative error of the force.

    Raises
    ------
    InputError
        If the cutter would have more than `MOST_ELEMENTS` cutting elements.
    """
    # The equation error = SCATTER / N ** 0.75, solved for N.
    wanted = (SCATTER / tolerance) ** (4.0 / 3.0)
    # half of the area of a ball's cap is engaged
    engaged_m2 = np.pi * cutter.profile.radius_m * min(depth_m, cutter.profile.radius_m)
    spacing_m = float(np.sqrt(engaged_m2 / wanted))
    count = cutter.cutting_area_m2 / spacing_m**2
    if count > MOST_ELEMENTS:
        raise InputError(
            f"depth_mm = {1e3 * depth_m:g} with tolerance = {tolerance:g} needs "
            f"{count:.2g} cutting elements on this cutter, more than {MOST_ELEMENTS}. "
            "Use a larger tolerance or depth_mm."
        )
    return spacing_m
