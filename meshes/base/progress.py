"""Progress reports of long computations."""

from collections.abc import Callable

__all__ = ["Progress", "silent"]

Progress = Callable[[str, float], None]
"""Called with the name of the current task and the finished fraction of it, 0 to 1."""


def silent(doing: str, share: float) -> None:
    """Ignore the progress."""
