"""Fast estimate of the force along a scene's scripted motion, and choice of the force scale."""

from functools import lru_cache
from math import floor, isfinite, log, log10, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np

from meshes.base.errors import is_file
from meshes.base.progress import silent
from meshes.voxels.volume import FULL, VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.haptics.device.device import DeviceParameters, device_parameters
from tissue.haptics.hand.hand import hand_parameters
from tissue.materials.scene_constants import Materials
from tissue.models.tissue_model import TICK_S, Response, TissueModel, ToolMotion
from tissue.motion.motion import Motion
from tissue.perception.laws import D_PRIME_75
from tissue.scene.coupling import WallAnatomy
from tissue.scene.organ import SoftAnatomy
from tissue.scene.part import is_file_key
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import Scene, without_fields
from tissue.scene.tool import Blade, Needle, Probe, ThrustMotion, Tool
from tissue.simulation.builders import organ_scene
from tissue.simulation.builders.cutting import VoxelBone, cutter_of
from tissue.simulation.builders.loop import USUAL_N_M
from tissue.simulation.builders.parts import motion_of
from tissue.simulation.builders.voxels import volume_of

POSES = 250
FINE_POSES = 3000
"""Number of poses of the scripted motion at which the force of a needle is evaluated.

The number for a cutter or a blade is `POSES`. A needle needs more poses, because it breaks through
a membrane within tenths of a millimetre. With four times as many poses, for needles and for
cutters, the largest force of the built-in scenes changes by less than 0.2 %. The exception is the
scene `milling`. Its force has a short peak at a corner, so the largest force changes by 21 %.
"""
ACROSS = 8.0
"""Number of voxels across the diameter of a cutter.

With up to 32 voxels across the diameter, the largest force of the built-in scenes differs by less
than 4 %.
"""
ELEMENTS = 1500
"""Number of cutting elements of a cutter.

Between 400 and 6000 cutting elements, the largest force of the built-in scenes changes by at most
1 %.
"""
SLOT_VOXELS = 10
SLOT_M_S = 2e-3
"""Feed for the estimate of the usual force of a cutter [m/s].

For this estimate, the cutter has `SLOT_VOXELS` voxels across its diameter.

The estimate is used only to choose a force scale with two digits. The value of the feed is assumed
to be typical of milling by hand.
"""
LARGEST_FORCE_RATIO = 0.35
"""Largest ratio of the scaled force along the scripted motion to the force limit of the device.

The device renders up to twice this force without compression, so a hand may press twice as hard.
"""
SMALLEST_FORCE_RATIO = 4.0
"""Smallest ratio of the largest scaled force to the friction of the device.

The largest scaled force is the maximum along the scripted motion. The value is assumed.

If the bounds `SMALLEST_FORCE_RATIO` and `LARGEST_FORCE_RATIO` contradict each other,
`LARGEST_FORCE_RATIO` takes precedence.
"""
STIFFER = 1.3
"""Ratio of the stiffnesses of two specimens for which the sensitivity d' is computed.

d' measures how well a person can distinguish the two specimens. The discrimination study uses the
same ratio.
"""
HELD_BY = "expert"
"""Expertise group of the hand for which a scale is chosen; this scale is used for all hands."""


class ExpectedForce(NamedTuple):
    """Force on the tool along a scene's scripted motion, and stiffness of a pressed tissue.

    Attributes
    ----------
    force_N
        Largest force along the scripted motion [N].
    stiffness_N_m
        Slope of the force as a function of the tool's depth, at the depth of the scripted motion
        [N/m]. The slope is 0 for a tissue that is cut or pierced. If the stiffness of the tissue
        varies along the scripted motion, the value is the geometric mean of the slopes at both
        ends.
    depth_m
        Force divided by slope, both at the depth of the scripted motion [m]. With Hertz's law, the
        result is two thirds of the depth of the scripted motion.
    """

    force_N: float
    stiffness_N_m: float = 0.0
    depth_m: float = 0.0


class Series(NamedTuple):
    """Compliance of coupling and hand in series, and a person's threshold for force changes.

    A hand aims to press a tissue of stiffness K to a depth D. The compliance of coupling (stiffness
    k) and hand (k_h) in series is s = 1/k + 1/k_h. With the force scale c, the force F at the
    device and its change dF for a change dK of the stiffness are::

        F = c K D / (1 + c K s),    dF / F = dK / K / (1 + c K s)

    A person notices force changes of at least kappa (F + F0). The low-force term F0 contains the
    friction of the device, because friction also hides forces. The sensitivity is therefore
    proportional to F / (F + F0) / (1 + c K s). The maximum is at c K = (F0 / s / (D + F0 s))^(1/2).
    At a smaller scale, the force is hidden by the friction and by the threshold of the person. At a
    larger scale, the force pushes the hand back.

    Attributes
    ----------
    compliance_m_N
        Compliance s of coupling and hand [m/N].
    threshold_N
        Low-force term F0 [N].
    weber
        Weber fraction kappa.
    """

    compliance_m_N: float
    threshold_N: float
    weber: float

    @classmethod
    def of(cls, limits: DeviceParameters, constants: Materials) -> "Series":
        """Return compliance and threshold for a device that a user of the group `HELD_BY` holds."""
        limit = limits.stiffness_limit_N_m
        stiffness = limit if isfinite(limit) else USUAL_N_M
        hand = hand_parameters(HELD_BY, constants).stiffness_N_m
        felt = constants.constants("perception", "force")
        return cls(
            1.0 / stiffness + 1.0 / hand,
            limits.friction_N + felt["offset_N"].value,
            felt["kappa"].value,
        )

    def best_scale(self, expected: ExpectedForce) -> float:
        """Return the scale with the largest sensitivity; 1 for a tissue whose stiffness is 0."""
        if not expected.stiffness_N_m > 0.0:
            return 1.0
        hidden_m = self.threshold_N * self.compliance_m_N
        felt = self.threshold_N / self.compliance_m_N / (expected.depth_m + hidden_m)
        return sqrt(felt) / expected.stiffness_N_m

    def sensitivity(self, expected: ExpectedForce, scale: float) -> float:
        """Return the sensitivity d' for two tissues with the stiffness ratio `STIFFER`."""
        stiffness = scale * expected.stiffness_N_m
        yielding = 1.0 + stiffness * self.compliance_m_N
        force_N = stiffness * expected.depth_m / yielding
        noticed_N = self.weber * (force_N + self.threshold_N)
        return D_PRIME_75 * log(STIFFER) / yielding * force_N / noticed_N


class ForceScale(NamedTuple):
    """Force scale, in newtons at the device per newton at the tool, and the reason for its choice.

    Attributes
    ----------
    factor
        Force scale.
    why
        Reason for the choice, as text that completes a sentence.
    d_prime
        Expected sensitivity d' for two tissues with the stiffness ratio `STIFFER`; None if it is
        not known.
    """

    factor: float
    why: str = ""
    d_prime: float | None = None


def chosen_scale(scene: Scene) -> ForceScale:
    """Return the force scale of a scene, or choose a scale if the scene gives none.

    The chosen scale is the one with the largest sensitivity (see `Series`). The scale is limited,
    so that the largest force on the scripted motion is above the friction of the device and well
    below the force limit of the device. The chosen scale has two digits. The scale is 1 if the
    scene has no device, or if no force is known before the run.

    Raises
    ------
    InputError
        If the scene's bone cannot be built.
    """
    if scene.device is None:
        return ForceScale(1.0)
    given = scene.device.coupling.force_scale
    if given != "auto":
        return ForceScale(given)
    limits = device_parameters(scene.held.kind, scene.constants)
    expected = expected_force(scene)
    if not expected.force_N > 0.0:
        return ForceScale(1.0)
    motion_scale = scene.device.coupling.motion_scale
    at_device = ExpectedForce(
        expected.force_N, motion_scale * expected.stiffness_N_m, expected.depth_m / motion_scale
    )
    series = Series.of(limits, scene.constants)
    factor = scale_for(at_device, limits, series)
    why = (
        f" (coupling.force_scale = auto, for a largest force of {expected.force_N:.3g} N on the "
        "scripted motion"
    )
    if not expected.stiffness_N_m > 0.0:
        return ForceScale(factor, f"{why})")
    d_prime = series.sensitivity(at_device, factor)
    why += (
        f"; expected sensitivity d′ to a tissue that is {STIFFER - 1.0:.0%} stiffer: {d_prime:.2g})"
    )
    return ForceScale(factor, why, d_prime)


def scale_for(expected: ExpectedForce, limits: DeviceParameters, series: Series) -> float:
    """Return the scale with the largest sensitivity, within two bounds.

    The bounds are `SMALLEST_FORCE_RATIO` and `LARGEST_FORCE_RATIO`. The scale is rounded down to
    two significant digits. The values in `expected` must be forces, slopes and depths at the device
    for a force scale of 1.
    """
    low = SMALLEST_FORCE_RATIO * limits.friction_N / expected.force_N
    high = LARGEST_FORCE_RATIO * limits.force_limit_N / expected.force_N
    scale = min(max(series.best_scale(expected), low), high)
    digits = 1 - floor(log10(scale))
    # The value is first rounded to nine digits, so that 0.3 stays 0.3.
    return floor(round(scale * 10.0**digits, 9)) / 10.0**digits


def expected_force(scene: Scene) -> ExpectedForce:
    """Return the force on the tool along the scripted motion of a scene.

    The force is 0 if it is not known.
    """
    return _expected_force(
        # These keys do not change the force on the scripted motion.
        scene.model_dump_json(exclude={"seed", "duration_s", "device", "fidelity"}),
        (scene.constants.key, *_file_stamps(scene)),
    )


def _file_stamps(scene: Scene) -> list[tuple[str, int, int]]:
    """Return name, time of change [ns] and size [bytes] of each anatomy, motion and tool file."""
    named = [
        value
        for part in (scene.anatomy, scene.motion, scene.tool)
        for key, value in part.model_dump().items()
        if is_file_key(key) and value
    ]
    found = [(name, Path(name).stat()) for name in named if is_file(Path(name))]
    return [(name, stat.st_mtime_ns, stat.st_size) for name, stat in found]


@lru_cache(maxsize=64)
def _expected_force(table: str, _inputs: tuple[object, ...]) -> ExpectedForce:
    """Return the force along the scripted motion of a scene; `table` is the scene as JSON text."""
    scene = Scene.read_back(table)
    entry = ANATOMIES[scene.anatomy.kind]
    if entry.build is not None:
        return ExpectedForce(0.0 if entry.force_N is None else float(entry.force_N(scene)))
    if isinstance(scene.anatomy, WallAnatomy):
        stiffness = 1e3 * scene.anatomy.stiffness_kN_m
        depth = _depth_m(scene)
        return ExpectedForce(stiffness * depth, stiffness, depth)
    if isinstance(scene.tool, Tool):
        return cutting_force(scene)
    if isinstance(scene.tool, Needle | Blade):
        return insertion_force(scene)
    return pressing_force(scene) if isinstance(scene.anatomy, SoftAnatomy) else ExpectedForce(0.0)


def cutting_force(scene: Scene) -> ExpectedForce:
    """Return the largest force on a cutter along the scripted motion, computed in coarse voxels.

    For a tool that is pushed by a thrust, the result is the thrust.
    """
    assert isinstance(scene.tool, Tool)
    if isinstance(scene.motion, ThrustMotion):
        return ExpectedForce(scene.motion.thrust_N)
    if scene.tool.spin_rpm == 0.0:
        return ExpectedForce(0.0)
    spacing_mm = max(scene.voxels.spacing_mm, scene.tool.diameter_mm / ACROSS)
    voxels = scene.voxels.model_copy(update={"spacing_mm": spacing_mm, "margin_mm": 0.0})
    coarse = scene.model_copy(update={"voxels": voxels})
    cutter = cutter_of(scene.tool)
    motion = motion_of(scene)
    volume = volume_of(coarse, cutter, motion, notes={}, report=silent)
    spacing_m = (cutter.cutting_area_m2 / ELEMENTS) ** 0.5
    bone = VoxelBone.stated(volume, coarse.cutting, coarse.constants)
    model = bone.model(cutter, removal=voxels.removal, shell_spacing_m=spacing_m)
    return ExpectedForce(_largest(motion, model, POSES))


def _depth_m(scene: Scene) -> float:
    """Return the depth of the scripted motion below the origin [m]."""
    return max(-float(motion_of(scene).sweep_m()[:, 2].min()), 0.0)


def pressing_force(scene: Scene) -> ExpectedForce:
    """Return the force of a probe on a half space, at the depth of the scripted motion.

    The force is computed with Hertz's law for a ball, and with Boussinesq's law for the flat end of
    a cylinder. The modulus of the stiffest tissue along the scripted motion is used. A nodule and a
    hyperelastic law of the organ are ignored. With the exponential law of the scene `liver-press`,
    the simulated force is 1.3 times the returned force. For a probe of another shape the result is
    0.
    """
    organ = scene.organ
    tool = scene.tool
    assert isinstance(tool, Probe)
    cited = scene.constants.constants("soft", organ.material)
    start = organ.young_kPa or cited["modulus_kPa"].value
    end = start if organ.young_end_kPa is None else organ.young_end_kPa
    ratio = cited["poisson_ratio"].value if organ.poisson_ratio is None else organ.poisson_ratio
    radius = 0.5e-3 * tool.size_mm
    depth = _depth_m(scene)
    # Slope divided by the modulus of the half space [m].
    slope = 2.0 * radius
    if tool.kind == "sphere-probe":
        slope = 2.0 * sqrt(radius * depth)
        depth *= 2.0 / 3.0
    elif tool.kind != "cylinder-probe":
        return ExpectedForce(0.0)
    slope *= 1e3 / (1.0 - ratio**2)
    return ExpectedForce(max(start, end) * slope * depth, sqrt(start * end) * slope, depth)


def insertion_force(scene: Scene) -> ExpectedForce:
    """Return the largest force on a needle or a blade along the scripted motion."""
    is_needle = isinstance(scene.tool, Needle)
    build = organ_scene.pierced if is_needle else organ_scene.incised
    motion = motion_of(scene)
    parts = build(without_fields(scene), motion, report=silent)
    return ExpectedForce(_largest(motion, parts.tissue, FINE_POSES if is_needle else POSES))


def _largest(motion: Motion, tissue: TissueModel, poses: int) -> float:
    """Return the largest force of a tissue on the tool [N], over poses at equal time intervals."""
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
    """Compute the force of a cutter in a typical slot in the first layer of a bone [N].

    The depth of the slot is a quarter of the cutter's diameter, and the feed is 2 mm/s.
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
