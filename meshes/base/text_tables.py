"""Text from files: TOML and JSON that are not nested too deeply, numbers, and text for display."""

import codecs
import json
import math
import re
import tomllib
import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError
from meshes.base.hints import nearest

__all__ = [
    "DEEPEST",
    "natural_order",
    "number_in",
    "number_or_nan",
    "read_json",
    "read_text",
    "read_toml",
    "require_distinct_columns",
    "require_shallow",
    "shown",
    "unknown_name",
    "visible",
    "whole_number_in",
]

LONGEST_NUMBER = 308
"""Most digits of a whole number; a longer one fits no float."""
DEEPEST = 50
"""Largest number of tables and lists within each other; scenes have at most 5."""


def read_text(path: Path) -> str:
    """Return the text of a file in UTF-8, or in UTF-16 with a byte order mark.

    Windows PowerShell 5.1 writes UTF-16 where output is redirected into a file.

    Raises
    ------
    UnicodeDecodeError
        If the file is in another encoding.
    """
    content = path.read_bytes()
    is_utf16 = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    return content.decode("utf-16" if is_utf16 else "utf-8-sig").replace("\r\n", "\n")


def read_toml(text: str) -> dict[str, Any]:
    """Read a table in TOML.

    Raises
    ------
    tomllib.TOMLDecodeError
        If it is not valid, nested too deeply, or holds a number of thousands of digits.
    """
    try:
        table = tomllib.loads(text)
        require_shallow(table)
    except tomllib.TOMLDecodeError:
        raise
    except RecursionError:
        raise tomllib.TOMLDecodeError(
            f"tables and lists within each other more than {DEEPEST} times"
        ) from None
    except ValueError as error:
        # A number of too many digits: after the colon, Python's message advises a call in Python.
        raise tomllib.TOMLDecodeError(str(error).split(":")[0]) from None
    return table


def read_json(text: str | bytes) -> Any:
    """Read a value in JSON.

    Raises
    ------
    json.JSONDecodeError
        If it is not valid or nested too deeply.
    """
    try:
        value = json.loads(text, parse_int=_whole_number)
        require_shallow(value)
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise
    except RecursionError:
        raise json.JSONDecodeError(
            f"tables and lists within each other more than {DEEPEST} times", "", 0
        ) from None
    except ValueError as error:
        # as in `read_toml`
        raise json.JSONDecodeError(str(error).split(":")[0], "", 0) from None
    return value


def _whole_number(text: str) -> int | float:
    """Return a whole number, and infinity for one that fits no float, as JSON's 1e400 gives."""
    if len(text) > LONGEST_NUMBER:
        return -math.inf if text.startswith("-") else math.inf
    return int(text)


def require_shallow(value: object) -> None:
    """Check that tables and lists are not nested more than `DEEPEST` times.

    Raises
    ------
    RecursionError
        If they are nested more deeply.
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
    """Return a key that sorts names by the numbers in them: ``run2`` before ``run10``."""
    # Texts get -1, numbers their value.
    return [
        (int(part), "") if part.isascii() and part.isdigit() else (-1, part)
        for part in re.split(r"(\d+)", name)
    ]


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


def number_or_nan(text: str | None) -> float:
    """Return the number that a text holds, NaN for any other text; see `number_in`."""
    try:
        return number_in(text or "")
    except ValueError:
        return float("nan")


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
        key, f"be one of {', '.join(known)}", f"{word}{nearest(word, known)}", "choose one of these"
    )


def shown(value: object) -> str:
    """Return a value as a user would write it."""
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
