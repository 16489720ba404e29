"""Copies of the internal state of a model, for snapshots."""

from collections.abc import Iterable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from meshes.base.errors import InputError

__all__ = ["State", "copied", "put_back", "require_shapes"]

State = dict[str, Any]
"""State of an object by name: numbers, arrays and plain objects that can be pickled."""


def copied(owner: object, names: Iterable[str]) -> State:
    """Return copies of some attributes of an object.

    The attributes are copied together: attributes that share an object share its copy.
    """
    return deepcopy({name: getattr(owner, name) for name in names})


def put_back(owner: object, state: State) -> None:
    """Write copied attributes back to an object; the copied state is not changed.

    Arrays are written in place, because a device array or a view may share their memory.
    """
    for name, value in deepcopy(state).items():
        present = getattr(owner, name)
        if isinstance(present, np.ndarray) and present.shape == np.shape(value):
            present[...] = value
        else:
            setattr(owner, name, value)


def require_shapes(present: Mapping[str, Any], kept: Mapping[str, Any]) -> None:
    """Check that copied arrays have the shapes of the present arrays of a model.

    Raises
    ------
    InputError
        If a shape differs, because the copy belongs to a model with another mesh.
    """
    for name, array in present.items():
        if array.shape != kept[name].shape:
            raise InputError(
                "snapshot",
                f"be of the same mesh and tool ({len(array)} entries of {name})",
                f"another mesh or tool ({len(kept[name])} entries)",
                "make both loops from equal arguments",
            )
