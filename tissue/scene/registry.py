"""Registries of anatomies and motions, and a table of all registries.

A built-in part is a line in a registry. `tissue.register` and entry points of installed packages
add more parts.
"""

from typing import Any

from tissue.scene.anatomy import (
    BlockAnatomy,
    BlockImage,
    BlockSurface,
    BoneImage,
    BoneSurface,
    GlenoidAnatomy,
    GlenoidImage,
    GlenoidSurface,
    MolarAnatomy,
    MolarLabels,
    MolarSurfaces,
    VertebraAnatomy,
    WallAnatomy,
)
from tissue.scene.names import (
    CUTTERS,
    CUTTING_MATERIALS,
    DEVICES,
    GROUPS,
    HANDS,
    NEEDLES,
    ORGAN_MATERIALS,
    PERCEPTIONS,
    PREDICTORS,
    PROBES,
    RENDERERS,
    SCENES,
    AnatomyEntry,
    CutterEntry,
    DeviceEntry,
    MotionEntry,
    PredictorEntry,
    ProbeEntry,
)
from tissue.scene.organ import IncisedAnatomy, LayersAnatomy, LiverAnatomy, LiverFile, SlabAnatomy
from tissue.scene.part import Registry
from tissue.scene.tool import Blade, Needle, PathMotion, Probe, ReplayMotion, ThrustMotion, Tool

__all__ = [
    "ANATOMIES",
    "CUTTERS",
    "CUTTING_MATERIALS",
    "DEVICES",
    "GROUPS",
    "HANDS",
    "MOTIONS",
    "NEEDLES",
    "ORGAN_MATERIALS",
    "PERCEPTIONS",
    "PREDICTORS",
    "PROBES",
    "RENDERERS",
    "SCENES",
    "TABLES",
    "AnatomyEntry",
    "CutterEntry",
    "DeviceEntry",
    "MotionEntry",
    "PredictorEntry",
    "ProbeEntry",
]

ANATOMIES = Registry(
    "anatomy.kind",
    {
        "glenoid": AnatomyEntry((GlenoidAnatomy, GlenoidSurface, GlenoidImage), Tool),
        "block": AnatomyEntry((BlockAnatomy, BlockSurface, BlockImage), Tool),
        "bone": AnatomyEntry((BoneSurface, BoneImage), Tool),
        "molar": AnatomyEntry((MolarAnatomy, MolarSurfaces, MolarLabels), Tool),
        "vertebra": AnatomyEntry((VertebraAnatomy,), Tool),
        "liver": AnatomyEntry((LiverAnatomy, LiverFile), Probe),
        "slab": AnatomyEntry((SlabAnatomy,), Probe),
        "layers": AnatomyEntry((LayersAnatomy,), Needle),
        "soft-tissue": AnatomyEntry((IncisedAnatomy,), Blade),
        "wall": AnatomyEntry((WallAnatomy,), Probe),
    },
    group="tissue.tissues",
)
"""Anatomies: table classes, one for each source of the shape, and class of the tools."""
MOTIONS = Registry(
    "motion.kind",
    {
        "path": MotionEntry(PathMotion),
        "thrust": MotionEntry(ThrustMotion),
        "replay": MotionEntry(ReplayMotion),
    },
    group="tissue.motions",
)
"""Motions of the tool."""

TABLES: dict[str, tuple[Registry[Any], ...]] = {
    **dict.fromkeys(("tool", "probe", "needle"), (CUTTERS, PROBES, NEEDLES)),
    "motion": (MOTIONS,),
    "tissue": (ANATOMIES,),
    "device": (DEVICES,),
    "hand": (HANDS,),
    "renderer": (RENDERERS,),
    "predictor": (PREDICTORS,),
    "perception": (PERCEPTIONS,),
    "material": (CUTTING_MATERIALS, ORGAN_MATERIALS),
    "scene": (SCENES,),
}
"""Registries in which the name of a part must be unique, keyed by kind of part."""
