"""Adapters of real devices by name, and a search for connected devices."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from tissue.haptics.real.adapter import FoundDevice
from tissue.scene.registry import DEVICES

__all__ = ["adapter_class", "devices"]

ADAPTERS = {
    "haply": ("haply", "HaplyAdapter"),
    "forcedimension": ("forcedimension", "ForceDimensionAdapter"),
    "sigma-7": ("forcedimension", "SigmaAdapter"),
    "openhaptics": ("openhaptics", "OpenHapticsAdapter"),
    "network": ("network", "NetworkAdapter"),
    "recorded": ("recorded", "RecordedAdapter"),
}
"""Module of this package and class that opens a real device, by the device's name."""


def adapter_class(name: str) -> Callable[..., Any]:
    """Return the class of the adapter that opens a device, called with the scene's `Hardware`."""
    module, attribute = ADAPTERS[name]
    found: Callable[..., Any] = getattr(import_module(f"tissue.haptics.real.{module}"), attribute)
    return found


def devices() -> list[FoundDevice]:
    """Return the real devices of this machine, and the reason for each kind without one.

    A search takes seconds: it opens each device for a moment and waits for one on the network.
    """
    found: list[FoundDevice] = []
    for name in DEVICES:
        if DEVICES[name].has_adapter and (find := getattr(adapter_class(name), "find", None)):
            found += find()
    return found
