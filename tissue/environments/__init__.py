"""Gymnasium environments for tasks with contact force: milling, drilling and palpation.

The tasks are to mill a pocket, to drill a tooth, and to find a nodule by palpation.

After `import tissue.environments`, `gymnasium.make` accepts ``tissue/Milling-v0``,
``tissue/Drilling-v0`` and ``tissue/Palpation-v0``. Without this import, use
``gymnasium.make("tissue.environments:tissue/Milling-v0")``. Gymnasium has not read entry points
since version 1.0, so it cannot find the environments by itself.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from meshes.base.errors import InputError
from meshes.base.extras import install_command

if TYPE_CHECKING:
    from tissue.environments.drilling import Drilling
    from tissue.environments.milling import Milling
    from tissue.environments.palpation import Palpation

__all__ = ["IDS", "Drilling", "Milling", "Palpation", "register_environments"]

NAMES = ("Drilling", "Milling", "Palpation")
IDS = {f"tissue/{name}-v0": f"tissue.environments.{name.lower()}:{name}" for name in NAMES}
"""Class of each environment, keyed by the name of the environment in gymnasium.

A class is imported when it is first used.
"""


def register_environments() -> None:
    """Register the environments with gymnasium if they are not registered yet.

    Raises
    ------
    InputError
        If gymnasium is not installed.
    """
    try:
        from gymnasium.envs.registration import register, registry
    except ImportError:
        raise InputError(
            "gymnasium",
            "be installed for environments",
            "a Python environment without it",
            f"run {install_command('rl')}",
        ) from None
    for name, place in IDS.items():
        if name not in registry:
            register(name, entry_point=place)


def __getattr__(name: str) -> Any:
    if name in NAMES:
        return getattr(import_module(f"tissue.environments.{name.lower()}"), name)
    raise AttributeError(f"module 'tissue.environments' has no attribute {name!r}")


register_environments()
