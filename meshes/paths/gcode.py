"""A small part of G-code (RS-274): straight moves of a three-axis tool.

Read are G0 (rapid), G1 (at the feed F), G20 and G21 (inches, mm), G90 and G91 (absolute, relative), X, Y, Z, F [units a
minute], line numbers N, comments in brackets and after a semicolon, and lines of %. Everything else is refused, since
what is skipped would change the path.
"""

import re
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["read_gcode"]

_WORD = re.compile(r"([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_COMMENT = re.compile(r"\([^()]*\)|;.*")
_MODES = {0.0: "motion", 1.0: "motion", 20.0: "unit", 21.0: "unit", 90.0: "reach", 91.0: "reach"}
_INCH_MM = 25.4


def read_gcode(file: Path) -> tuple[Array, Array]:
    """Points [mm], shape (n, 3), in the frame of the file, and the feed to each [mm/s], shape (n,), NaN for G0.

    Raises
    ------
    InputError
        If a line holds anything else, a move comes before its mode, its feed or a whole first point, or there are fewer
        than two points.
    """
    try:
        lines = file.read_text("utf-8").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"path must be G-code as text, got other data in {file}: export it again") from None
    machine = _Machine(file)
    for number, line in enumerate(lines, start=1):
        machine.read(line, number)
    if len(machine.points) < 2:
        raise InputError(f"path must have at least two points, got {len(machine.points)} in {file}: add moves")
    return np.array(machine.points), np.array(machine.feeds)


class _Machine:
    """What a controller remembers between lines."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.points: list[list[float]] = []
        self.feeds: list[float] = []
        self._modes = {"motion": -1.0, "unit": 21.0, "reach": 90.0}
        self._place: list[float | None] = [None, None, None]
        self._feed_mm_s = 0.0

    def read(self, line: str, number: int) -> None:
        """Take one line."""
        text = _COMMENT.sub("", line).strip()
        if not text or text == "%":
            return
        rest = _WORD.sub("", text).strip()
        if rest:
            raise self._refused(f"words of a letter and a number, got {rest.split()[0]}", number)
        words = [(letter.upper(), float(value)) for letter, value in _WORD.findall(text)]
        target: dict[str, float] = {}
        feed: float | None = None
        for letter, value in words:
            if letter == "G" and value in _MODES:
                self._modes[_MODES[value]] = value
            elif letter in "XYZ":
                if letter in target:
                    raise self._refused(f"one {letter} a line, got two", number)
                target[letter] = value
            elif letter == "F":
                feed = value
            elif letter != "N":
                raise self._refused(f"only G0, G1, G20, G21, G90, G91, X, Y, Z and F, got {letter}{value:g}", number)
        unit = _INCH_MM if self._modes["unit"] == 20.0 else 1.0
        if feed is not None:
            if feed <= 0.0:
                raise self._refused(f"a positive F, got F{feed:g}", number)
            self._feed_mm_s = feed * unit / 60.0
        if target:
            self._move(target, unit, number)

    def _move(self, target: dict[str, float], unit: float, number: int) -> None:
        if self._modes["motion"] < 0.0:
            raise self._refused("G0 or G1 before the first move, got none", number)
        rapid = self._modes["motion"] == 0.0
        if not rapid and self._feed_mm_s == 0.0:
            raise self._refused("F before the first G1, got none", number)
        relative = self._modes["reach"] == 91.0
        for axis, letter in enumerate("XYZ"):
            if letter in target:
                before = self._place[axis] if relative else 0.0
                if before is None:
                    raise self._refused("a first point in G90 before G91, got none", number)
                self._place[axis] = before + unit * target[letter]
        missing = [letter for letter, value in zip("XYZ", self._place, strict=True) if value is None]
        if missing:
            raise self._refused(f"X, Y and Z in the first move, got none of {', '.join(missing)}", number)
        self.points.append([float(value) for value in self._place if value is not None])
        self.feeds.append(float("nan") if rapid else self._feed_mm_s)

    def _refused(self, wanted: str, line: int) -> InputError:
        return InputError(f"path must hold {wanted} in line {line} of {self._file}: mend that line")
