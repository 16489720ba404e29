"""Progress reports of long computations."""

from collections.abc import Callable

Progress = Callable[[str, float], None]
"""Function that is called with the name of the current task and its finished fraction, 0 to 1."""


def silent(doing: str, share: float) -> None:
    """Ignore a progress report."""
