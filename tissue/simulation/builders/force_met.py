"""Cheap estimate of the force along a scene's script, and the force scale chosen from it."""

from functools import lru_cache
from math import floor, log10, sqrt
from pathlib import Path

import numpy as np

from meshes.base.errors import is_file
from meshes.base.progress import silent
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.models.tissue_model import TICK_S, Response, TissueModel, ToolMotion
from tissue.motion.motion import Motion
from tissue.scene.organ import IncisedAnatomy, LayersAnatomy, SoftAnatomy
from tissue.scene.part import is_file_key
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene
from tissue.scene.tool import Blade, Needle, Probe, ThrustMotion, Tool
from tissue.simulation.builders.cutting import VoxelBone, cutter_of
from tissue.simulation.builders.organ_scene import blade_of, pierced_tissue
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.builders.voxels import volume_of

__all__ = ["chosen_scale", "cut", "fitted_scale", "incised", "pierced", "pressed", "slot_force_N"]

POSES = 250
FINE_POSES = 3000
"""Numbers of poses of the scripted motion at which the force is evaluated.

The first is for a cutter. The second is for a needle, which breaks through within tenths of a
millimetre. With four times as many poses, the largest force of the built-in scenes changes by less
than 0.2 %, but by 21 % in `milling`, whose peak at a corner is short.
"""
ACROSS = 8.0
"""Voxels across a cutter.

Up to 32 voxels the largest force of the built-in scenes changes by less than 4 %.
"""
ELEMENTS = 1500
"""Number of elements of a cutter.

From 400 to 6000, the largest force of the built-in scenes changes by at most 1 %.
"""
SLOT_VOXELS = 10
SLOT_M_S = 2e-3
"""Voxels across a cutter, and its feed [m/s], for the estimate of its usual force.

It only chooses a force scale of two digits. The feed is typical of milling by hand; assumed.
"""
MOST = 0.35
"""Upper bound of the script's largest scaled force, as a ratio to the device's force limit.

It is half of the share that is played without compression, so a hand may press twice as hard.
"""
LEAST = 4.0
"""Lower bound of the script's largest scaled force, over the device's friction; assumed.

It applies where the device's limit allows it.
"""


def chosen_scale(scene: Scene) -> tuple[float, str]:
    """Return the force scale (newtons at the device per newton at the tool) and a note on it.

    The scale is 1 where the script's largest force lies between the bound set by friction and the
    bound set by the device's limit. Otherwise one factor of two digits brings the force to the
    nearer bound. The scale is also 1 without a device, or where no force is known before the run.

    Raises
    ------
    InputError
        If the scene's bone cannot be built.
    """
    if scene.device is None:
        return 1.0, ""
    given = scene.device.coupling.force_scale
    if given != "auto":
        return given, ""
    limits = device_parameters(scene.held.kind, scene.constants)
    force = _met(
        # Keys that do not change the force of the script.
        scene.model_dump_json(exclude={"seed", "duration_s", "device", "fidelity"}),
        (scene.constants.key, *_file_stamps(scene)),
    )
    if not force > 0.0:
        return 1.0, ""
    return fitted_scale(
        force, limits
    ), f", chosen for the {force:.3g} N that the script meets at most"


def fitted_scale(force_N: float, limits: DeviceParameters) -> float:
    """Return the two-digit scale that brings a force [N] between friction and force limit.

    Both are properties of the device.
    """
    low = LEAST * limits.friction_N / force_N
    high = MOST * limits.force_limit_N / force_N
    scale = min(max(1.0, low), high)
    digits = 1 - floor(log10(scale))
    # Rounded to nine digits first, so that 0.3 stays 0.3.
    return floor(round(scale * 10.0**digits, 9)) / 10.0**digits


def _file_stamps(scene: Scene) -> list[tuple[str, int, int]]:
    """Return name, time of change [ns] and size [bytes] of each file of the tissue and the path."""
    named = [
        value
        for part in (scene.anatomy, scene.motion, scene.tool)
        for key, value in part.model_dump().items()
        if is_file_key(key) and value
    ]
    found = [(name, Path(name).stat()) for name in named if is_file(Path(name))]
    return [(name, stat.st_mtime_ns, stat.st_size) for name, stat in found]


@lru_cache(maxsize=64)
def _met(table: str, _inputs: tuple[object, ...]) -> float:
    """Return the largest force on the scripted motion [N], with the scene's own constants.

    It is 0 where the force is not known.
    """
    scene = Scene.read_back(table)
    entry = ANATOMIES[scene.anatomy.kind]
    if entry.build is not None:
        return 0.0 if entry.force_N is None else float(entry.force_N(scene))
    if isinstance(scene.tool, Tool):
        return cut(scene)
    if isinstance(scene.tool, Needle):
        return pierced(scene)
    if isinstance(scene.tool, Blade):
        return incised(scene)
    return pressed(scene) if isinstance(scene.anatomy, SoftAnatomy) else 0.0


def cut(scene: Scene) -> float:
    """Return a cutter's largest force along the script in coarse voxels [N].

    For a tool that is pushed, it is the thrust.
    """
    assert isinstance(scene.tool, Tool)
    if isinstance(scene.motion, ThrustMotion):
        return scene.motion.thrust_N
    if scene.tool.spin_rpm == 0.0:
        return 0.0
    spacing_mm = max(scene.voxels.spacing_mm, scene.tool.diameter_mm / ACROSS)
    voxels = scene.voxels.model_copy(update={"spacing_mm": spacing_mm, "margin_mm": 0.0})
    coarse = scene.model_copy(update={"voxels": voxels})
    cutter = cutter_of(scene.tool)
    motion = motion_of(scene, step_s=TICK_S)
    volume = volume_of(coarse, cutter, motion, notes={}, report=silent)
    spacing_m = (cutter.cutting_area_m2 / ELEMENTS) ** 0.5
    bone = VoxelBone.stated(volume, coarse.cutting, coarse.constants)
    model = bone.model(cutter, removal=voxels.removal, shell_spacing_m=spacing_m)
    return _largest(motion, model, POSES)


def pressed(scene: Scene) -> float:
    """Return the force of a probe on a half space at the script's depth below the origin [N].

    It uses Hertz's law for a ball and Boussinesq's for the flat end of a cylinder. The modulus is
    the one of the stiffest tissue on the script, without a nodule. A probe of another shape gives
    0.
    """
    organ = scene.organ
    tool = scene.tool
    assert isinstance(tool, Probe)
    cited = scene.constants.constants("soft", organ.material)
    young = max(organ.young_kPa or cited["modulus_kPa"].value, organ.young_end_kPa or 0.0)
    ratio = cited["poisson_ratio"].value if organ.poisson_ratio is None else organ.poisson_ratio
    modulus = 1e3 * young / (1.0 - ratio**2)
    radius = 0.5e-3 * tool.size_mm
    depth = max(-float(motion_of(scene, step_s=TICK_S).sweep_m()[:, 2].min()), 0.0)
    if tool.kind == "sphere-probe":
        return float(4.0 / 3.0 * modulus * radius**0.5 * depth**1.5)
    return 2.0 * modulus * radius * depth if tool.kind == "cylinder-probe" else 0.0


def pierced(scene: Scene) -> float:
    """Return the largest force of a needle on the scripted motion [N]."""
    from tissue.models.needle.model import NeedleModel

    assert isinstance(scene.tool, Needle) and isinstance(scene.anatomy, LayersAnatomy)
    tissue = pierced_tissue(scene)
    motion = motion_of(scene, step_s=TICK_S)
    return _largest(
        motion, NeedleModel(tissue, diameter_m=1e-3 * scene.tool.diameter_mm), FINE_POSES
    )


def incised(scene: Scene) -> float:
    """Return the largest force of a blade on the scripted motion [N]."""
    from tissue.models.incision.model import IncisionModel
    from tissue.models.incision.parameters import incised_tissue

    assert isinstance(scene.anatomy, IncisedAnatomy)
    blade = blade_of(scene)
    tissue = incised_tissue(scene.anatomy.material, blade, constants=scene.constants)
    motion = motion_of(scene, step_s=TICK_S)
    return _largest(motion, IncisionModel(tissue, blade), POSES)


def _largest(motion: Motion, tissue: TissueModel, poses: int) -> float:
    """Return a tissue's largest force at poses of a motion evenly spaced in time [N]."""
    tool = ToolMotion()
    response = Response.empty(len(tissue.layer_names))
    most = 0.0
    motion.begin(tool)
    tissue.place(tool)
    for time_s in np.linspace(0.0, motion.duration_s, poses).tolist():
        motion.advance(time_s, TICK_S, response, tool)
        tissue.advance(tool)
        force = tissue.respond(tool).wrench[:3]
        most = max(most, sqrt(force.dot(force)))
    return most


def slot_force_N(bone: VoxelBone, tool: Cutter) -> float:
    """Compute the force of a cutter in a typical slot in a bone's first layer [N].

    The slot is a quarter of the cutter's diameter deep, at a feed of 2 mm/s.
    """
    width_m = 2.0 * tool.profile.radius_m
    spacing_m = width_m / SLOT_VOXELS
    shape = 3 * SLOT_VOXELS, 2 * SLOT_VOXELS, SLOT_VOXELS
    coefficients = bone.coefficients[0]
    volume = VoxelVolume(
        -spacing_m * np.array([1.5 * SLOT_VOXELS, SLOT_VOXELS, SLOT_VOXELS]),
        spacing_m,
        np.full(shape, FULL, dtype=np.uint8),
        np.zeros(shape, dtype=np.uint8),
        np.full(shape, round(coefficients.reference_density_kg_m3), dtype=np.uint16),
        bone.store.grid.layer_names[:1],
    )
    model = VoxelBone(volume, (coefficients,)).model(tool)
    motion = ToolMotion(speed_m_s=SLOT_M_S)
    motion.heading[0, 0] = 1.0
    motion.tip_m[:] = -0.5 * width_m, 0.0, -0.25 * width_m
    model.place(motion)
    motion.tip_m[0] = 0.0
    model.advance(motion)
    return float(np.linalg.norm(model.respond(motion).wrench[:3]))
