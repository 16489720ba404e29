"""Build the bone or tooth that a cutter meets, as voxels."""

from math import pi, radians
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.errors import InputError
from meshes.base.progress import Progress, silent
from meshes.voxels.volume import VoxelVolume
from tissue.cutters import profile
from tissue.cutters.cutter import Cutter
from tissue.materials.constants import CUT_AS
from tissue.materials.scene_constants import energy_note
from tissue.models.tissue_model import TICK_S, TissueModel
from tissue.motion.motion import Motion
from tissue.scene.anatomy import MolarAnatomy, Tooth
from tissue.scene.part import is_given
from tissue.scene.registry import CUTTERS
from tissue.scene.scene import Scene, Stress, Voxels
from tissue.scene.tool import PathMotion, ReplayMotion, Tool
from tissue.simulation.builders.bone import VoxelBone
from tissue.simulation.builders.parts import Parts, motion_of, recorded_file
from tissue.simulation.builders.tool_path import (
    keep_clear,
    reach,
    require_outside,
    require_touch,
    w_first_notice,
)
from tissue.simulation.builders.voxels import structures, volume_of, whole_tooth

if TYPE_CHECKING:
    from tissue.haptics.proxy.probing_tool import ProbedBone
    from tissue.models.bone.model import BoneModel

__all__ = ["cutter_of", "milled", "milled_voxels", "milling_of"]


HEAT_CELL = 0.25
"""Edge of a tooth's temperature cells within the bur's reach, relative to that of the stress cells.

By default the temperature cells are 0.125 mm. The rise of the pulp in the molar scene is 0.614,
0.731 and 0.749 K with cells of 0.25, 0.125 and 0.083 mm.
"""
BONE_HEAT_CELLS = 16
BONE_HEAT_CELL_MM = 0.125, 0.5
"""Number of temperature cells of bone over the tool's diameter, and the limits of their edge [mm].

They are never smaller than the voxels. In cortical bone under a 4 mm drill, the largest rise at
0.5 mm from the wall is 4.78, 3.42 and 3.33 K with 8, 16 and 32 cells.
"""
SI = {"mm": ("m", 1e-3), "deg": ("rad", radians(1.0))}
"""SI units and conversion factors of the units in a scene's tool."""


def milled(
    scene: Scene,
    motion: Motion,
    *,
    step_s: float,
    compute: str,
    cores: int | None,
    report: Progress,
) -> Parts:
    """Return the parts of a scene in which a cutter meets voxels.

    Raises
    ------
    InputError
        If a file cannot be used, the voxels would not fit memory, the tool never touches, or it
        neither turns nor is held by a hand.
    """
    assert isinstance(scene.tool, Tool)
    cutter = cutter_of(scene.tool)
    notes = dict[str, str]()
    report("building the anatomy", 0.0)
    volume = volume_of(scene, cutter, motion, notes=notes, report=report)
    require_touch(volume, cutter, motion)
    if isinstance(scene.anatomy, Tooth) and not isinstance(scene.motion, ReplayMotion):
        require_outside(volume, cutter, motion)
    report("compiling kernels (the first time on a machine)", 0.0)
    tissue: TissueModel
    if cutter.spin_rad_s == 0.0:
        tissue = _probed(volume, cutter, motion, compute=compute)
        notes["tool"] = (
            "it does not turn: rigid contact, nothing is cut, no stress and no heat are computed"
        )
    else:
        _require_chips(scene, cutter)
        _require_effect(scene, volume)
        notes["specific cutting energy"] = energy_note(
            tuple(volume.layer_names[at] for at in np.unique(volume.layer)),
            scene.constants,
            bone=scene.cutting.material,
            stated=scene.cutting.tangential_chip_N_mm2,
        )
        spacing_mm = scene.tool.shell_spacing_mm
        spacing_m = None if spacing_mm is None else spacing_mm * 1e-3
        tissue = milling = milling_of(
            scene, volume, cutter, shell_spacing_m=spacing_m, compute=compute, cores=cores
        )
        if "pulp" in volume.layer_names:
            tissue = _tooth(scene, milling, motion, compute=compute, report=report)
        elif scene.heat:
            tissue = _heated_bone(scene, milling, motion, compute=compute, report=report)
    clear = None
    if scene.keep_clear is not None:
        clear = keep_clear(
            scene.keep_clear,
            structures(scene),
            cutter,
            motion,
            placement=volume.placement,
            notes=notes,
            report=report,
        )
    parts = Parts(
        motion,
        tissue,
        cutter=cutter,
        volume=volume,
        placement=volume.placement,
        notes=notes,
        keep_clear=clear,
    )
    file = recorded_file(scene)
    if file and (notice := w_first_notice(volume, cutter, motion, file)):
        parts.events.append((0.0, notice))
    return parts


def milled_voxels(scene: Scene) -> VoxelVolume:
    """Return the voxels of a milling scene before the first cut; raises as `milled`."""
    assert isinstance(scene.tool, Tool)
    return volume_of(
        scene, cutter_of(scene.tool), motion_of(scene, step_s=TICK_S), notes={}, report=silent
    )


def cutter_of(tool: Tool) -> Cutter:
    """Return the cutter that a scene's tool describes, in SI.

    A spin above 0 is clockwise as seen from the shank.
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
    """Refuse a stated feed at which a tooth's chip would be thicker than the tool's radius."""
    if scene.device is not None or not isinstance(scene.motion, PathMotion):
        return
    chip_mm = scene.motion.feed_mm_s * cutter.chip_per_speed_s
    radius_mm = 1e3 * cutter.profile.radius_m
    if chip_mm > radius_mm:
        raise InputError(
            "motion.feed_mm_s",
            f"leave a tooth chips thinner than the tool's radius of {radius_mm:.3g} mm",
            f"{scene.motion.feed_mm_s:g} which makes them {chip_mm:.3g} mm",
            "use a slower feed, or a higher tool.spin_rpm",
        )


def _require_effect(scene: Scene, volume: VoxelVolume) -> None:
    """Refuse keys that have no effect on the voxels that the tool can reach."""
    anatomy = scene.anatomy
    cutting = scene.cutting
    filled = volume.fraction > 0
    layers = {volume.layer_names[at] for at in np.unique(volume.layer[filled])}
    if is_given(cutting, "density_exponent"):
        cited = scene.constants.coefficients(volume.layer_names, {}, bone=cutting.material)
        reference = np.array([each.reference_density_kg_m3 for each in cited])
        if (volume.density_kg_m3[filled] == reference[volume.layer[filled]]).all():
            raise InputError(
                "cutting.density_exponent",
                "be left out where all that the tool can reach has the density of the coefficients",
                f"{cutting.density_exponent:g}",
                "set another coefficient such as cutting.tangential_chip_N_mm2, or remove it",
            )
    if is_given(cutting, "material") and layers <= set(CUT_AS):
        raise InputError(
            "cutting.material",
            "be left out where the tool reaches no bone, for layers of a tooth have their own",
            cutting.material,
            "set a coefficient such as cutting.tangential_chip_N_mm2, or remove it",
        )
    if (
        isinstance(anatomy, MolarAnatomy)
        and "ligament" not in layers
        and scene.stress is None
        and is_given(anatomy, "ligament_thickness_mm")
    ):
        raise InputError(
            "anatomy.ligament_thickness_mm",
            "be left out where the tool reaches no ligament and no stress is computed",
            f"{anatomy.ligament_thickness_mm:g}",
            "add [stress], or remove it",
        )


def _probed(volume: VoxelVolume, cutter: Cutter, motion: Motion, *, compute: str) -> "ProbedBone":
    """Return rigid bone that a hand feels with a tool that does not turn."""
    from tissue.haptics.hand_motion import HandMotion
    from tissue.haptics.proxy.probing_tool import ProbedBone, ProbingTool
    from tissue.haptics.proxy.proxy import ToolShell

    if not (isinstance(motion, HandMotion) and isinstance(motion.tool, ProbingTool)):
        raise InputError(
            "tool.spin_rpm",
            "not be 0 without a device, because a tool that does not turn cuts nothing and a "
            "motion that is given would push it through the bone",
            "0",
            "use 500, or device = touch",
        )
    shell = ToolShell.of_cutter(cutter)
    return ProbedBone(
        volume, shell, area_m2=cutter.cutting_area_m2, tool=motion.tool, device=compute
    )


def milling_of(
    scene: Scene,
    volume: VoxelVolume,
    cutter: Cutter,
    *,
    shell_spacing_m: float | None,
    compute: str = "cpu",
    cores: int | None = None,
) -> "BoneModel":
    """Return a cutter in voxels of a scene's materials.

    `shell_spacing_m` is the distance of the cutter's elements [m].
    """
    bone = VoxelBone.stated(volume, scene.cutting, scene.constants, compute=compute)
    return bone.model(
        cutter, removal=scene.voxels.removal, shell_spacing_m=shell_spacing_m, cores=cores
    )


def _tooth(
    scene: Scene, milling: "BoneModel", motion: Motion, *, compute: str, report: Progress
) -> TissueModel:
    """Return the tooth around the milled voxels, with its stress where the scene requests it."""
    from tissue.models.heat.cutting_heat import CuttingHeat
    from tissue.models.tooth import stress_process
    from tissue.models.tooth.model import ToothModel

    anatomy = scene.anatomy
    if not isinstance(anatomy, Tooth) or not (scene.stress or scene.heat):
        return ToothModel(milling, device=compute)
    stress = scene.stress or Stress()
    cell_m = stress.cell_mm * 1e-3
    field = None
    if scene.stress is not None:
        report("assembling the tooth's stiffness", 0.0)
        whole = whole_tooth(scene, spacing_m=0.5 * cell_m, report=report)
        field = stress_process.StressProcess(
            whole,
            milling.store,
            cell_m=cell_m,
            ligament_thickness_m=anatomy.ligament_thickness_mm * 1e-3,
            contact_m=milling.cutter.profile.radius_m,
            constants=scene.constants,
            device=compute,
            cores=1,  # the ticks need their own core
        )
    heat = None
    if scene.heat:
        report("building the grid of the temperature", 0.0)
        heat = CuttingHeat(
            whole_tooth(
                scene,
                spacing_m=max(HEAT_CELL * cell_m, milling.store.grid.spacing_m),
                report=report,
            ),
            milling,
            reach_m=reach(milling.cutter, motion, 0.0),
            constants=scene.constants,
            device=compute,
        )
    interval_s = stress.interval_ms * 1e-3
    return ToothModel(milling, stress=field, interval_s=interval_s, heat=heat, device=compute)


def _heated_bone(
    scene: Scene, milling: "BoneModel", motion: Motion, *, compute: str, report: Progress
) -> TissueModel:
    """Return milled bone with its temperature."""
    from tissue.models.heat.bone import HeatedBone
    from tissue.models.heat.cutting_heat import CuttingHeat

    report("building the grid of the temperature", 0.0)
    cutter = milling.cutter
    share = 2e3 * cutter.profile.radius_m / BONE_HEAT_CELLS
    spacing_mm = max(float(np.clip(share, *BONE_HEAT_CELL_MM)), scene.voxels.spacing_mm)
    voxels = Voxels(spacing_mm=spacing_mm, margin_mm=scene.voxels.margin_mm)
    coarse = scene.model_copy(update={"voxels": voxels})
    around = volume_of(coarse, cutter, motion, notes={}, report=report)
    heat = CuttingHeat(
        around,
        milling,
        reach_m=reach(cutter, motion, 0.0),
        constants=scene.constants,
        name="bone",
        device=compute,
    )
    return HeatedBone(milling, heat)
