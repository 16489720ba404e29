"""The parts that a scene names, a table for each kind: choices, messages, loops and charts derive
from it.

A line in a table makes a part known. `tissue.register` and the entry points of installed packages
add parts.
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
from tissue.scene.named_parts import Registry
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
from tissue.scene.organ import LayersAnatomy, LiverAnatomy, LiverFile, SlabAnatomy
from tissue.scene.tool import Needle, PathMotion, Probe, ReplayMotion, ThrustMotion, Tool

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

ANATOMIES: Registry[AnatomyEntry] = Registry(
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
        "wall": AnatomyEntry((WallAnatomy,), Probe),
    },
    group="tissue.tissues",
)
"""What a tool meets: the tables of each kind, by the source of its shape, and its tools."""
MOTIONS: Registry[MotionEntry] = Registry(
    "motion.kind",
    {
        "path": MotionEntry(PathMotion),
        "thrust": MotionEntry(ThrustMotion),
        "replay": MotionEntry(ReplayMotion),
    },
    group="tissue.motions",
)
"""What moves the tool."""

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
"""The tables in which a part of each kind has a name of its own."""
