"""Gymnasium environments in which contact force matters: milling a pocket, drilling a tooth, palpating for a nodule.

Once this module is imported, `gymnasium.make` knows ``tissue/Milling-v0``, ``tissue/Drilling-v0`` and
``tissue/Palpation-v0``; ``gymnasium.make("tissue.environments:tissue/Milling-v0")`` imports it, too. Gymnasium reads no
entry points since version 1.0.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from tissue.environments.registration import register_environments

if TYPE_CHECKING:
    from tissue.environments.drilling import Drilling
    from tissue.environments.milling import Milling
    from tissue.environments.palpation import Palpation

__all__ = ["Drilling", "Milling", "Palpation", "register_environments"]

_HOMES = {name: f"tissue.environments.{name.lower()}" for name in ("Drilling", "Milling", "Palpation")}


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'tissue.environments' has no attribute {name!r}")


register_environments()
