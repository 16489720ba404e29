"""The parts that a scene names, a table for each kind: choices, messages, loops and charts derive from it.

A line in a table makes a part known; a part from elsewhere is made known by `Registry.add`. What lies in a package
above this one is named as ``module:name`` and imported when it is asked for.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from tissue.materials.constants import constants, listed
from tissue.scene.named_parts import Registry

if TYPE_CHECKING:
    from pathlib import Path

    import pyvista

    from meshes.voxels.volume import VoxelVolume
    from tissue.builders.parts import TissueBuilder
    from tissue.cutters.profile import Profile
    from tissue.haptics.loop.sampled_loop import WallLoop
    from tissue.haptics.renderer import Renderer
    from tissue.models.needle.parameters import NeedleTissue
    from tissue.models.organ.probe import ProbeShape
    from tissue.motion.motion import Motion
    from tissue.perception.perception import PerceptionMaker
    from tissue.prediction.predictor import Predictor
    from tissue.prediction.trained import Trained
    from tissue.scene.anatomy import Part
    from tissue.scene.scene import Scene
    from tissue.scene.tool import Probe
    from tissue.simulation.run import Run

__all__ = [
    "ANATOMIES", "CUTTERS", "DEVICES", "GROUPS", "HANDS", "MOTIONS", "NEEDLES", "PERCEPTIONS", "PREDICTORS", "PROBES",
    "RENDERERS", "AnatomyEntry", "CutterEntry", "MotionEntry", "PredictorEntry", "ProbeEntry",
]  # fmt: skip


@dataclass(frozen=True)
class AnatomyEntry:
    """What a table holds of a tissue.

    Attributes
    ----------
    parameters
        What a scene states of it: a part whose ``kind`` is the entry's name.
    tool
        The part that describes the tools that it meets.
    build
        Makes the parts of a run.
    force_N
        Estimates the largest force that the tool meets on a scene's scripted motion [N], from which the scale of forces
        at a device is chosen; without it, or where it gives 0, forces pass as they are.
    pictures
        Draw what only this tissue has into a file each of a run's pictures, by the file's name.
    faces
        The faces that a window shows of a tissue that is neither voxels nor a mesh.
    voxels
        The voxels that a tool mills, as a scene describes them.
    """

    parameters: "type[Part] | str"
    tool: "type[Part] | str"
    build: "TissueBuilder | str"
    force_N: "Callable[[Scene], float] | str | None" = None
    pictures: "Mapping[str, Callable[[Run, Path], None] | str]" = field(default_factory=dict)
    faces: "Callable[[Scene], dict[str, pyvista.PolyData]] | str | None" = None
    voxels: "Callable[[Scene], VoxelVolume] | str | None" = None


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
        "molar": AnatomyEntry(
            "tissue.scene.anatomy:MolarAnatomy",
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
            pictures={"insertion.png": "tissue.figures.insertion:draw_insertion"},
            faces="tissue.viewer.run:layer_faces",
        ),
        "wall": AnatomyEntry(
            "tissue.scene.coupling:WallAnatomy",
            "tissue.scene.tool:Probe",
            "tissue.builders.organ_scene:wall",
            pictures={"wall.png": "tissue.figures.wall:draw_wall"},
            faces="tissue.viewer.run:wall_face",
        ),
    },
)
"""What a tool meets."""


@dataclass(frozen=True)
class CutterEntry:
    """What a table holds of a cutter.

    Attributes
    ----------
    profile
        Its half section from ``diameter_m`` and what else shapes it: ``length_m`` of ``length_mm``, ``point_angle_rad``
        of ``point_angle_deg``.
    keys
        Those of the tool's keys that shape this cutter beside its diameter.
    """

    profile: "Callable[..., Profile] | str"
    keys: tuple[str, ...] = ()


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
)
"""Rotating cutters, by their shape."""


@dataclass(frozen=True)
class ProbeEntry:
    """What a table holds of a probe.

    Attributes
    ----------
    make
        Makes one of what a scene states of it.
    keys
        Those of the tool's keys that shape this probe.
    """

    make: "Callable[[Probe], ProbeShape] | str"
    keys: tuple[str, ...]


PROBES: Registry[ProbeEntry] = Registry(
    "tool.kind",
    {
        "sphere-probe": ProbeEntry("tissue.builders.probe:sphere", ("diameter_mm",)),
        "cylinder-probe": ProbeEntry("tissue.builders.probe:cylinder", ("diameter_mm", "length_mm")),
        "shell-probe": ProbeEntry("tissue.builders.probe:shell", ("file", "scale_mm")),
    },
)
"""Smooth tools that press, by their shape."""
NEEDLES: "Registry[Callable[..., NeedleTissue]]" = Registry(
    "tool.kind", {"needle": "tissue.models.needle.parameters:needle_tissue"}
)
"""Needles: what each meets in tissue, from ``vessel_wall_depth_m`` [m], None where there is no vessel."""


@dataclass(frozen=True)
class MotionEntry:
    """What a table holds of a motion.

    Attributes
    ----------
    parameters
        What a scene states of it: a part whose ``kind`` is the entry's name.
    make
        Makes one of that, for ticks of so many seconds.
    """

    parameters: "type[Part] | str"
    make: "Callable[..., Motion] | str"


MOTIONS: Registry[MotionEntry] = Registry(
    "motion.kind",
    {
        "path": MotionEntry("tissue.scene.tool:PathMotion", "tissue.builders.registry:path"),
        "thrust": MotionEntry("tissue.scene.tool:ThrustMotion", "tissue.builders.registry:thrust"),
        "replay": MotionEntry("tissue.scene.tool:ReplayMotion", "tissue.builders.registry:replay"),
    },
)
"""What moves the tool."""


def _numbers(table: str, *names: str) -> dict[str, float]:
    """Values of a data file, later names over earlier ones."""
    return {key: entry.value for name in names for key, entry in constants(table, name).items()}


DEVICES: Registry[Mapping[str, float]] = Registry(
    "device", {name: _numbers("devices", name) for name in listed("devices")}
)
"""Haptic devices: the numbers of `tissue.haptics.device.device.DeviceParameters` by their names."""
HANDS: Registry[Mapping[str, float]] = Registry(
    "hand", {name: _numbers("hands", "any", name) for name in listed("hands") if name != "any"}
)
"""Hands that hold a device: the numbers of `tissue.haptics.hand.hand.HandParameters` by their names."""
GROUPS = HANDS.names
"""Groups of people whose senses are known beside their hands: those of studies and of training."""
RENDERERS: "Registry[Callable[[WallLoop], Renderer]]" = Registry(
    "renderer",
    {
        "penalty": "tissue.haptics.renderer:penalty",
        "passivity": "tissue.haptics.renderer:passivity",
        "proxy": "tissue.haptics.renderer:proxy",
    },
)
"""Laws by which a device plays what the tool meets: each from the loop of its wall."""


@dataclass(frozen=True)
class PredictorEntry:
    """What a table holds of a predictor.

    Attributes
    ----------
    make
        Makes one from what was trained for the scene, None for one that is not trained, and the device's greatest force
        [N].
    trained
        Whether it needs what `tissue train` writes.
    colour, marker
        Its own in charts, as matplotlib has them.
    """

    make: "Callable[[Trained | None, float], Predictor] | str"
    trained: bool = False
    colour: str = "#D55E00"
    marker: str = "*"


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
)
"""What predicts the force on a device; colours after Okabe and Ito (2008)."""
PERCEPTIONS: "Registry[PerceptionMaker]" = Registry(
    "perception",
    {
        "population": "tissue.builders.perception:of_population",
        "observer:FILE": "tissue.builders.perception:of_observer",
    },
)
"""For whom the force on a device is scaled."""
