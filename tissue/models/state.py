"""Copies of the internal state of a model, for snapshots."""

from collections.abc import Iterable
from copy import deepcopy
from typing import Any

import numpy as np

__all__ = ["State", "copied", "put_back"]

State = dict[str, Any]
"""State of an object by name: numbers, arrays and plain objects that can be pickled."""


def copied(owner: object, names: Iterable[str]) -> State:
    """Return copies of some attributes of an object.

    They are copied together: attributes that share an object share its copy.
    """
    found: State = deepcopy({name: getattr(owner, name) for name in names})
    return found


def put_back(owner: object, state: State) -> None:
    """Write copied attributes back to an object; the state stays unchanged.

    Arrays are written in place, because a device array or a view may share their memory.
    """
    for name, value in deepcopy(state).items():
        present = getattr(owner, name)
        if isinstance(present, np.ndarray) and present.shape == np.shape(value):
            present[...] = value
        else:
            setattr(owner, name, value)
