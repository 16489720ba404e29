"""The parts that a scene names, a table for each kind: choices, messages, loops and charts derive from it.

A line in a table makes a part known; a part from elsewhere is made known by `tissue.register`, or by the entry points
of an installed package. What lies in a package above this one is named as ``module:name`` and imported when it is asked
for.
"""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from tissue.materials.constants import constants, listed
from tissue.scene.entries import (
    AnatomyEntry,
    CutterEntry,
    DeviceEntry,
    MotionEntry,
    PredictorEntry,
    ProbeEntry,
)
from tissue.scene.named_parts import Registry

if TYPE_CHECKING:
    from pathlib import Path

    from tissue.haptics.loop.sampled_loop import WallLoop
    from tissue.haptics.renderer import Renderer
    from tissue.models.needle.parameters import NeedleTissue
    from tissue.perception.perception import PerceptionMaker

__all__ = [
    "ANATOMIES", "CUTTERS", "CUTTING_MATERIALS", "DEVICES", "GROUPS", "HANDS", "MOTIONS", "NEEDLES", "ORGAN_MATERIALS",
    "PERCEPTIONS", "PREDICTORS", "PROBES", "RENDERERS", "SCENES", "TABLES", "AnatomyEntry", "CutterEntry",
    "DeviceEntry", "MotionEntry", "PredictorEntry", "ProbeEntry",
]  # fmt: skip


ANATOMIES: Registry[AnatomyEntry] = Registry(
    "anatomy.kind",
    {
        "glenoid": AnatomyEntry(
            "tissue.scene.anatomy:GlenoidAnatomy",
            "tissue.scene.tool:Tool",
            "tissue.builders.cutting:milled",
            force_N="tissue.builders.force_met:cut",
            voxels="tissue.builders.cutting:milled_voxels",
        ),
        "block": AnatomyEntry(
            "tissue.scene.anatomy:BlockAnatomy",
            "tissue.scene.tool:Tool",
            "tissue.builders.cutting:milled",
            force_N="tissue.builders.force_met:cut",
            voxels="tissue.builders.cutting:milled_voxels",
        ),
        "bone": AnatomyEntry(
            "tissue.scene.anatomy:BoneAnatomy",
            "tissue.scene.tool:Tool",
            "tissue.builders.cutting:milled",
            force_N="tissue.builders.force_met:cut",
            voxels="tissue.builders.cutting:milled_voxels",
        ),
        "molar": AnatomyEntry(
            "tissue.scene.anatomy:MolarAnatomy",
            "tissue.scene.tool:Tool",
            "tissue.builders.cutting:milled",
            force_N="tissue.builders.force_met:cut",
            voxels="tissue.builders.cutting:milled_voxels",
        ),
        "vertebra": AnatomyEntry(
            "tissue.scene.vertebra:VertebraAnatomy",
            "tissue.scene.tool:Tool",
            "tissue.builders.cutting:milled",
            force_N="tissue.builders.force_met:cut",
            voxels="tissue.builders.cutting:milled_voxels",
        ),
        "liver": AnatomyEntry(
            "tissue.scene.organ:LiverAnatomy",
            "tissue.scene.tool:Probe",
            "tissue.builders.organ_scene:pressed",
            force_N="tissue.builders.force_met:pressed",
        ),
        "slab": AnatomyEntry(
            "tissue.scene.organ:SlabAnatomy",
            "tissue.scene.tool:Probe",
            "tissue.builders.organ_scene:pressed",
            force_N="tissue.builders.force_met:pressed",
        ),
        "layers": AnatomyEntry(
            "tissue.scene.organ:LayersAnatomy",
            "tissue.scene.tool:Needle",
            "tissue.builders.organ_scene:pierced",
            force_N="tissue.builders.force_met:pierced",
            pictures={"insertion.png": "tissue.figures.force_depth:draw_insertion"},
            faces="tissue.viewer.saved_surfaces:layer_faces",
        ),
        "wall": AnatomyEntry(
            "tissue.scene.coupling:WallAnatomy",
            "tissue.scene.tool:Probe",
            "tissue.builders.organ_scene:wall",
            pictures={"wall.png": "tissue.figures.force_depth:draw_wall"},
            faces="tissue.viewer.saved_surfaces:wall_face",
        ),
    },
    group="tissue.tissues",
)
"""What a tool meets."""


PEG = ("peg_diameter_mm", "peg_length_mm")
CUTTERS: Registry[CutterEntry] = Registry(
    "tool.kind",
    {
        "ball-burr": CutterEntry("tissue.cutters.profile:ball_burr"),
        "pear-bur": CutterEntry("tissue.cutters.profile:pear_bur", ("length_mm",)),
        "cylinder": CutterEntry("tissue.cutters.profile:cylinder", ("length_mm",)),
        "twist-drill": CutterEntry("tissue.cutters.profile:twist_drill", ("length_mm", "point_angle_deg")),
        "hemispherical-reamer": CutterEntry("tissue.cutters.profile:hemispherical_reamer", PEG),
        "flat-reamer": CutterEntry("tissue.cutters.profile:flat_reamer", ("length_mm", *PEG)),
    },
    group="tissue.tools",
)
"""Rotating cutters, by their shape."""


PROBES: Registry[ProbeEntry] = Registry(
    "tool.kind",
    {
        "sphere-probe": ProbeEntry("tissue.builders.probe:sphere", ("diameter_mm",)),
        "cylinder-probe": ProbeEntry("tissue.builders.probe:cylinder", ("diameter_mm", "length_mm")),
        "shell-probe": ProbeEntry("tissue.builders.probe:shell", ("file", "scale_mm")),
    },
    group="tissue.probes",
)
"""Smooth tools that press, by their shape."""
NEEDLES: "Registry[Callable[..., NeedleTissue]]" = Registry(
    "tool.kind", {"needle": "tissue.models.needle.parameters:needle_tissue"}, group="tissue.needles"
)
"""Needles: what each meets in tissue, from ``walls``, the membranes under the capsule from the surface downwards."""


MOTIONS: Registry[MotionEntry] = Registry(
    "motion.kind",
    {
        "path": MotionEntry("tissue.scene.tool:PathMotion", "tissue.builders.registry:path"),
        "thrust": MotionEntry("tissue.scene.tool:ThrustMotion", "tissue.builders.registry:thrust"),
        "replay": MotionEntry("tissue.scene.tool:ReplayMotion", "tissue.builders.registry:replay"),
    },
    group="tissue.motions",
)
"""What moves the tool."""


def _numbers(table: str, *names: str) -> dict[str, float]:
    """Values of a data file, later names over earlier ones."""
    return {key: entry.value for name in names for key, entry in constants(table, name).items()}


ADAPTERS = {
    "haply": "tissue.hardware.haply:HaplyAdapter",
    "forcedimension": "tissue.hardware.forcedimension:ForceDimensionAdapter",
    "sigma-7": "tissue.hardware.forcedimension:SigmaAdapter",
    "openhaptics": "tissue.hardware.openhaptics:OpenHapticsAdapter",
    "network": "tissue.hardware.network:NetworkAdapter",
    "recorded": "tissue.hardware.recorded:RecordedAdapter",
}
"""What opens a real device, by its name; the others of the data file are simulated."""
DEVICES: Registry[DeviceEntry] = Registry(
    "device",
    {name: DeviceEntry(_numbers("devices", name), adapter=ADAPTERS.get(name)) for name in listed("devices")},
    group="tissue.devices",
)
"""Haptic devices."""
HANDS: Registry[Mapping[str, float]] = Registry(
    "hand", {name: _numbers("hands", "any", name) for name in listed("hands") if name != "any"}, group="tissue.hands"
)
"""Hands that hold a device: the numbers of `tissue.haptics.hand.hand.HandParameters` by their names."""
GROUPS = HANDS.known
"""Groups of people whose senses are known beside their hands: those of studies and of training."""
RENDERERS: "Registry[Callable[[WallLoop], Renderer]]" = Registry(
    "renderer",
    {
        "penalty": "tissue.haptics.renderer:penalty",
        "passivity": "tissue.haptics.renderer:passivity",
        "proxy": "tissue.haptics.renderer:proxy",
    },
    group="tissue.renderers",
)
"""Laws by which a device plays what the tool meets: each from the loop of its wall."""


PREDICTORS: Registry[PredictorEntry] = Registry(
    "prediction",
    {
        "hold": PredictorEntry("tissue.builders.prediction:hold", colour="0.45", marker="s"),
        "linear": PredictorEntry("tissue.builders.prediction:linear", colour="#E69F00", marker="^"),
        "kalman": PredictorEntry("tissue.builders.prediction:kalman", colour="#CC79A7", marker="v"),
        "dmdc": PredictorEntry("tissue.builders.prediction:dmdc", trained=True, colour="#009E73", marker="D"),
        "look-ahead": PredictorEntry("tissue.builders.prediction:look_ahead", colour="#56B4E9", marker="<"),
        "koopman": PredictorEntry("tissue.builders.prediction:koopman", trained=True, colour="#0072B2", marker="o"),
        "koopman-look-ahead": PredictorEntry(
            "tissue.builders.prediction:koopman_look_ahead", trained=True, colour="#D55E00", marker="P"
        ),
    },
    group="tissue.predictors",
)
"""What predicts the force on a device; colours after Okabe and Ito (2008)."""
PERCEPTIONS: "Registry[PerceptionMaker]" = Registry(
    "perception",
    {
        "population": "tissue.builders.perception:of_population",
        "observer:FILE": "tissue.builders.perception:of_observer",
    },
    group="tissue.perceptions",
)
"""For whom the force on a device is scaled."""
CUTTING_MATERIALS: Registry[tuple[str, str]] = Registry(
    "cutting.material",
    {name: ("cutting", name) for name in ("bone", "enamel", "dentin", "soft")},
    group="tissue.materials",
)
"""What bone may be cut as: the table of `tissue.materials.constants` and the name there."""
ORGAN_MATERIALS: Registry[tuple[str, str]] = Registry(
    "organ.material", {name: ("soft", name) for name in ("liver", "kidney")}, group="tissue.materials"
)
"""What a soft organ may be made of."""
SCENES: "Registry[Path]" = Registry("scene", {}, group="tissue.scenes")
"""Files of scenes from elsewhere, by the names that they hold; those of the library are not among them."""

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
