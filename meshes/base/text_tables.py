"""Conversion of text from files: TOML and JSON, numbers, and text for display."""

import codecs
import json
import math
import re
import tomllib
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError, enumerated
from meshes.base.hints import nearest

LONGEST_NUMBER = 308
"""Largest number of digits of an integer that fits in a float."""
DEEPEST = 50
"""Largest nesting depth of tables and lists. Scenes have a depth of at most 5."""


def read_text(path: Path) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with a byte order mark.

    Windows PowerShell 5.1 writes UTF-16 if output is redirected into a file.

    Raises
    ------
    UnicodeDecodeError
        If the file is in another encoding.
    """
    content = path.read_bytes()
    is_utf16 = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    return content.decode("utf-16" if is_utf16 else "utf-8-sig").replace("\r\n", "\n")


def read_toml(text: str) -> dict[str, Any]:
    """Convert TOML text to a table.

    Raises
    ------
    tomllib.TOMLDecodeError
        If the text is not valid TOML, is nested too deeply, or contains a number with thousands of
        digits.
    """
    with _limited(tomllib.TOMLDecodeError):
        table = tomllib.loads(text)
        require_shallow(table)
    return table


@contextmanager
def _limited(error: Callable[[str], Exception]) -> Iterator[None]:
    """Replace errors on deep nesting and long numbers by the error that `error` returns."""
    try:
        yield
    except (tomllib.TOMLDecodeError, json.JSONDecodeError, UnicodeDecodeError):
        raise
    except RecursionError:
        raise error(f"tables and lists within each other more than {DEEPEST} times") from None
    except ValueError as problem:
        # The number has too many digits. Only the part before the colon is used, because the rest
        # of Python's message recommends a Python call.
        raise error(str(problem).split(":")[0]) from None


def read_json(text: str | bytes) -> Any:
    """Convert JSON text to a value.

    Raises
    ------
    json.JSONDecodeError
        If the text is not valid JSON or is nested too deeply.
    """
    with _limited(lambda text: json.JSONDecodeError(text, "", 0)):
        value = json.loads(text, parse_int=_whole_number)
        require_shallow(value)
    return value


def _whole_number(text: str) -> int | float:
    """Convert text to an integer, or to infinity if the integer is too large for a float.

    The number 1e400 in JSON is also converted to infinity.
    """
    if len(text) > LONGEST_NUMBER:
        return -math.inf if text.startswith("-") else math.inf
    return int(text)


def require_shallow(value: object) -> None:
    """Check that tables and lists are not nested more than `DEEPEST` times.

    Raises
    ------
    RecursionError
        If tables and lists are nested more deeply.
    """
    level: list[object] = [value]
    for _ in range(DEEPEST):
        tables = [inner for each in level if isinstance(each, dict) for inner in each.values()]
        lists = [inner for each in level if isinstance(each, list) for inner in each]
        level = [inner for inner in (*tables, *lists) if isinstance(inner, dict | list)]
        if not level:
            return
    raise RecursionError


def natural_order(name: str) -> list[tuple[int, str]]:
    """Return a sort key that compares the numbers in names: ``run2`` comes before ``run10``."""
    # The key is -1 for text and the value for a number.
    return [
        (int(part), "") if part.isascii() and part.isdigit() else (-1, part)
        for part in re.split(r"(\d+)", name)
    ]


def number_in(text: str) -> float:
    """Convert text to a number.

    Python converts ``1_0`` to 10. In a file of measurements, ``1_0`` is a damaged number, so an
    error is raised.

    Raises
    ------
    ValueError
        If the text is not a number.
    """
    if "_" in text:
        raise ValueError(f"could not convert text to a number: {text!r}")
    return float(text)


def number_or_nan(text: str | None) -> float:
    """Convert text to a number as `number_in` does, or to NaN if the text is not a number."""
    try:
        return number_in(text or "")
    except ValueError:
        return float("nan")


def whole_number_in(text: str) -> int:
    """Convert text to an integer; see `number_in`.

    Raises
    ------
    ValueError
        If the text is not an integer.
    """
    if "_" in text:
        raise ValueError(f"could not convert text to a whole number: {text!r}")
    return int(text)


def require_distinct_columns(names: Iterable[str], what: str, path: Path) -> None:
    """Raise an error if two columns of a table have the same name.

    Raises
    ------
    InputError
        If a name occurs twice. The message contains the path and `what`. `what` is the user's
        argument or key for the file.
    """
    seen = set[str]()
    for name in names:
        if name in seen:
            raise InputError(
                f"{what} has two columns named {name} in {path}: rename or remove one of them"
            )
        seen.add(name)


def visible(text: str) -> str:
    """Replace control and formatting characters by escapes, such as ``\\x1b``.

    Line feeds are kept.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        each.encode("unicode_escape").decode()
        if unicodedata.category(each) in ("Cc", "Cf", "Cs")
        else each
        for each in text
    ).replace("\\n", "\n")


LONGEST_SHOWN = 120
"""Largest number of characters of a value in a message."""


def unknown_name(key: str, known: Iterable[str], got: object) -> InputError:
    """Return the error for an unknown name."""
    known = list(known)
    word = shown(got)
    return InputError(
        key,
        f"be one of {enumerated(known, 'or')}",
        f"{word}{nearest(word, known)}",
        "choose one of these",
    )


def shown(value: object) -> str:
    """Format a value for a message, in the notation of a scene file.

    For example, True is formatted as ``true``.
    """
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(shown(item) for item in value) + "]"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = "".join(each if each.isprintable() else repr(each)[1:-1] for each in str(value))
    return (
        text
        if len(text) <= LONGEST_SHOWN
        else f"{text[:LONGEST_SHOWN]}... ({len(text)} characters)"
    )
