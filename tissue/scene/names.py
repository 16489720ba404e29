"""Registries of the parts that the keys of a scene can name, one for each kind of part.

An entry contains the properties of a part. The functions that make built-in parts are in higher
packages.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tissue.materials.constants import constants, listed
from tissue.scene.part import Part, Registry

Factory = Callable[..., Any]


@dataclass(frozen=True)
class AnatomyEntry:
    """Properties of a tissue.

    Attributes
    ----------
    parameters
        Classes of the scene tables for this tissue, one for each source of the shape. Their
        ``kind`` is the name of the entry.
    tool
        Class of the tools for this tissue.
    build, force_N, pictures, faces
        Functions of a registered tissue, see `tissue.register`. `build` makes the objects that a
        run needs. `force_N` estimates the largest force on the scripted motion [N]. `pictures` maps
        file names to functions that draw pictures of a run. `faces` returns the faces of the tissue
        that a window shows.
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
        Function that returns the half section of a registered cutter. Its arguments are
        ``diameter_m`` and the values of `keys` in SI units: ``length_m`` for the key ``length_mm``,
        ``point_angle_rad`` for the key ``point_angle_deg``.
    keys
        Keys of the tool table that define the shape in addition to the diameter.
    """

    profile: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProbeEntry:
    """Properties of a probe.

    Attributes
    ----------
    make
        Function that makes a registered probe from its scene table.
    keys
        Keys of the tool table that define the shape.
    """

    make: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class MotionEntry:
    """Properties of a motion.

    Attributes
    ----------
    parameters
        Class of the scene table for this motion. Its ``kind`` is the name of the entry.
    make
        Function that makes a registered motion from this table and the duration of a tick [s].
    """

    parameters: type[Part]
    make: Factory | None = None


@dataclass(frozen=True)
class DeviceEntry:
    """Properties of a haptic device.

    Attributes
    ----------
    numbers
        Values of `tissue.haptics.device.device.DeviceParameters`, keyed by name, for the stability
        check and the simulated device.
    make
        Function that opens the physical device of a registered kind of device. Its argument is the
        start position of the tool in the scene [m].
    has_adapter
        True if `tissue.haptics.real` opens the real device.
    """

    numbers: Mapping[str, float]
    make: Factory | None = None
    has_adapter: bool = False

    @property
    def is_real(self) -> bool:
        """True if a physical device of this kind can be opened, not only a simulated one."""
        return self.make is not None or self.has_adapter


@dataclass(frozen=True)
class PredictorEntry:
    """Properties of a predictor.

    Attributes
    ----------
    make
        Function that makes a registered predictor from the trained data of the scene and the
        largest force of the device [N]. The data are None for a predictor that is not trained.
    trained
        True if the predictor needs the output of `tissue train`.
    colour, marker
        Colour and marker in charts, in matplotlib's notation. Empty for a registered predictor, for
        which a chart chooses them.
    """

    make: Factory | None = None
    trained: bool = False
    colour: str = ""
    marker: str = ""


PEG = ("peg_diameter_mm", "peg_length_mm")
CUTTERS = Registry(
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
"""Rotating cutters, keyed by shape."""


PROBES = Registry(
    "tool.kind",
    {
        "sphere-probe": ProbeEntry(keys=("diameter_mm",)),
        "cylinder-probe": ProbeEntry(keys=("diameter_mm", "length_mm")),
        "shell-probe": ProbeEntry(keys=("file", "scale_mm")),
    },
    group="tissue.probes",
)
"""Smooth pressing tools, keyed by shape."""
NEEDLES: Registry[Callable[..., Any] | None] = Registry(
    "tool.kind", {"needle": None}, group="tissue.needles"
)
"""Needles, with functions that return the tissue of a registered needle from ``walls``.

``walls`` are the membranes below the capsule, from the surface downwards.
"""


def _numbers(table: str, *names: str) -> dict[str, float]:
    """Return the values of a data file."""
    return {key: entry.value for name in names for key, entry in constants(table, name).items()}


REAL = ("haply", "forcedimension", "sigma-7", "openhaptics", "network", "recorded")
"""Devices that `tissue.haptics.real` opens; the other devices of the data file are simulated."""
DEVICES = Registry(
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
"""Hands that hold a device, with values of `tissue.haptics.hand.hand.HandParameters`."""
GROUPS = HANDS.known
"""Groups of people with known hands and known force perception, for studies and training."""
RENDERERS: Registry[Callable[..., Any] | None] = Registry(
    "renderer",
    {
        "penalty": None,
        "passivity": None,
        "proxy": None,
    },
    group="tissue.renderers",
)
"""Rendering laws, with functions that make a registered law from the loop of its wall."""


PREDICTORS = Registry(
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
"""Predictors of the force on a device, with chart colours after Okabe and Ito (2008)."""
PERCEPTIONS: Registry[Callable[..., Any] | None] = Registry(
    "perception",
    {
        "population": None,
        "observer:FILE": None,
    },
    group="tissue.perceptions",
)
"""Perceptual maps, which scale the force on a device."""
CUTTING_MATERIALS: Registry[tuple[str, str]] = Registry(
    "cutting.material",
    {name: ("cutting", name) for name in ("bone", "enamel", "dentin", "soft")},
    group="tissue.materials",
)
"""Materials of bone for cutting: table of `tissue.materials.constants`, and name in this table."""
ORGAN_MATERIALS: Registry[tuple[str, str]] = Registry(
    "organ.material",
    {name: ("soft", name) for name in ("liver", "pressed_liver", "kidney")},
    group="tissue.materials",
)
"""Materials of a soft organ: table of `tissue.materials.constants`, and name in this table."""
SCENES: Registry[Path] = Registry("scene", {}, group="tissue.scenes")
"""Files of registered scenes, keyed by scene name; built-in scenes are not included."""
