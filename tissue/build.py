"""Turn a scene's names into parts: the registry of tools, motions and tissues."""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import pi, radians
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.errors import InputError
from meshes.volume import VoxelVolume
from tissue import cutters
from tissue.anatomies import volume_of, whole_tooth
from tissue.cutters import Cutter
from tissue.materials import cutting_coefficients, cutting_constants
from tissue.model import TissueModel
from tissue.motion import FollowPath, Motion, PushAlongAxis
from tissue.poses import read_poses
from tissue.reach import require_outside, require_touch
from tissue.scene import PathMotion, ReplayMotion, Scene, Stress, ThrustMotion, Tool
from tissue.scene_anatomy import MolarAnatomy

if TYPE_CHECKING:
    from tissue.bone import BoneModel

__all__ = ["Parts", "build", "cutter_of", "motion_of"]

Tell = Callable[[str, float], None]


CUT_AS = {"enamel": "enamel", "dentin": "dentin", "caries": "dentin", "pulp": "soft", "ligament": "soft"}
"""Material whose cutting coefficients a layer has; all others are bone."""


@dataclass
class Parts:
    """What a run is made of."""

    motion: Motion
    cutter: Cutter
    volume: VoxelVolume
    tissue: TissueModel
    notes: dict[str, str] = field(default_factory=dict)


def build(scene: Scene, *, step_s: float, compute: str, cores: int | None, tell: Tell) -> Parts:
    """Build the parts of a scene.

    Raises
    ------
    InputError
        If a file cannot be used, the voxels would not fit memory, the tool never touches, or there is no such device.
    """
    cutter, motion = cutter_of(scene.tool), motion_of(scene, step_s=step_s)
    notes: dict[str, str] = {}
    tell("building the anatomy", 0.0)
    volume = volume_of(scene, cutter, motion, notes=notes, tell=tell)
    require_touch(volume, cutter, motion)
    if isinstance(scene.anatomy, MolarAnatomy) and not isinstance(scene.motion, ReplayMotion):
        require_outside(volume, cutter, motion)
    notes["specific cutting energy"] = _energy_note(volume)
    return Parts(motion, cutter, volume, _bone(scene, volume, cutter, compute=compute, cores=cores, tell=tell), notes)


def cutter_of(tool: Tool) -> Cutter:
    """The cutter that a scene's tool describes."""
    d, peg = tool.diameter_mm * 1e-3, (tool.peg_diameter_mm * 1e-3, tool.peg_length_mm * 1e-3)
    match tool.kind:
        case "ball-burr":
            profile = cutters.ball_burr(diameter_m=d)
        case "pear-bur":
            profile = cutters.pear_bur(diameter_m=d, length_m=tool.length_mm * 1e-3)
        case "cylinder":
            profile = cutters.cylinder(diameter_m=d, length_m=tool.length_mm * 1e-3)
        case "twist-drill":
            angle = radians(tool.point_angle_deg)
            profile = cutters.twist_drill(diameter_m=d, length_m=tool.length_mm * 1e-3, point_angle_rad=angle)
        case "hemispherical-reamer":
            profile = cutters.hemispherical_reamer(diameter_m=d, peg_diameter_m=peg[0], peg_length_m=peg[1])
        case "flat-reamer":
            thickness = tool.length_mm * 1e-3
            profile = cutters.flat_reamer(
                diameter_m=d, thickness_m=thickness, peg_diameter_m=peg[0], peg_length_m=peg[1]
            )
    return Cutter(profile, tool.flutes, tool.spin_rpm * 2.0 * pi / 60.0)


def motion_of(scene: Scene, *, step_s: float) -> Motion:
    """The motion that a scene describes."""
    match scene.motion:
        case PathMotion() as path:
            return FollowPath(np.array(path.points_mm) * 1e-3, feed_m_s=path.feed_mm_s * 1e-3, axis=path.axis)
        case ThrustMotion() as push:
            return PushAlongAxis(
                np.array(push.start_mm) * 1e-3,
                axis=push.axis,
                thrust_N=push.thrust_N,
                mass_kg=push.mass_kg,
                max_feed_m_s=push.max_feed_mm_s * 1e-3,
                depth_m=push.depth_mm * 1e-3,
            )
        case ReplayMotion() as replay:
            return read_poses(Path(replay.file), step_s=step_s)


def _bone(
    scene: Scene, volume: VoxelVolume, cutter: Cutter, *, compute: str, cores: int | None, tell: Tell
) -> TissueModel:
    """The bone model; loading it compiles its kernels where their cache is cold."""
    import warp as wp

    if compute != "cpu" and compute not in [str(device) for device in wp.get_devices()]:
        raise InputError(
            f"compute must be one of {', '.join(str(d) for d in wp.get_devices())}, got {compute}: use cpu here"
        )
    tell("compiling kernels (the first time on a machine)", 0.0)
    from tissue.bone import BoneModel

    changes = scene.cutting.model_dump()
    spacing_mm = scene.tool.shell_spacing_mm
    milling = BoneModel(
        volume,
        cutter,
        tuple(cutting_coefficients(CUT_AS.get(name, "bone"), **changes) for name in volume.layer_names),
        removal=scene.voxels.removal,
        shell_spacing_m=None if spacing_mm is None else spacing_mm * 1e-3,
        device=compute,
        cores=cores,
    )
    if "pulp" not in volume.layer_names:
        return milling
    return _tooth(scene, milling, compute=compute, tell=tell)


def _energy_note(volume: VoxelVolume) -> str:
    """The cited tangential chip coefficient of each material that is there, which is its specific energy."""
    there = {CUT_AS.get(name, "bone") for i, name in enumerate(volume.layer_names) if (volume.layer == i).any()}
    said = []
    for material in sorted(there):
        energy = cutting_constants(material)["tangential_chip_N_mm2"]
        said.append(
            f"{material} {1e-3 * energy.value:g} ({1e-3 * energy.low:g}-{1e-3 * energy.high:g}) J/mm3, "
            f"confidence {energy.confidence}"
        )
    return "; ".join(said)


def _tooth(scene: Scene, milling: "BoneModel", *, compute: str, tell: Tell) -> TissueModel:
    """The tooth around the milled voxels, with its stress where the scene asks for it."""
    from tissue.tooth import beside
    from tissue.tooth.model import ToothModel
    from tissue.tooth.warmth import Warmth

    anatomy = scene.anatomy
    if not isinstance(anatomy, MolarAnatomy) or not (scene.stress or scene.heat):
        return ToothModel(milling, device=compute)
    stress = scene.stress or Stress()
    tell("assembling the tooth's stiffness", 0.0)
    cell_m = stress.cell_mm * 1e-3
    whole = whole_tooth(scene, spacing_m=0.5 * cell_m)
    field = None
    if scene.stress is not None:
        field = beside.StressProcess(
            whole,
            milling.store,
            cell_m=cell_m,
            ligament_thickness_m=anatomy.ligament_thickness_mm * 1e-3,
            device=compute,
            cores=1,  # the ticks want a core of their own
        )
    warmth = Warmth(whole, reach_m=0.5e-3 * scene.tool.diameter_mm, device=compute) if scene.heat else None
    interval_s = stress.interval_ms * 1e-3
    return ToothModel(milling, stress=field, interval_s=interval_s, warmth=warmth, device=compute)
