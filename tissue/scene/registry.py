"""Registries of anatomies and motions, and the registries of all kinds of parts.

Choices, messages, loops and charts use these registries. A line in a registry adds a part.
`tissue.register` and the entry points of installed packages also add parts.
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
"""Anatomies: for each kind, the table classes for each source of the shape, and the class of its
tools.
"""
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
"""Registries within which a name may be used only once, keyed by kind of part."""
