"""Which real devices this machine has, as their adapters find them."""

from tissue.hardware.adapter import FoundDevice
from tissue.scene.named_parts import loaded
from tissue.scene.registry import DEVICES

__all__ = ["devices"]


def devices() -> list[FoundDevice]:
    """The real devices that this machine has; for each kind that is not found, one sentence of what is missing.

    A search takes seconds: it opens each device for a moment and waits for one on the network.
    """
    found: list[FoundDevice] = []
    for name in DEVICES:
        if (adapter := DEVICES[name].adapter) is not None and (find := getattr(loaded(adapter), "find", None)):
            found += find()
    return found
