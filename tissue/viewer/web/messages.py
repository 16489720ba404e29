"""What a page may ask for: one JSON object a message, with ``do`` and the entries that belong to it."""

import json
import math

__all__ = ["LARGEST", "MessageError", "Values", "parse"]

LARGEST = 1024
"""Longest message [byte]."""
Values = dict[str, float | bool | str]
Number = tuple[float, float]

NUMBERS: dict[str, dict[str, Number]] = {
    "size": {"wide": (64.0, 8192.0), "tall": (64.0, 8192.0)},
    "move": {"right": (-4.0, 4.0), "up": (-4.0, 4.0)},
    "turn": {"right": (-4.0, 4.0), "up": (-4.0, 4.0)},
    "zoom": {"by": (0.2, 5.0)},
    "depth": {"notches": (-20.0, 20.0)},
    "time": {"time_s": (-1e6, 1e6)},
}
"""Entries that are numbers, with their ranges."""
WORDS, SWITCHES = ("key", "field", "layer"), ("pause", "play")
"""Messages with one entry, ``name``, a word, or ``on``, true or false."""
ALONE = ("reset", "end", "seen")
"""Messages without any."""


class MessageError(ValueError):
    """A message that no page of ours sends."""


def parse(text: str) -> tuple[str, Values]:
    """What is asked for, and its entries.

    Raises
    ------
    MessageError
        If it is no such message.
    """
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        raise MessageError("a message must be JSON") from None
    do = found.pop("do", None) if isinstance(found, dict) else None
    if not isinstance(do, str):
        raise MessageError("a message must be an object with do")
    ranges = NUMBERS.get(do, {})
    kinds: dict[str, type] = dict.fromkeys(ranges, float)
    kinds |= {"name": str} if do in WORDS else {"on": bool} if do in SWITCHES else {}
    if (not kinds and do not in ALONE) or set(found) != set(kinds):
        raise MessageError(f"{do[:40]} must be a known message with its entries alone")
    for name, kind in kinds.items():
        value = found[name]
        if kind is float:
            low, high = ranges[name]
            fits = isinstance(value, (int, float)) and not isinstance(value, bool)
            fits = fits and math.isfinite(value) and low <= value <= high
        else:
            fits = isinstance(value, kind)
        if not fits:
            raise MessageError(f"{name} of {do} must be in its range")
    return do, found
