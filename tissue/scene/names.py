"""Names of the parts that a scene's keys choose from, a table for each kind of part.

The entries hold the properties of a part. Factories of built-in parts lie in the packages above.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tissue.materials.constants import constants, listed
from tissue.scene.named_parts import Registry
from tissue.scene.part import Part

__all__ = [
    "CUTTERS",
    "CUTTING_MATERIALS",
    "DEVICES",
    "GROUPS",
    "HANDS",
    "NEEDLES",
    "ORGAN_MATERIALS",
    "PERCEPTIONS",
    "PREDICTORS",
    "PROBES",
    "RENDERERS",
    "SCENES",
    "AnatomyEntry",
    "CutterEntry",
    "DeviceEntry",
    "MotionEntry",
    "PredictorEntry",
    "ProbeEntry",
]

Factory = Callable[..., Any]


@dataclass(frozen=True)
class AnatomyEntry:
    """A tissue.

    Attributes
    ----------
    parameters
        Tables that a scene may state of it, whose ``kind`` is the entry's name, by the source of
        its shape.
    tool
        The table that describes the tools that it meets.
    build, force_N, pictures, faces
        Of a part from outside, see `tissue.register`: what makes the parts of a run, estimates the
        largest force on a scene's scripted motion [N], draws pictures of a run by their files'
        names, and returns the faces in a window.
    """

    parameters: "tuple[type[Part], ...] | type[Part]"
    tool: type[Part]
    build: Factory | None = None
    force_N: Factory | None = None
    pictures: Mapping[str, Factory] = field(default_factory=dict)
    faces: Factory | None = None

    @property
    def variants(self) -> tuple[type[Part], ...]:
        """Tables that a scene may state of it."""
        return self.parameters if isinstance(self.parameters, tuple) else (self.parameters,)


@dataclass(frozen=True)
class CutterEntry:
    """A cutter.

    Attributes
    ----------
    profile
        Of a part from outside: its half section from ``diameter_m`` and what else shapes it,
        ``length_m`` of ``length_mm``, ``point_angle_rad`` of ``point_angle_deg``.
    keys
        Keys of the tool that shape it, next to its diameter.
    """

    profile: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProbeEntry:
    """A probe.

    Attributes
    ----------
    make
        Of a part from outside: makes a probe of what a scene states of it.
    keys
        Keys of the tool that shape it.
    """

    make: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class MotionEntry:
    """A motion.

    Attributes
    ----------
    parameters
        Table that a scene states of it, whose ``kind`` is the entry's name.
    make
        Of a part from outside: makes a motion of that table, for ticks of so many seconds.
    """

    parameters: type[Part]
    make: Factory | None = None


@dataclass(frozen=True)
class DeviceEntry:
    """A haptic device.

    Attributes
    ----------
    numbers
        Values of `tissue.haptics.device.device.DeviceParameters` by their names, which judge and
        simulate it.
    make
        Of a part from outside: opens the real device, from where the tool starts in the scene [m].
    has_adapter
        Whether `tissue.haptics.real` opens the real device.
    """

    numbers: Mapping[str, float]
    make: Factory | None = None
    has_adapter: bool = False

    @property
    def is_real(self) -> bool:
        """Whether a real device can be opened."""
        return self.make is not None or self.has_adapter


@dataclass(frozen=True)
class PredictorEntry:
    """A predictor.

    Attributes
    ----------
    make
        Of a part from outside: makes a predictor from what was trained for the scene, None for one
        that is not trained, and the device's largest force [N].
    trained
        Whether it needs what `tissue train` writes.
    colour, marker
        Its colour and marker in charts, as matplotlib has them.
    """

    make: Factory | None = None
    trained: bool = False
    colour: str = "#D55E00"
    marker: str = "*"


PEG = ("peg_diameter_mm", "peg_length_mm")
CUTTERS: Registry[CutterEntry] = Registry(
    "tool.kind",
    {
        "ball-burr": CutterEntry(),
        "pear-bur": CutterEntry(keys=("length_mm",)),
        "cylinder": CutterEntry(keys=("length_mm",)),
        "twist-drill": CutterEntry(keys=("length_mm", "point_angle_deg")),
        "hemispherical-reamer": CutterEntry(keys=PEG),
        "flat-reamer": CutterEntry(keys=("length_mm", *PEG)),
    },
    group="tissue.tools",
)
"""Rotating cutters, by their shape."""


PROBES: Registry[ProbeEntry] = Registry(
    "tool.kind",
    {
        "sphere-probe": ProbeEntry(keys=("diameter_mm",)),
        "cylinder-probe": ProbeEntry(keys=("diameter_mm", "length_mm")),
        "shell-probe": ProbeEntry(keys=("file", "scale_mm")),
    },
    group="tissue.probes",
)
"""Smooth tools that press, by their shape."""
NEEDLES: Registry[Callable[..., Any] | None] = Registry(
    "tool.kind", {"needle": None}, group="tissue.needles"
)
"""Needles: what each meets in tissue, from ``walls``, the membranes under the capsule from the
surface downwards.
"""


def _numbers(table: str, *names: str) -> dict[str, float]:
    """Values of a data file, later names over earlier ones."""
    return {key: entry.value for name in names for key, entry in constants(table, name).items()}


REAL = ("haply", "forcedimension", "sigma-7", "openhaptics", "network", "recorded")
"""Devices that `tissue.haptics.real` opens; the others of the data file are simulated."""
DEVICES: Registry[DeviceEntry] = Registry(
    "device",
    {
        name: DeviceEntry(_numbers("devices", name), has_adapter=name in REAL)
        for name in listed("devices")
    },
    group="tissue.devices",
)
"""Haptic devices."""
HANDS: Registry[Mapping[str, float]] = Registry(
    "hand",
    {name: _numbers("hands", "any", name) for name in listed("hands") if name != "any"},
    group="tissue.hands",
)
"""Hands that hold a device: the numbers of `tissue.haptics.hand.hand.HandParameters` by their
names.
"""
GROUPS = HANDS.known
"""Groups of people whose senses are known beside their hands: those of studies and of training."""
RENDERERS: Registry[Callable[..., Any] | None] = Registry(
    "renderer",
    {
        "penalty": None,
        "passivity": None,
        "proxy": None,
    },
    group="tissue.renderers",
)
"""Laws by which a device plays what the tool meets: each from the loop of its wall."""


PREDICTORS: Registry[PredictorEntry] = Registry(
    "prediction",
    {
        "hold": PredictorEntry(colour="0.45", marker="s"),
        "linear": PredictorEntry(colour="#E69F00", marker="^"),
        "kalman": PredictorEntry(colour="#CC79A7", marker="v"),
        "dmdc": PredictorEntry(trained=True, colour="#009E73", marker="D"),
        "look-ahead": PredictorEntry(colour="#56B4E9", marker="<"),
        "koopman": PredictorEntry(trained=True, colour="#0072B2", marker="o"),
        "koopman-look-ahead": PredictorEntry(trained=True, colour="#D55E00", marker="P"),
    },
    group="tissue.predictors",
)
"""What predicts the force on a device; colours after Okabe and Ito (2008)."""
PERCEPTIONS: Registry[Callable[..., Any] | None] = Registry(
    "perception",
    {
        "population": None,
        "observer:FILE": None,
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
    "organ.material",
    {name: ("soft", name) for name in ("liver", "kidney")},
    group="tissue.materials",
)
"""What a soft organ may be made of."""
SCENES: Registry[Path] = Registry("scene", {}, group="tissue.scenes")
"""Files of scenes from elsewhere, by the names that they hold; those of the library are not
among them.
"""
