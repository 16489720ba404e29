"""What of a person's file of constants counts in a loop."""

from tissue.api.bone import Bone
from tissue.api.organ import Organ
from tissue.builders.own_constants import given_note
from tissue.materials.scene_constants import Materials
from tissue.scene.used_constants import used_of_device

__all__ = ["device_note"]


def device_note(given: Materials, tissue: Bone | Organ, *, limits: object, hand: str) -> dict[str, str]:
    """Note which constants of a device that is named and of the hand come from a file.

    Raises
    ------
    InputError
        If none of the file is one of these.
    """
    layers = tissue.layer_names if isinstance(tissue, Bone) else ()
    used = used_of_device(given, limits if isinstance(limits, str) else None, hand)
    found = given_note(given, used, layers=layers, by="loop")
    return {f"{name} of device and hand": note for name, note in found.items()}
