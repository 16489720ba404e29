"""Requests of a page: one JSON object per message, with ``do`` and its entries."""

import json

__all__ = ["LARGEST", "MessageError", "Pace", "Values", "close_reason", "parse"]

LARGEST = 1024
"""Longest message [byte]."""
MOST_PER_S, AT_ONCE = 400.0, 200.0
"""Messages that are read in a second, and at once after a pause: a page sends one for each move of
the mouse and each picture, some 150 a second."""
LONGEST_REASON = 123
"""Longest reason of a closed WebSocket, by RFC 6455 [byte]."""
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
    """Read a message: its command and the entries.

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
    if do in WORDS:
        kinds["name"] = str
    elif do in SWITCHES:
        kinds["on"] = bool
    if (not kinds and do not in ALONE) or set(found) != set(kinds):
        raise MessageError(f"{do[:40]!a} must be a known message with its entries alone")
    for name, kind in kinds.items():
        value = found[name]
        if kind is float:
            low, high = ranges[name]
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            # an integer may be too large for a float; NaN is in no range
            fits = is_number and low <= value <= high
        else:
            fits = isinstance(value, kind)
        if not fits:
            raise MessageError(f"{name} of {do} must be in its range")
    return do, found


def close_reason(text: str) -> bytes:
    """Return a text as the reason of a closed WebSocket: ASCII, and no longer than it may be."""
    return text.encode("ascii", "backslashreplace")[:LONGEST_REASON]


class Pace:
    """Limit of the messages that are read: `MOST_PER_S` a second, and `AT_ONCE` after a pause.

    Further messages of a page wait in the buffers of the browser.
    """

    def __init__(self) -> None:
        self._left = AT_ONCE
        self._time_s = 0.0

    def wait_s(self, time_s: float) -> float:
        """Count a message that came at a time [s]; return the wait before the next one [s]."""
        self._left = min(self._left + MOST_PER_S * (time_s - self._time_s), AT_ONCE) - 1.0
        self._time_s = time_s
        return max(-self._left, 0.0) / MOST_PER_S
