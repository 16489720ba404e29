"""How long work tells what it does."""

from collections.abc import Callable

__all__ = ["Progress", "silent"]

Progress = Callable[[str, float], None]
"""Told what is being done and how much of it is done, 0 to 1."""


def silent(doing: str, share: float) -> None:
    """Tell nobody."""
