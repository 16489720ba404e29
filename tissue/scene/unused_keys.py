"""Keys of a scene that have no effect in it: one table of which kind of scene reads which key.

A key that a person has set and that nothing reads is refused with the key that has the effect, so that no run looks as
if it had been given what it was not. What only a file's contents decide is refused by what reads the file.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissue.scene.anatomy import AnatomyFile, BlockAnatomy, GlenoidAnatomy, MolarAnatomy, Part
from tissue.scene.coupling import WallAnatomy
from tissue.scene.organ import LiverAnatomy, SlabAnatomy
from tissue.scene.registry import CUTTERS, DEVICES, PREDICTORS
from tissue.scene.tool import Needle, Probe, ReplayMotion, ThrustMotion, Tool

if TYPE_CHECKING:
    from tissue.scene.scene import Scene

__all__ = ["Unused", "given_keys", "is_given", "refused_keys", "unused_keys"]

PROCEDURAL_GLENOID = "anatomy.width_mm anatomy.height_mm anatomy.curvature_radius_mm anatomy.subchondral_thickness_mm"
PROCEDURAL_MOLAR = (
    "anatomy.crown_width_mm anatomy.crown_length_mm anatomy.enamel_thickness_mm anatomy.pulp_roof_mm "
    "anatomy.caries_depth_mm anatomy.caries_diameter_mm"
)
LAYER_FILES = "anatomy.enamel_file anatomy.dentin_file anatomy.pulp_file anatomy.caries_file anatomy.ligament_file"
SITE = "anatomy.centre_mm anatomy.normal anatomy.along"
HOLE = "anatomy.guide_hole_diameter_mm anatomy.guide_hole_depth_mm"


@dataclass(frozen=True)
class Unused:
    """Why a key has no effect, as ``with anatomy.file``, and what has, as ``set anatomy.scale_mm``."""

    where: str
    remedy: str


Rule = tuple[str, bool, str, str]
"""Keys, whether they have no effect, where that is so, and what has an effect instead."""


def unused_keys(scene: "Scene") -> dict[str, Unused]:
    """Keys, or whole parts, that have no effect in a scene, and why."""
    found: dict[str, Unused] = {}
    for rules in (_device, _tool, _motion, _cutting, _bone, _hole, _tooth, _organ, _soft, _chosen):
        for keys, unused, where, remedy in rules(scene):
            if unused:
                for key in keys.split():
                    found.setdefault(key, Unused(where, remedy))
    return found


def given_keys(scene: "Scene") -> Iterator[tuple[str, Any]]:
    """Dotted keys that were set in a scene, and their values; kinds and defaults are none."""
    for name in sorted(scene.model_fields_set):
        value = getattr(scene, name)
        if not isinstance(value, Part):
            yield name, value
            continue
        inner = value.model_fields_set - {"kind"}
        yield from ((f"{name}.{each}", getattr(value, each)) for each in sorted(inner))
        if not inner and type(scene).model_fields[name].default is None:
            yield name, value  # a table that is there at all asks for something


def is_given(part: Part, name: str) -> bool:
    """Whether an entry was set: what a build asks that finds a key without effect."""
    return name in part.model_fields_set and getattr(part, name) is not None


def refused_keys(scene: "Scene") -> dict[str, Unused]:
    """Keys that were set in a scene and have no effect in it; one that asks for nothing, such as 0, is allowed."""
    unused = unused_keys(scene)
    found = {}
    for key, value in given_keys(scene):
        why = unused.get(key) or unused.get(key.split(".")[0])
        if why is not None and not _asks_for_nothing(scene, key, value):
            found[key] = why
    return found


def _asks_for_nothing(scene: "Scene", key: str, value: Any) -> bool:
    """Whether a value is a default that states that something is not there."""
    *parts, name = key.split(".")
    model: Part = getattr(scene, parts[0]) if parts else scene
    return (value is None or value in (0, "", "none")) and bool(value == type(model).model_fields[name].default)


def _device(scene: "Scene") -> Iterator[Rule]:
    alone = scene.device == "none"
    yield "hand renderer prediction perception coupling", alone, "without a device", "set device = touch"
    yield "seed", alone, "without a device, for nothing is drawn at random then", "set device = touch"
    if alone:
        return
    torque = scene.device in DEVICES and DEVICES[scene.device].get("torque_limit_Nm", 0.0) > 0.0
    yield "coupling.stiffness_Nm_rad", not torque, "with a device that plays no torque", "set device = six-dof"
    yield "coupling.prediction_gain", scene.prediction == "none", "without a prediction", "set prediction = koopman"
    kept = scene.prediction == "hold"
    yield "coupling.prediction_gain", kept, "with prediction = hold, the present force", "set prediction = koopman"
    trained = scene.prediction in PREDICTORS and PREDICTORS[scene.prediction].trained
    yield "coupling.predictor_file", not trained, "unless a trained prediction is used", "set prediction = koopman"
    wall = isinstance(scene.anatomy, WallAnatomy)
    yield "coupling.roam_mm", wall, "for a wall, which goes on for ever", "set motion.points_mm"
    yield "coupling.roam_mm", isinstance(scene.tool, Needle), "for a needle", "set motion.points_mm"


def _tool(scene: "Scene") -> Iterator[Rule]:
    tool = scene.tool
    if isinstance(tool, Tool):
        kind = tool.kind
        where, keys = f"for a {kind}", CUTTERS[kind].keys
        yield "tool.length_mm", "length_mm" not in keys, where, "set tool.diameter_mm"
        yield "tool.point_angle_deg", "point_angle_deg" not in keys, where, "set tool.kind = twist-drill"
        yield "tool.peg_diameter_mm tool.peg_length_mm", not tool.can_have_peg, where, "set tool.kind = flat-reamer"
        yield "tool.peg_length_mm", tool.peg_diameter_mm == 0.0, "without a peg", "set tool.peg_diameter_mm"
        yield "tool.peg_diameter_mm", tool.peg_length_mm == 0.0, "without its length", "set tool.peg_length_mm"
        still = tool.spin_rpm == 0.0
        yield "tool.flutes tool.shell_spacing_mm", still, "for a tool that does not turn", "set tool.spin_rpm"
    elif isinstance(tool, Probe):
        where = f"for a {tool.kind}"
        yield "tool.length_mm", tool.kind != "cylinder-probe", where, "set tool.kind = cylinder-probe"
        shell = tool.kind == "shell-probe"
        yield "tool.diameter_mm", shell, f"{where}, whose size its file gives", "set tool.scale_mm"
        yield "tool.scale_mm", not shell, where, "set tool.diameter_mm"
        yield "tool.file", not shell, where, "set tool.kind = shell-probe"


def _motion(scene: "Scene") -> Iterator[Rule]:
    motion, held = scene.motion, scene.device != "none"
    replayed = isinstance(motion, ReplayMotion)
    yield "motion.axis", replayed, "for a replay, whose file holds the turns", "set motion.file"
    if isinstance(motion, ThrustMotion) and held:
        yield "motion.mass_kg", True, "by a hand on a device, whose masses count", "set device or hand"
        lasts = scene.duration_s is not None
        yield "motion.max_feed_mm_s", lasts, "by a hand with duration_s", "set motion.thrust_N or duration_s"


def _cutting(scene: "Scene") -> Iterator[Rule]:
    kind, tool = scene.anatomy.kind, scene.tool
    if not isinstance(tool, Tool):
        yield "voxels cutting stress heat", True, f"for a {kind}, which is not cut", "set anatomy.kind = block"
        yield "output.vibration_share", True, f"for a {tool.kind}, which has no teeth", "set tool.kind = ball-burr"
        return
    still, remedy = tool.spin_rpm == 0.0, "set tool.spin_rpm"
    where = "for a tool that does not turn and so cuts nothing"
    yield "cutting voxels.removal stress heat output.vibration_share", still, where, remedy
    tooth = isinstance(scene.anatomy, MolarAnatomy)
    yield "stress heat", not tooth, f"for a {kind}", "set anatomy.kind = molar"


def _bone(scene: "Scene") -> Iterator[Rule]:
    anatomy = scene.anatomy
    if not isinstance(anatomy, AnatomyFile):
        return
    file, image = anatomy.file, anatomy.is_image
    tooth = isinstance(anatomy, MolarAnatomy)
    layered = isinstance(anatomy, MolarAnatomy) and bool(anatomy.layer_files)
    as_it_is = _is_as_it_is(anatomy)
    if file is None:
        where, remedy = f"for a procedural {anatomy.kind}", "set anatomy.file"
        yield "anatomy.scale_mm", not layered, where, remedy
        yield SITE, not tooth, f"{where}, whose face has its place", remedy
        yield "anatomy.spacing_mm anatomy.threshold anatomy.cortical_thickness_mm", True, where, remedy
        return
    name = f"with anatomy.file = {Path(file).name}"
    shape = f"{name}, which gives the shape"
    yield PROCEDURAL_GLENOID, isinstance(anatomy, GlenoidAnatomy), shape, "remove anatomy.file"
    yield "anatomy.size_mm", isinstance(anatomy, BlockAnatomy), shape, "set anatomy.scale_mm"
    yield "anatomy.scale_mm", image, f"{name}, an image", "set anatomy.spacing_mm"
    yield "anatomy.spacing_mm anatomy.threshold", not image, f"{name}, a surface", "set anatomy.scale_mm"
    whole = f"{name}, an image as it is"
    yield "anatomy.cortical_thickness_mm", as_it_is, whole, "set anatomy.threshold"
    yield "anatomy.along voxels.margin_mm", as_it_is, whole, "set anatomy.centre_mm"
    loose = not tooth and anatomy.centre_mm is None
    yield "anatomy.normal", loose, f"{name} without anatomy.centre_mm", "set anatomy.centre_mm"


def _hole(scene: "Scene") -> Iterator[Rule]:
    anatomy = scene.anatomy
    if not isinstance(anatomy, AnatomyFile):
        return
    name = f"with anatomy.file = {Path(anatomy.file or '').name}"
    yield HOLE, _is_as_it_is(anatomy), f"{name}, an image as it is", "set anatomy.centre_mm"
    labels = isinstance(anatomy, MolarAnatomy) and anatomy.file is not None
    yield HOLE, labels, f"{name}, a label volume", "give a surface a layer, such as anatomy.enamel_file"
    bare, flat = anatomy.guide_hole_diameter_mm == 0.0, anatomy.guide_hole_depth_mm == 0.0
    yield "anatomy.guide_hole_depth_mm", bare, "without a hole", "set anatomy.guide_hole_diameter_mm"
    yield "anatomy.guide_hole_diameter_mm", flat, "without a depth", "set anatomy.guide_hole_depth_mm"


def _is_as_it_is(anatomy: AnatomyFile) -> bool:
    """Whether the bone is the whole block of an image, which no site turns or moves."""
    return isinstance(anatomy, BlockAnatomy) and anatomy.is_image and anatomy.centre_mm is None


def _tooth(scene: "Scene") -> Iterator[Rule]:
    anatomy = scene.anatomy
    if not isinstance(anatomy, MolarAnatomy):
        return
    sound = anatomy.caries_depth_mm == 0.0
    labels, layers = anatomy.file is not None, anatomy.layer_files
    procedural = not labels and not layers
    if procedural:
        where = "for a procedural molar"
        yield "anatomy.caries_diameter_mm", sound, "without a lesion", "set anatomy.caries_depth_mm"
        yield f"{SITE} anatomy.site anatomy.socket_mm", True, where, "set anatomy.enamel_file and anatomy.dentin_file"
        return
    what = f"with anatomy.file = {Path(anatomy.file).name}" if anatomy.file else "for a tooth from surfaces"
    reason = f"{what}, which gives the shape"
    yield PROCEDURAL_MOLAR, True, reason, "remove the file"
    yield "anatomy.ligament_thickness_mm", scene.stress is None, f"{reason}, without stress", "add [stress]"
    yield SITE, True, f"{what}, which is placed by its enamel", "set motion.points_mm and motion.axis"
    if labels:
        yield f"{LAYER_FILES} anatomy.socket_mm", True, what, "remove anatomy.file"
        volume = f"{what}, a label volume"
        yield "anatomy.threshold anatomy.cortical_thickness_mm", True, volume, "set anatomy.spacing_mm"


def _organ(scene: "Scene") -> Iterator[Rule]:
    anatomy, organ = scene.anatomy, scene.organ
    if not isinstance(anatomy, LiverAnatomy | SlabAnatomy):
        yield "organ", True, f"for a {anatomy.kind}", "set anatomy.kind = liver"
        return
    yield "organ.grading_exponent", organ.young_end_kPa is None, "without a gradient", "set organ.young_end_kPa"
    from_file = isinstance(anatomy, LiverAnatomy) and bool(anatomy.file)
    bare = anatomy.nodule_diameter_mm == 0.0 and not from_file
    yield "organ.nodule_kPa", bare, "without a nodule", "set anatomy.nodule_diameter_mm"
    yield "organ.nodule_part", not from_file, f"for a procedural {anatomy.kind}", "set anatomy.nodule_diameter_mm"
    yield "organ.fibre_modulus_ratio", organ.fibre_direction is None, "without fibres", "set organ.fibre_direction"
    even = organ.fibre_modulus_ratio == 1.0
    yield "organ.fibre_direction", even, "with a ratio of 1", "set organ.fibre_modulus_ratio"
    reduced = organ.path == "reduced"
    yield "organ.basis_size", not reduced, f"with organ.path = {organ.path}", "set organ.path = reduced"
    given = organ.young_kPa is not None and organ.poisson_ratio is not None
    cited = organ.capsule or organ.gravity or organ.viscous
    both = "with both organ.young_kPa and organ.poisson_ratio"
    yield "organ.material", given and not cited, both, "remove one of them"


def _soft(scene: "Scene") -> Iterator[Rule]:
    anatomy = scene.anatomy
    if isinstance(anatomy, LiverAnatomy | SlabAnatomy):
        bare = anatomy.nodule_diameter_mm == 0.0
        yield "anatomy.nodule_centre_mm", bare, "without a nodule", "set anatomy.nodule_diameter_mm"
    if isinstance(anatomy, LiverAnatomy):
        procedural = anatomy.file is None
        name = f"with anatomy.file = {Path(anatomy.file or '').name}"
        ball = "anatomy.nodule_diameter_mm anatomy.nodule_centre_mm"
        yield ball, not procedural, name, "set organ.nodule_part to the part of the file that is the nodule"
        yield f"anatomy.scale_mm {SITE}", procedural, "for a procedural liver", "set anatomy.file"
        held = f"with anatomy.held = {anatomy.held}"
        yield "anatomy.held_below_mm", anatomy.held != "plane", held, "set anatomy.held = plane"
        yield "anatomy.held_part", anatomy.held != "part", held, "set anatomy.held = part"


def _chosen(scene: "Scene") -> Iterator[Rule]:
    """What a demand on fidelity chooses by itself."""
    if scene.fidelity is None:
        return
    where, remedy = "with fidelity, which chooses it", "leave fidelity out"
    if scene.device != "none":
        yield "prediction", True, where, remedy
    else:
        yield "voxels.removal", isinstance(scene.tool, Tool), where, remedy
        yield "organ.order", isinstance(scene.tool, Probe), where, remedy
