"""The names by which `gymnasium.make` knows the environments."""

from meshes.base.errors import InputError

__all__ = ["IDS", "register_environments"]

IDS = {
    f"tissue/{name}-v0": f"tissue.environments.{name.lower()}:{name}" for name in ("Milling", "Drilling", "Palpation")
}
"""Class of each environment by its name; imported when the first is made."""


def register_environments() -> None:
    """Register the environments, once.

    Raises
    ------
    InputError
        If gymnasium is not installed.
    """
    try:
        from gymnasium.envs.registration import register, registry
    except ImportError:
        raise InputError(
            "gymnasium must be installed for environments, got none: pip install 'tissue-sim[rl]'"
        ) from None
    for name, place in IDS.items():
        if name not in registry:
            register(name, entry_point=place)
