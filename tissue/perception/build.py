"""A perception by its name."""

import numpy as np

from meshes.errors import InputError
from tissue.perception.perception import Perception

__all__ = ["perception"]


def perception(choice: str, *, rng: np.random.Generator, force_limit_N: float, tick_s: float) -> Perception | None:
    """The person for whom a device's force is scaled; None for none.

    Raises
    ------
    InputError
        If there is no such person.
    """
    if choice == "none":
        return None
    raise InputError(f"perception must be none, got {choice}: leave it out")
