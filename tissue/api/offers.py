"""What entry points of installed packages name, registered."""

from collections.abc import Callable
from typing import Any

from meshes.base.errors import InputError
from tissue.api.register import register
from tissue.scene.registry import TABLES

__all__ = ["take"]


def take(kind: str, name: str, load: Callable[[], Any]) -> None:
    """Register what an entry point of an installed package names, unless importing it does, as a decorator would.

    A name that a call has registered stays with that.

    Raises
    ------
    InputError
        If the name is built in, or it cannot be registered.
    """
    tables = TABLES[kind]
    if any(name in table.built_in for table in tables):
        raise InputError(f"{name} is the name of a built-in {kind}")
    part = load()
    if kind in ("material", "scene"):
        getattr(register, kind)(part)
        return
    if not any(name in table.known for table in tables):
        getattr(register, kind)(name, part)
    if not any(name in table.known for table in tables):
        raise InputError(f"it registers nothing by that name: decorate it by @tissue.register.{kind}")
