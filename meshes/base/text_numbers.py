"""Numbers that are written as text, and the column names of a table."""

from collections.abc import Iterable
from pathlib import Path

from meshes.base.errors import InputError

__all__ = ["number_in", "require_distinct_columns", "whole_number_in"]


def number_in(text: str) -> float:
    """Return the number that a text holds.

    Python reads ``1_0`` as 10. In a file of measurements it is a damaged number, so it is refused.

    Raises
    ------
    ValueError
        If the text holds no number.
    """
    if "_" in text:
        raise ValueError(f"could not convert text to a number: {text!r}")
    return float(text)


def whole_number_in(text: str) -> int:
    """Return the whole number that a text holds; see `number_in`.

    Raises
    ------
    ValueError
        If the text holds no whole number.
    """
    if "_" in text:
        raise ValueError(f"could not convert text to a whole number: {text!r}")
    return int(text)


def require_distinct_columns(names: Iterable[str], what: str, path: Path) -> None:
    """Refuse a table in which two columns have one name.

    Raises
    ------
    InputError
        If a name occurs twice. `what` is the argument or key that names the file.
    """
    seen = set[str]()
    for name in names:
        if name in seen:
            raise InputError(
                f"{what} has two columns named {name} in {path}: rename or remove one of them"
            )
        seen.add(name)
