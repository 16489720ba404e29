"""How long work reports what it does."""

from collections.abc import Callable

__all__ = ["Progress", "silent"]

Progress = Callable[[str, float], None]
"""Called with what is being done and the share of it that is done, 0 to 1."""


def silent(doing: str, share: float) -> None:
    """Report to nobody."""
