"""What the tables of `tissue.scene.registry` hold of a part."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

    import pyvista

    from meshes.voxels.volume import VoxelVolume
    from tissue.builders.parts import TissueBuilder
    from tissue.cutters.profile import Profile
    from tissue.haptics.device.device import Device
    from tissue.hardware.adapter import HardwareAdapter
    from tissue.models.organ.probe import ProbeShape
    from tissue.motion.motion import Motion
    from tissue.motion.quaternion import Triple
    from tissue.prediction.predictor import Predictor
    from tissue.prediction.trained import Trained
    from tissue.scene.anatomy import Part
    from tissue.scene.hardware import Hardware
    from tissue.scene.scene import Scene
    from tissue.scene.tool import Probe
    from tissue.simulation.run import Run

__all__ = ["AnatomyEntry", "CutterEntry", "DeviceEntry", "MotionEntry", "PredictorEntry", "ProbeEntry"]


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


@dataclass(frozen=True)
class DeviceEntry:
    """What a table holds of a haptic device.

    Attributes
    ----------
    numbers
        Those of `tissue.haptics.device.device.DeviceParameters` by their names: what judges and simulates it.
    make
        Opens the real one, from where the tool starts in the scene [m]; without it a simulated one is held.
    adapter
        The real one in its own frame, made of the scene's ``hardware``; a `tissue.hardware.mapped.MappedDevice` turns
        it into the scene's. Its class has ``find()``, which returns a list of `tissue.hardware.adapter.FoundDevice`.
    """

    numbers: Mapping[str, float]
    make: "Callable[[Triple], Device] | str | None" = None
    adapter: "Callable[[Hardware], HardwareAdapter] | str | None" = None

    @property
    def is_real(self) -> bool:
        """Whether a real device can be opened."""
        return self.make is not None or self.adapter is not None


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
