"""Registries of parts, such as tools and devices, that keys of a scene select by name.

There is one registry for each kind of part. An entry contains the properties of a part. The code of
built-in parts is in other packages.
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
    """Properties of a kind of tissue (anatomy).

    Attributes
    ----------
    parameters
        Classes of the table ``anatomy`` for this tissue: one for each source of the shape, such as
        formulas or a surface file. The value of the key ``kind`` in these tables is the name of the
        entry.
    tool
        Class of the tools that can work on this tissue.
    build, force_N, pictures, faces
        Functions of a registered tissue, see `tissue.register`. `build` makes the objects that a
        run needs. `force_N` estimates the largest force [N] during the tool motion in the scene.
        `pictures` maps file names to functions that draw pictures of a run. `faces` returns the
        triangles that a window draws to show the tissue.
    """

    parameters: tuple[type[Part], ...]
    tool: type[Part]
    build: Factory | None = None
    force_N: Factory | None = None
    pictures: Mapping[str, Factory] = field(default_factory=dict)
    faces: Factory | None = None


@dataclass(frozen=True)
class CutterEntry:
    """Properties of a kind of rotating cutter.

    Attributes
    ----------
    profile
        Function that returns the half section of a registered cutter. Its arguments are
        ``diameter_m`` and one argument in SI units for each of `keys`: ``length_m`` for the key
        ``length_mm``, ``point_angle_rad`` for the key ``point_angle_deg``.
    keys
        Keys of the table ``tool`` that define the shape in addition to the diameter.
    """

    profile: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProbeEntry:
    """Properties of a kind of smooth pressing tool.

    Attributes
    ----------
    make
        Function that makes a registered probe from the table ``tool`` of a scene.
    keys
        Keys of the table ``tool`` that define the shape.
    """

    make: Factory | None = None
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class MotionEntry:
    """Properties of a kind of motion.

    Attributes
    ----------
    parameters
        Class of the table ``motion`` for this motion. The value of the key ``kind`` in this table
        is the name of the entry.
    make
        Function that makes a registered motion from an instance of `parameters` and the duration of
        a tick [s].
    """

    parameters: type[Part]
    make: Factory | None = None


@dataclass(frozen=True)
class DeviceEntry:
    """Properties of a kind of haptic device.

    Attributes
    ----------
    numbers
        Values of `tissue.haptics.device.device.DeviceParameters`, keyed by name. The stability
        check and the simulated device use them.
    make
        Function that opens the real device; set only for a registered kind of device. Its argument
        is the start position of the tool in the scene [m].
    has_adapter
        True if `tissue.haptics.real` can open the real device.
    """

    numbers: Mapping[str, float]
    make: Factory | None = None
    has_adapter: bool = False

    @property
    def is_real(self) -> bool:
        """True if a real device of this kind can be opened, not only a simulated device."""
        return self.make is not None or self.has_adapter


@dataclass(frozen=True)
class PredictorEntry:
    """Properties of a kind of force predictor.

    Attributes
    ----------
    make
        Function that makes a registered predictor. Its arguments are the data that `tissue train`
        wrote for the scene (None for an untrained predictor), and the largest force of the device
        [N].
    trained
        True if the predictor needs the output of `tissue train`.
    colour, marker
        Colour and marker in charts, in matplotlib's notation. If they are empty, a chart chooses
        them.
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
"""Needles; the entry of a registered needle is a function that returns the needle's tissue.

The argument ``walls`` of the function contains the membranes in the tissue, ordered by depth.
"""


def _numbers(table: str, *names: str) -> dict[str, float]:
    """Return values from a table of the data files in `tissue/materials`."""
    return {key: entry.value for name in names for key, entry in constants(table, name).items()}


REAL = ("haply", "forcedimension", "sigma-7", "openhaptics", "network", "recorded")
"""Real devices that `tissue.haptics.real` can open; all other built-in devices are simulated."""
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
"""Simulated hands, with values of `tissue.haptics.hand.hand.HandParameters`."""
GROUPS = HANDS.known
"""User groups whose hands and force perception have parameters, for studies and training."""
RENDERERS: Registry[Callable[..., Any] | None] = Registry(
    "renderer",
    {
        "penalty": None,
        "passivity": None,
        "proxy": None,
    },
    group="tissue.renderers",
)
"""Rendering laws; the entry of a registered law is a function that makes it from a `WallLoop`."""


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
"""Predictors of the force at a device, with chart colours from Okabe and Ito (2008)."""
PERCEPTIONS: Registry[Callable[..., Any] | None] = Registry(
    "perception",
    {
        "population": None,
        "observer:FILE": None,
    },
    group="tissue.perceptions",
)
"""Perception models, which scale the force at a device for a person."""
CUTTING_MATERIALS: Registry[tuple[str, str]] = Registry(
    "cutting.material",
    {name: ("cutting", name) for name in ("bone", "enamel", "dentin", "soft")},
    group="tissue.materials",
)
"""Materials to cut, keyed by name in scenes: table and name in `tissue.materials.constants`."""
ORGAN_MATERIALS: Registry[tuple[str, str]] = Registry(
    "organ.material",
    {name: ("soft", name) for name in ("liver", "pressed_liver", "kidney")},
    group="tissue.materials",
)
"""Materials of organs, keyed by name in scenes: table and name in `tissue.materials.constants`."""
SCENES: Registry[Path] = Registry("scene", {}, group="tissue.scenes")
"""Files of registered scenes, keyed by scene name; built-in scenes are not included."""
