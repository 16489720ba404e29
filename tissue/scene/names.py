"""Names of the parts that a scene's keys choose from, with a registry for each kind of part.

The entries hold the properties of a part. Factories of built-in parts are in the packages above.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tissue.materials.constants import constants, listed
from tissue.scene.part import Part, Registry

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
    """Properties of a tissue.

    Attributes
    ----------
    parameters
        Tables for this tissue in a scene, one for each source of its shape. Their ``kind`` is the
        entry's name.
    tool
        Table of the tools that act on it.
    build, force_N, pictures, faces
        Functions of a registered tissue, see `tissue.register`. They make the parts of a run,
        estimate the largest force on a scene's scripted motion [N], draw pictures of a run by file
        name, and return the faces in a window.
    """

    parameters: tuple[type[Part], ...]
    tool: type[Part]
    build: Factory | None = None
    force_N: Factory | None = None
    pictures: Mapping[str, Factory] = field(default_factory=dict)
    faces: Factory | None = None


@dataclass(frozen=True)
class CutterEntry:
    """Properties of a cutter.

    Attributes
    ----------
    profile
        Function of a registered cutter that returns its half section from ``diameter_m`` and the
        sizes of `keys`: ``length_m`` for ``length_mm``, ``point_angle_rad`` for
        ``point_angle_deg``.
    keys
        Keys of the tool that define its shape, in addition to its diameter.
    """

    profile: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProbeEntry:
    """Properties of a probe.

    Attributes
    ----------
    make
        Function of a registered probe that makes it from its table in a scene.
    keys
        Keys of the tool that define its shape.
    """

    make: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class MotionEntry:
    """Properties of a motion.

    Attributes
    ----------
    parameters
        Table for this motion in a scene, whose ``kind`` is the entry's name.
    make
        Function of a registered motion that makes it from that table and the length of a tick [s].
    """

    parameters: type[Part]
    make: Factory | None = None


@dataclass(frozen=True)
class DeviceEntry:
    """Properties of a haptic device.

    Attributes
    ----------
    numbers
        Values of `tissue.haptics.device.device.DeviceParameters` by name. They are used to judge
        and simulate the device.
    make
        Function of a registered device that opens the real device, given the start position of the
        tool in the scene [m].
    has_adapter
        True if `tissue.haptics.real` opens the real device.
    """

    numbers: Mapping[str, float]
    make: Factory | None = None
    has_adapter: bool = False

    @property
    def is_real(self) -> bool:
        """True if a real device can be opened."""
        return self.make is not None or self.has_adapter


@dataclass(frozen=True)
class PredictorEntry:
    """Properties of a predictor.

    Attributes
    ----------
    make
        Function of a registered predictor that makes it from the trained data of the scene and the
        device's largest force [N]. The data are None for a predictor that is not trained.
    trained
        True if it needs the output of `tissue train`.
    colour, marker
        Colour and marker in charts, in matplotlib's notation.
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
        "twist-drill": CutterEntry(keys=("length_mm", "point_angle_deg", "web_mm", "helix_deg")),
        "hemispherical-reamer": CutterEntry(keys=PEG),
        "flat-reamer": CutterEntry(keys=("length_mm", *PEG)),
    },
    group="tissue.tools",
)
"""Rotating cutters by shape."""


PROBES: Registry[ProbeEntry] = Registry(
    "tool.kind",
    {
        "sphere-probe": ProbeEntry(keys=("diameter_mm",)),
        "cylinder-probe": ProbeEntry(keys=("diameter_mm", "length_mm")),
        "shell-probe": ProbeEntry(keys=("file", "scale_mm")),
    },
    group="tissue.probes",
)
"""Smooth tools that press, by shape."""
NEEDLES: Registry[Callable[..., Any] | None] = Registry(
    "tool.kind", {"needle": None}, group="tissue.needles"
)
"""Needles: functions that return the tissue of a registered needle from ``walls``.

``walls`` are the membranes below the capsule, from the surface downwards.
"""


def _numbers(table: str, *names: str) -> dict[str, float]:
    """Return the values of a data file; later names override earlier ones."""
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
"""Hands that hold a device, as values of `tissue.haptics.hand.hand.HandParameters` by name."""
GROUPS = HANDS.known
"""Groups of operators with known hands and known senses, used in studies and in training."""
RENDERERS: Registry[Callable[..., Any] | None] = Registry(
    "renderer",
    {
        "penalty": None,
        "passivity": None,
        "proxy": None,
    },
    group="tissue.renderers",
)
"""Rendering laws: functions that return the law of a registered renderer from its wall's loop."""


PREDICTORS: Registry[PredictorEntry] = Registry(
    "prediction",
    {
        "hold": PredictorEntry(colour="0.45", marker="s"),
        "linear": PredictorEntry(colour="#E69F00", marker="^"),
        "kalman": PredictorEntry(colour="#CC79A7", marker="v"),
        "koopman": PredictorEntry(trained=True, colour="#0072B2", marker="o"),
        "koopman-look-ahead": PredictorEntry(trained=True, colour="#D55E00", marker="P"),
        "koopman-online": PredictorEntry(colour="#009E73", marker="D"),
    },
    group="tissue.predictors",
)
"""Predictors of the force on a device; colours after Okabe and Ito (2008)."""
PERCEPTIONS: Registry[Callable[..., Any] | None] = Registry(
    "perception",
    {
        "population": None,
        "observer:FILE": None,
    },
    group="tissue.perceptions",
)
"""Perception models that scale the force on a device."""
CUTTING_MATERIALS: Registry[tuple[str, str]] = Registry(
    "cutting.material",
    {name: ("cutting", name) for name in ("bone", "enamel", "dentin", "soft")},
    group="tissue.materials",
)
"""Materials for cutting bone: table of `tissue.materials.constants`, and name in it."""
ORGAN_MATERIALS: Registry[tuple[str, str]] = Registry(
    "organ.material",
    {name: ("soft", name) for name in ("liver", "pressed_liver", "kidney")},
    group="tissue.materials",
)
"""Materials of a soft organ: table of `tissue.materials.constants`, and name in it."""
SCENES: Registry[Path] = Registry("scene", {}, group="tissue.scenes")
"""Files of registered scenes by scene name, without the built-in scenes."""
