"""Keys of a scene that have no effect in it: one table of which kind of scene reads which key.

A key that a person has set and that nothing reads is refused with the key that has the effect, so that no run looks as
if it had been given what it was not. What only a file's contents decide is refused by what reads the file.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from meshes.base.errors import InputError
from tissue.scene.anatomy import MolarAnatomy, Part
from tissue.scene.coupling import WallAnatomy
from tissue.scene.named_parts import shown
from tissue.scene.organ import LiverAnatomy, SlabAnatomy
from tissue.scene.registry import CUTTERS, DEVICES, PREDICTORS, PROBES
from tissue.scene.tool import Needle, Probe, ReplayMotion, ThrustMotion, Tool
from tissue.scene.unused_bone_keys import SITE, Rule, bone_rules, hole_rules, tooth_rules

if TYPE_CHECKING:
    from tissue.scene.scene import Scene

__all__ = ["Unused", "is_given", "refused_keys", "require_used", "unused_keys"]


class Unused(NamedTuple):
    """Why a key has no effect, as ``with anatomy.file``, and what has, as ``set anatomy.scale_mm``."""

    where: str
    remedy: str


def unused_keys(scene: "Scene") -> dict[str, Unused]:
    """Keys, or whole parts, that have no effect in a scene, and why."""
    found: dict[str, Unused] = {}
    bone = bone_rules, hole_rules, tooth_rules
    for rules in (_device, _tool, _motion, _cutting, *bone, _organ, _chosen):
        for keys, unused, where, remedy in rules(scene):
            if unused:
                found = dict.fromkeys(keys.split(), Unused(where, remedy)) | found
    return found


def given_keys(scene: "Scene") -> Iterator[tuple[str, object]]:
    """Dotted keys that were set in a scene, and their values; kinds and defaults are none."""
    for name in sorted(scene.model_fields_set):
        value = getattr(scene, name)
        if not isinstance(value, Part):
            yield name, value
            continue
        inner = value.model_fields_set - {"kind"}
        yield from ((f"{name}.{each}", getattr(value, each)) for each in sorted(inner))
        if not inner and type(scene).model_fields[name].default is None:
            yield name, {}  # a table that is there at all asks for something


def is_given(part: Part, name: str) -> bool:
    """Whether an entry was set: what a build asks that finds a key without effect."""
    return name in part.model_fields_set and getattr(part, name) is not None


def refused_keys(scene: "Scene") -> dict[str, Unused]:
    """Keys that were set in a scene and have no effect in it; one that asks for nothing, such as 0, is allowed."""
    unused = unused_keys(scene)
    found = {key: unused.get(key) or unused.get(key.split(".")[0]) for key, _ in given_keys(scene)}
    return {key: why for key, why in found.items() if why is not None and not _asks_for_nothing(scene, key)}


def require_used(scene: "Scene") -> None:
    """Refuse a scene with a key that has no effect in it.

    Raises
    ------
    InputError
        Names the key, or all that have none for the same reason, and what has an effect instead.
    """
    refused = refused_keys(scene)
    if not refused:
        return
    values, why = dict(given_keys(scene)), next(iter(refused.values()))
    keys = [key for key, each in refused.items() if each == why]
    got, them = shown(values[keys[0]]), "it"
    if len(keys) > 1:
        got, them = ", ".join(f"{key} = {shown(values[key])}" for key in keys), "them"
    raise InputError(f"{' and '.join(keys)} must be left out {why.where}, got {got}: {why.remedy}, or remove {them}")


def _asks_for_nothing(scene: "Scene", key: str) -> bool:
    """Whether a value is a default that states that something is not there."""
    *parts, name = key.split(".")
    model: Part = getattr(scene, parts[0]) if parts else scene
    value = getattr(model, name)
    return (value is None or value in (0, "", "none")) and bool(value == type(model).model_fields[name].default)


def _device(scene: "Scene") -> list[Rule]:
    if scene.device == "none":
        keys = "hand renderer prediction perception coupling hardware"
        nothing = "without a device, for nothing is drawn at random then"
        return [
            (f"{keys} output.cue_N", True, "without a device", "set device = touch"),
            ("seed", True, nothing, "set device = touch"),
        ]
    entry, simulated = DEVICES[scene.device], f"with device = {scene.device}, which no adapter opens"
    torque = entry.numbers.get("torque_limit_Nm", 0.0) > 0.0
    trained = scene.prediction != "none" and PREDICTORS[scene.prediction].trained
    koopman, points = "set prediction = koopman", "set motion.points_mm"
    wall = isinstance(scene.anatomy, WallAnatomy)
    return [
        ("hardware", entry.adapter is None, simulated, "set device = haply"),
        ("coupling.stiffness_Nm_rad", not torque, "with a device that plays no torque", "set device = six-dof"),
        ("coupling.prediction_gain", scene.prediction == "none", "without a prediction", koopman),
        ("coupling.prediction_gain", scene.prediction == "hold", "with prediction = hold, the present force", koopman),
        ("coupling.predictor_file", not trained, "unless a trained prediction is used", koopman),
        ("coupling.roam_mm", wall, "for a wall, which goes on for ever", points),
        ("coupling.roam_mm", isinstance(scene.tool, Needle), "for a needle", points),
    ]


def _tool(scene: "Scene") -> list[Rule]:
    tool = scene.tool
    where = f"for a {tool.kind}"
    if isinstance(tool, Tool):
        keys, still = CUTTERS[tool.kind].keys, tool.spin_rpm == 0.0
        return [
            ("tool.length_mm", "length_mm" not in keys, where, "set tool.diameter_mm"),
            ("tool.point_angle_deg", "point_angle_deg" not in keys, where, "set tool.kind = twist-drill"),
            ("tool.peg_diameter_mm tool.peg_length_mm", not tool.can_have_peg, where, "set tool.kind = flat-reamer"),
            ("tool.peg_length_mm", tool.peg_diameter_mm == 0.0, "without a peg", "set tool.peg_diameter_mm"),
            ("tool.peg_diameter_mm", tool.peg_length_mm == 0.0, "without its length", "set tool.peg_length_mm"),
            ("tool.flutes tool.shell_spacing_mm", still, "for a tool that does not turn", "set tool.spin_rpm"),
        ]
    if not isinstance(tool, Probe):
        return []
    keys = PROBES[tool.kind].keys
    return [
        ("tool.length_mm", "length_mm" not in keys, where, "set tool.kind = cylinder-probe"),
        ("tool.diameter_mm", "diameter_mm" not in keys, f"{where}, whose size its file gives", "set tool.scale_mm"),
        ("tool.scale_mm", "scale_mm" not in keys, where, "set tool.diameter_mm"),
        ("tool.file", "file" not in keys, where, "set tool.kind = shell-probe"),
    ]


def _motion(scene: "Scene") -> list[Rule]:
    by_hand = isinstance(scene.motion, ThrustMotion) and scene.device != "none"
    lasts, replayed = by_hand and scene.duration_s is not None, isinstance(scene.motion, ReplayMotion)
    return [
        ("motion.axis", replayed, "for a replay, whose file holds the turns", "set motion.file"),
        ("motion.mass_kg", by_hand, "by a hand on a device, whose masses count", "set device or hand"),
        ("motion.max_feed_mm_s", lasts, "by a hand with duration_s", "set motion.thrust_N or duration_s"),
    ]


def _cutting(scene: "Scene") -> list[Rule]:
    kind, tool = scene.anatomy.kind, scene.tool
    if not isinstance(tool, Tool):
        toothless = f"for a {tool.kind}, which has no teeth"
        return [
            (
                "voxels cutting stress heat keep_clear",
                True,
                f"for a {kind}, which is not cut",
                "set anatomy.kind = block",
            ),
            ("output.vibration_share", True, toothless, "set tool.kind = ball-burr"),
        ]
    still, where = tool.spin_rpm == 0.0, "for a tool that does not turn and so cuts nothing"
    tooth = isinstance(scene.anatomy, MolarAnatomy)
    return [
        ("cutting voxels.removal stress heat output.vibration_share", still, where, "set tool.spin_rpm"),
        ("stress heat", not tooth, f"for a {kind}", "set anatomy.kind = molar"),
    ]


def _organ(scene: "Scene") -> list[Rule]:
    anatomy, organ = scene.anatomy, scene.organ
    if not isinstance(anatomy, LiverAnatomy | SlabAnatomy):
        return [("organ", True, f"for a {anatomy.kind}", "set anatomy.kind = liver")]
    from_file = isinstance(anatomy, LiverAnatomy) and bool(anatomy.file)
    bare = anatomy.nodule_diameter_mm == 0.0 and not from_file
    ball, ratio = "set anatomy.nodule_diameter_mm", "set organ.fibre_modulus_ratio"
    both = "with both organ.young_kPa and organ.poisson_ratio"
    given = organ.young_kPa is not None and organ.poisson_ratio is not None
    cited, path = organ.capsule or organ.gravity or organ.viscous, f"with organ.path = {organ.path}"
    law = f"with organ.law = {organ.law}"
    rules = [
        ("organ.grading_exponent", organ.young_end_kPa is None, "without a gradient", "set organ.young_end_kPa"),
        ("organ.parts", bare, "without a nodule", ball),
        ("organ.fibre_modulus_ratio", organ.fibre_direction is None, "without fibres", "set organ.fibre_direction"),
        ("organ.fibre_direction", organ.fibre_modulus_ratio == 1.0, "with a ratio of 1", ratio),
        ("organ.second_share", organ.law != "mooney-rivlin", law, "set organ.law = mooney-rivlin"),
        ("organ.square_ratio organ.cube_ratio", organ.law != "yeoh", law, "set organ.law = yeoh"),
        ("organ.exponent", organ.law != "ogden", law, "set organ.law = ogden"),
        ("organ.law_interval_ms organ.law_edge_ratio", organ.law == "linear", law, "set organ.law = neo-hookean"),
        ("organ.basis_size", organ.path != "reduced", path, "set organ.path = reduced"),
        ("organ.material", given and not cited, both, "remove one of them"),
        ("anatomy.nodule_centre_mm", anatomy.nodule_diameter_mm == 0.0, "without a nodule", ball),
    ]
    if isinstance(anatomy, LiverAnatomy):
        held, name = f"with anatomy.held = {anatomy.held}", f"with anatomy.file = {Path(anatomy.file or '').name}"
        nodule = "anatomy.nodule_diameter_mm anatomy.nodule_centre_mm"
        rules += [
            (nodule, from_file, name, "give a part of the file its modulus in organ.parts"),
            (f"anatomy.scale_mm {SITE}", not from_file, "for a procedural liver", "set anatomy.file"),
            ("anatomy.held_below_mm", anatomy.held != "plane", held, "set anatomy.held = plane"),
            ("anatomy.held_part", anatomy.held != "part", held, "set anatomy.held = part"),
        ]
    return rules


def _chosen(scene: "Scene") -> list[Rule]:
    """What a demand on fidelity chooses by itself."""
    if scene.fidelity is None:
        return []
    held, where, remedy = scene.device != "none", "with fidelity, which chooses it", "leave fidelity out"
    return [
        ("prediction", held, where, remedy),
        ("voxels.removal", not held and isinstance(scene.tool, Tool), where, remedy),
        ("organ.order", not held and isinstance(scene.tool, Probe), where, remedy),
    ]
