"""Keys of a scene that have no effect on bone or a tooth, see `tissue.scene.unused_keys`."""

from pathlib import Path
from typing import TYPE_CHECKING

from tissue.scene.anatomy import AnatomyFile, BlockAnatomy, BoneAnatomy, GlenoidAnatomy, MolarAnatomy

if TYPE_CHECKING:
    from tissue.scene.scene import Scene

__all__ = ["SITE", "Rule", "bone_rules", "hole_rules", "is_whole_image", "tooth_rules"]

PROCEDURAL_GLENOID = "anatomy.width_mm anatomy.height_mm anatomy.curvature_radius_mm anatomy.subchondral_thickness_mm"
PROCEDURAL_MOLAR = (
    "anatomy.crown_width_mm anatomy.crown_length_mm anatomy.enamel_thickness_mm anatomy.pulp_roof_mm "
    "anatomy.caries_depth_mm anatomy.caries_diameter_mm"
)
LAYER_FILES = "anatomy.enamel_file anatomy.dentin_file anatomy.pulp_file anatomy.caries_file anatomy.ligament_file"
SITE = "anatomy.centre_mm anatomy.normal anatomy.along"
HOLE = "anatomy.guide_hole_diameter_mm anatomy.guide_hole_depth_mm"

Rule = tuple[str, bool, str, str]
"""Keys, whether they have no effect, where that is so, and what has an effect instead."""


def bone_rules(scene: "Scene") -> list[Rule]:
    """Rules of bone: what a file gives, and what only a procedural bone has."""
    anatomy = scene.anatomy
    if not isinstance(anatomy, AnatomyFile):
        return []
    tooth = isinstance(anatomy, MolarAnatomy)
    if anatomy.file is None:
        layered = isinstance(anatomy, MolarAnatomy) and bool(anatomy.layer_files)
        where, remedy = f"for a procedural {anatomy.kind}", "set anatomy.file"
        return [
            ("anatomy.scale_mm", not layered, where, remedy),
            (SITE, not tooth, f"{where}, whose face has its place", remedy),
            ("anatomy.spacing_mm anatomy.threshold anatomy.cortical_thickness_mm", True, where, remedy),
        ]
    name, image, whole = f"with anatomy.file = {Path(anatomy.file).name}", anatomy.is_image, is_whole_image(anatomy)
    shape, as_it_is = f"{name}, which gives the shape", f"{name}, an image as it is"
    loose = not tooth and anatomy.centre_mm is None
    return [
        (PROCEDURAL_GLENOID, isinstance(anatomy, GlenoidAnatomy), shape, "remove anatomy.file"),
        ("anatomy.size_mm", isinstance(anatomy, BlockAnatomy), shape, "set anatomy.scale_mm"),
        ("anatomy.scale_mm", image, f"{name}, an image", "set anatomy.spacing_mm"),
        ("anatomy.spacing_mm anatomy.threshold", not image, f"{name}, a surface", "set anatomy.scale_mm"),
        ("anatomy.cortical_thickness_mm", whole, as_it_is, "set anatomy.threshold"),
        ("anatomy.along voxels.margin_mm", whole, as_it_is, "set anatomy.centre_mm"),
        ("anatomy.normal", loose, f"{name} without anatomy.centre_mm", "set anatomy.centre_mm"),
        *(_inner(anatomy) if isinstance(anatomy, BoneAnatomy) else []),
    ]


def _inner(anatomy: BoneAnatomy) -> list[Rule]:
    """What is inside a bone comes from one place: its density, its core, or a shell of even thickness."""
    dense, cored = anatomy.density_file is not None, anatomy.core_file is not None
    layered = "with anatomy.density_file, from which the layers follow"
    return [
        ("anatomy.core_file anatomy.cortical_thickness_mm", dense, layered, "set anatomy.cortical_above_kg_m3"),
        ("anatomy.cortical_thickness_mm", cored, "with anatomy.core_file, which bounds the cortex", "scale the core"),
        (
            "anatomy.cortical_above_kg_m3 anatomy.articular_radius_mm",
            not dense,
            "without a density",
            "set anatomy.density_file",
        ),
    ]


def hole_rules(scene: "Scene") -> list[Rule]:
    """Rules of the guide hole."""
    anatomy = scene.anatomy
    if not isinstance(anatomy, AnatomyFile):
        return []
    name, labels = f"with anatomy.file = {Path(anatomy.file or '').name}", isinstance(anatomy, MolarAnatomy)
    bare, flat = anatomy.guide_hole_diameter_mm == 0.0, anatomy.guide_hole_depth_mm == 0.0
    layer = "give a surface a layer, such as anatomy.enamel_file"
    return [
        (HOLE, is_whole_image(anatomy), f"{name}, an image as it is", "set anatomy.centre_mm"),
        (HOLE, labels and anatomy.file is not None, f"{name}, a label volume", layer),
        ("anatomy.guide_hole_depth_mm", bare, "without a hole", "set anatomy.guide_hole_diameter_mm"),
        ("anatomy.guide_hole_diameter_mm", flat, "without a depth", "set anatomy.guide_hole_depth_mm"),
    ]


def is_whole_image(anatomy: AnatomyFile) -> bool:
    """Whether the bone is the whole block of an image, which no site turns or moves."""
    return (
        isinstance(anatomy, BlockAnatomy)
        and anatomy.file is not None
        and anatomy.is_image
        and anatomy.centre_mm is None
    )


def tooth_rules(scene: "Scene") -> list[Rule]:
    """Rules of a tooth: procedural, from surfaces, or from a label volume."""
    anatomy = scene.anatomy
    if not isinstance(anatomy, MolarAnatomy):
        return []
    labels = anatomy.file is not None
    if not labels and not anatomy.layer_files:
        sound, remedy = anatomy.caries_depth_mm == 0.0, "set anatomy.enamel_file and anatomy.dentin_file"
        return [
            ("anatomy.caries_diameter_mm", sound, "without a lesion", "set anatomy.caries_depth_mm"),
            (f"{SITE} anatomy.site anatomy.socket_mm", True, "for a procedural molar", remedy),
        ]
    what = f"with anatomy.file = {Path(anatomy.file).name}" if anatomy.file else "for a tooth from surfaces"
    reason, volume = f"{what}, which gives the shape", f"{what}, a label volume"
    placed = f"{what}, which is placed by its enamel"
    return [
        (PROCEDURAL_MOLAR, True, reason, "remove the file"),
        ("anatomy.ligament_thickness_mm", scene.stress is None, f"{reason}, without stress", "add [stress]"),
        (SITE, True, placed, "set motion.points_mm and motion.axis"),
        (f"{LAYER_FILES} anatomy.socket_mm", labels, what, "remove anatomy.file"),
        ("anatomy.threshold anatomy.cortical_thickness_mm", labels, volume, "set anatomy.spacing_mm"),
    ]
