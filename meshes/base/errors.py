"""The error a person sees when an input cannot be used, and the checks that raise it."""

import math

__all__ = ["DamagedFileError", "InputError", "counted", "require_positive", "require_range"]


class InputError(ValueError):
    """An input that cannot be used: one sentence with argument, value, requirement and remedy."""


class DamagedFileError(Exception):
    """What is wrong inside a file, in words of its format; its reader makes it part of the sentence that refuses it."""


def counted(count: int, noun: str) -> str:
    """A number of things with their noun, in the plural where there are other than one."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def require_positive(name: str, value: float, remedy: str) -> float:
    """Return `value` as a float if it is positive and finite.

    Parameters
    ----------
    name
        Argument as the caller knows it, unit in the name.
    value
        The number to check, in that unit.
    remedy
        What to write instead.

    Raises
    ------
    InputError
        If the value is not a number, not finite or not above zero.
    """
    number = _as_number(name, value, remedy)
    if not (math.isfinite(number) and number > 0.0):
        raise InputError(f"{name} must be positive and finite, got {value}: {remedy}")
    return number


def require_range(name: str, value: float, lowest: float, highest: float, remedy: str) -> float:
    """Return `value` as a float if it lies in the closed interval [lowest, highest].

    Raises
    ------
    InputError
        If the value is not a number, not finite or outside the interval.
    """
    number = _as_number(name, value, remedy)
    if not lowest <= number <= highest:
        raise InputError(f"{name} must be in [{lowest:g}, {highest:g}], got {value}: {remedy}")
    return number


def _as_number(name: str, value: object, remedy: str) -> float:
    """Convert to float, refusing what is not a number (booleans among them)."""
    if isinstance(value, bool):
        raise InputError(f"{name} must be a number, got {value!r}: {remedy}")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as problem:
        raise InputError(f"{name} must be a number, got {value!r}: {remedy}") from problem
