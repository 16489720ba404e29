"""Error for an invalid input, checks that raise this error, and dataclasses with ranges.

NumPy is only imported when a vector is checked. The command line imports this module first, and the
command line should start fast.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from meshes.base.arrays import Array

_LONGEST_PATH = 500
"""Longest path in an error message [characters]. The middle of a longer path is omitted."""


class _Present:
    """Type of the constant `PRESENT`."""

    def __reduce__(self) -> str:
        """Pickle only the name, so that another process restores the constant `PRESENT` itself."""
        return "PRESENT"


PRESENT = _Present()
"""Value of an `InputError` for an argument that must not be given.

The error message does not contain this value.
"""


class InputError(ValueError):
    """Error for an invalid input.

    The message is formatted from the attributes when it is printed, so a caller can replace the
    name of the argument (`names_of_caller`). Line breaks, for example in a file name, are printed
    as in a string literal.

    Parameters
    ----------
    argument
        Name of the argument. If `requirement` is empty, this text is the whole message.
    requirement
        Requirement on the argument. In the message, the requirement follows the word "must".
    value
        Value that was given.
    remedy
        Instruction for the user.
    unit
        Unit of the value, if neither the name nor the value contains the unit.
    """

    def __init__(
        self,
        argument: object,
        requirement: str = "",
        value: object = "",
        remedy: str = "",
        unit: str = "",
    ) -> None:
        super().__init__(argument, requirement, value, remedy, unit)
        self.argument = str(argument)
        self.requirement = requirement
        self.value = value
        self.remedy = remedy
        self.unit = unit

    def __str__(self) -> str:
        message = self.argument
        if self.requirement:
            message = f"{message} must {self.requirement}{self._received()}. "
            message += _sentence(self.remedy)
        return message.replace("\n", "\\n")

    def _received(self) -> str:
        """Return the part of the message with the value, or "" if the requirement implies it."""
        if self.value is PRESENT or self.requirement.startswith("be left out"):
            return ""
        if self.requirement.startswith("be given") and self.value in ("none", "nothing", None):
            return ""
        value = self.value if str(self.value) else "an empty value"
        return f", got {value} {self.unit}" if self.unit else f", got {value}"


def _sentence(remedy: str) -> str:
    """Capitalise the first letter of a remedy, unless the remedy begins with a name from code."""
    first = remedy.split(" ", 1)[0]
    return remedy if not first.isalpha() else remedy[:1].upper() + remedy[1:]


class DamagedFileError(Exception):
    """Error whose message describes the damage of a file in terms of the file's format.

    The function that reads the file inserts the description into its own error message.
    """


def counted(count: int, noun: str) -> str:
    """Return a number and its noun. The noun is in the plural unless the number is one."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def by(numbers: Iterable[float], form: str = "g") -> str:
    """Format the sizes of several axes as text, for example "3 x 4 x 5"."""
    return " x ".join(format(number, form) for number in numbers)


def enumerated(names: Iterable[object], word: str = "and") -> str:
    """Join names as text, for example "a, b and c"."""
    *first, last = [str(name) for name in names] or [""]
    return f"{', '.join(first)} {word} {last}" if first else last


def in_brackets(numbers: Iterable[float], form: str = "g") -> str:
    """Format coordinates, for example "(1, 2, 3)"."""
    return f"({', '.join(format(number, form) for number in numbers)})"


def require_positive(name: str, value: float, remedy: str) -> float:
    """Return `value` as a float if it is positive and finite.

    Parameters
    ----------
    name
        Name of the caller's argument. The name includes the unit.
    value
        Number to check, in the unit that `name` contains.
    remedy
        Instruction for the user.

    Raises
    ------
    InputError
        If the value is not a number, not finite or not above zero.
    """
    number = _as_number(name, value, remedy)
    if not (math.isfinite(number) and number > 0.0):
        raise InputError(name, "be positive and finite", value, remedy)
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
        raise InputError(name, f"be in [{lowest:g}, {highest:g}]", value, remedy)
    return number


def require_length(
    name: str, value_m: float, lowest_m: float, highest_m: float, advised_m: float
) -> float:
    """Return `value_m` as a float if it lies in the closed interval [lowest_m, highest_m].

    The error message states lengths in millimetres, because some callers have arguments in
    millimetres.

    Parameters
    ----------
    name
        Name of the caller's argument.
    value_m
        Length to check [m].
    lowest_m, highest_m
        Smallest and largest valid length [m]. The values 0 and infinity mean that there is no
        bound.
    advised_m
        Length that the error message recommends [m].

    Raises
    ------
    InputError
        If the value is not a number, not positive, not finite or outside the interval.
    """
    remedy = f"use about {1e3 * advised_m:.3g} mm"
    length = _as_number(name, value_m, remedy)
    if math.isfinite(length) and length > 0.0 and lowest_m <= length <= highest_m:
        return length
    required = "be positive and finite"
    if math.isfinite(highest_m):
        required = f"be from {1e3 * lowest_m:.4g} mm to {1e3 * highest_m:.4g} mm"
        if lowest_m == 0.0:
            required = f"be positive and at most {1e3 * highest_m:.4g} mm"
    raise InputError(name, required, f"{1e3 * length:.4g}", remedy, "mm")


def require_ranges(*rows: tuple[str, float, float, float, str]) -> list[float]:
    """Check that each value lies in its closed interval, and return the values.

    Each tuple contains the arguments of one call of `require_range`.
    """
    return [require_range(*row) for row in rows]


def as_vector(value: object) -> "Array | None":
    """Return `value` as an array if it consists of three finite numbers, else None."""
    import numpy as np

    try:
        vector = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return vector if vector.shape == (3,) and np.isfinite(vector).all() else None


def require_vector(name: str, value: object) -> "Array":
    """Return `value` as three floats.

    Raises
    ------
    InputError
        If the value is not three finite numbers.
    """
    vector = as_vector(value)
    if vector is None:
        raise InputError(name, "be three finite numbers", value, "use for example (0, 0, 1)")
    return vector


def require_direction(
    name: str,
    value: object,
    remedy: str = "use for example (0, 0, 1)",
) -> "Array":
    """Return the unit vector along `value`, shape (3,).

    Raises
    ------
    InputError
        If the value is not three finite numbers, or if all three are zero.
    """
    import numpy as np

    vector = require_vector(name, value)
    length = float(np.linalg.norm(vector))
    if length == 0.0:
        raise InputError(name, "not be zero", "(0, 0, 0)", remedy)
    return vector / length


def _short(file: Path) -> str:
    """Shorten a path for use in an error message."""
    text = str(file)
    return (
        text
        if len(text) <= _LONGEST_PATH
        else f"{text[: _LONGEST_PATH // 2]}...{text[-_LONGEST_PATH // 2 :]}"
    )


def is_file(file: Path) -> bool:
    """Return whether a file exists; False if the operating system does not accept the file name."""
    try:
        return file.is_file()
    except OSError:
        return False


def is_folder(path: Path) -> bool:
    """Return whether a folder exists; False if the operating system does not accept the name."""
    try:
        return path.is_dir()
    except OSError:
        return False


def require_file(file: Path, content: str) -> None:
    """Raise an error if a file is missing or empty.

    `content` is the expected content, such as "a surface".

    Raises
    ------
    InputError
        If the file is missing or empty.
    """
    if not is_file(file):
        raise InputError(
            "file",
            "exist",
            _short(file),
            "check the path; it is relative to the working directory",
        )
    if file.stat().st_size == 0:
        raise InputError(
            "file", f"contain {content}", f"the empty file {file.name}", "export it again"
        )


def _as_number(name: str, value: object, remedy: str) -> float:
    """Convert to float; raise an error for values that are not numbers, such as booleans."""
    if isinstance(value, bool):
        # Python would count True as 1.
        raise InputError(name, "be a number", f"{value!r}", remedy)
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError) as problem:
        raise InputError(name, "be a number", f"{value!r}", remedy) from problem
    except OverflowError as problem:
        raise InputError(
            # The integer has 309 digits or more.
            name,
            "be a number below 1e308",
            f"{str(value)[:12]}...",
            remedy,
        ) from problem


@contextmanager
def names_of_caller(names: Mapping[str, str]) -> Iterator[None]:
    """Replace argument names in an `InputError` by the caller's names, such as scene keys.

    `names` maps the name in the called function to the caller's name.

    If the argument is an element such as ``tau_s[0]``, only the name ``tau_s`` is replaced.
    """
    try:
        yield
    except InputError as error:
        whole, bracket, element = error.argument.partition("[")
        if error.argument in names:
            error.argument = names[error.argument]
        elif whole in names:
            error.argument = f"{names[whole]}{bracket}{element}"
        raise


def ranged(default: float, lowest: float, highest: float, remedy: str = "") -> Any:
    """Declare a numeric field, with a default and limits, in a `Ranged` dataclass."""
    return field(
        default=default,
        metadata={"range": (lowest, highest, remedy or f"use a value such as {default:g}")},
    )


@dataclass(frozen=True)
class Ranged:
    """Base class of dataclasses whose numeric fields are declared by `ranged`.

    Raises
    ------
    InputError
        If a field's value is not finite or out of the field's range.
    """

    def __post_init__(self) -> None:
        for each in fields(self):
            require_range(each.name, getattr(self, each.name), *each.metadata["range"])
