"""What the tables of named parts hold of a part. Factories of built-in parts lie in the packages
above.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from tissue.scene.part import Part

__all__ = [
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
