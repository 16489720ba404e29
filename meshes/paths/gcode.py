"""Conversion of G-code (RS-274) for three-axis mills to points and feeds.

Straight moves (G0, G1) and arcs (G2, G3) are read in all planes, units and distance modes. Commands
(words) that do not move the tool, such as spindle speed, coolant and tool number, are ignored and
listed in a note. Moves to machine positions, such as G28, are also left out and listed. Other words
that would change the motion, such as drilling cycles and cutter compensation, raise an error that
names the word.
"""

import re
from cmath import phase, rect
from math import acos, ceil, nan, pi, sqrt
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from meshes.base.tables import decoded_text

ARC_ERROR_MM = 0.01
"""Largest distance between an arc and the lines that replace the arc [mm].

The value is a tenth of the finest voxels in use, 0.1 mm.
"""
_RADIUS_MM = 0.1
"""Largest difference between an arc's radius at its start and at its end [mm].

The controller TwinCAT 3 NC I also corrects differences of up to 0.1 mm by default
(centerpointCorrectionLimitSet).
"""
_WIDEST_RAD = 0.25 * pi
"""Largest angle of an arc segment [rad]. Each segment is replaced by a line.

This limit only matters for arcs with a radius of less than 0.13 mm.
"""
_INCH_MM = 25.4
_WORD = re.compile(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))")
_COMMENT = re.compile(r"\([^()]*(?:\)|$)|;.*")
_MODES = {
    **dict.fromkeys(("G0", "G1", "G2", "G3"), "motion"),
    **dict.fromkeys(("G17", "G18", "G19"), "plane"),
    **dict.fromkeys(("G20", "G21"), "unit"),
    **dict.fromkeys(("G90", "G91"), "distance"),
    **dict.fromkeys(("G90.1", "G91.1"), "centre"),
}
"""Modal group of each supported G word."""
_WORK_OFFSETS = ("G54", "G55", "G56", "G57", "G58", "G59", "G59.1", "G59.2", "G59.3")
_STILL = (
    *_WORK_OFFSETS,
    *(f"G{n}" for n in ("4", "40", "43", "49", "61", "61.1", "64", "80", "92.1", "92.2")),
    *("G94", "G98", "G99"),
)
"""G words that do not move the tool and are ignored.

With G43, positions refer to the tip of the tool, as in all paths of this package. G80, which ends a
drilling cycle, is ignored, because the word that starts a cycle raises an error.
"""
_SUBPROGRAMS = ("M97", "M98", "M99")
"""M words of subprograms, which may move the tool. All other M words are ignored."""
_STILL_LETTERS = "STHDON"
_HOME = ("G28", "G30", "G53")
"""G words for moves to machine positions. In the program's frame, these positions are unknown."""
_END = ("M2", "M30")
_PARAMETERS = {"G4": "PXU", "G64": "PQ"}
"""Letters of the parameters of each G word that has parameters but does not move the tool."""
_PLANES = {"G17": ("X", "Y", "Z"), "G18": ("Z", "X", "Y"), "G19": ("Y", "Z", "X")}
"""Axes by the G word that selects an arc's plane: two axes in the plane, and the plane's normal."""
_OFFSETS = {"X": "I", "Y": "J", "Z": "K"}


class Program:
    """Interpreter of a G-code program that stores the points and the state of the controller.

    Parameters
    ----------
    file
        File name for messages.

    Attributes
    ----------
    points_mm
        Points [mm] in the order of the program, in the frame of the program.
    feeds_mm_s
        Speed [mm/s] of the move to each point, or NaN for a rapid move.
    """

    def __init__(self, file: Path) -> None:
        self.points_mm: list[list[float]] = []
        self.feeds_mm_s: list[float] = []
        self._file = file
        # There is no motion mode before the first motion word, because the defaults of controllers
        # differ.
        self._modes = {
            "motion": "",
            "plane": "G17",
            "unit": "",
            "distance": "G90",
            "centre": "G91.1",
        }
        self._place: dict[str, float] = {}
        self._feed_mm_s = 0.0
        self._left_out: set[str] = set()
        self._homes: set[str] = set()
        self._offset = ""
        self._arcs = 0
        self._line = 0

    def notes(self) -> tuple[str, ...]:
        """Return notes on the unit, on ignored words and on replaced arcs, one sentence each."""
        found = []
        if not self._modes["unit"]:
            found.append("the program has neither G20 nor G21, so lengths are read in mm")
        if self._left_out:
            words = sorted(self._left_out, key=lambda word: (word[0], float(word[1:] or 0)))
            found.append(f"left out, since they do not move the tool: {', '.join(words)}")
        if self._homes:
            homes = ", ".join(sorted(self._homes))
            found.append(f"left out, since they move to a place of the machine: {homes}")
        if self._arcs:
            found.append(f"{counted(self._arcs, 'arc')} as lines within {ARC_ERROR_MM:g} mm")
        return tuple(found)

    def read(self, line: str, number: int) -> bool:
        """Execute one line, and return False at the end of the program."""
        self._line = number
        text, count = _COMMENT.subn("", line.upper())
        # nested brackets
        while count:
            text, count = _COMMENT.subn("", text)
        text = text.strip().removeprefix("/")
        if not text or text.startswith("%"):
            return True
        if rest := _WORD.sub("", text).split():
            raise self._refused(
                f"has {rest[0][:20]}, which is not a letter with a number",
                "Export the program without parameters, expressions and macros",
            )
        words = [(letter, float(digits)) for letter, digits in _WORD.findall(text)]
        codes = [f"{letter}{value:g}" for letter, value in words if letter in "GM"]
        self._take(codes)
        numbers = self._numbers(words)
        for code in codes:
            for letter in _PARAMETERS.get(code, ""):
                numbers.pop(letter, None)
        if "F" in numbers:
            self._feed_mm_s = self._mm(numbers.pop("F")) / 60.0
            if self._feed_mm_s <= 0.0:
                raise self._refused("has a feed F that is not positive", "Correct the feed")
        if homes := set(codes) & set(_HOME):
            self._homes |= homes
            # the position of these axes after such a move is unknown
            for letter in [each for each in "XYZ" if each in numbers] or "XYZ":
                self._place.pop(letter, None)
        elif numbers:
            self._move(numbers)
        return not set(codes) & set(_END)

    def _numbers(self, words: list[tuple[str, float]]) -> dict[str, float]:
        """Return the numbers of a line by letter.

        Numbers that are parameters of words without motion are omitted.
        """
        numbers: dict[str, float] = {}
        for letter, value in words:
            if letter in "GM":
                continue
            if letter in _STILL_LETTERS:
                self._left_out.add(letter)
                continue
            if letter in numbers:
                raise self._refused(f"has two words {letter}", "Remove one of them")
            if letter not in "XYZIJKRFPQU":
                raise self._refused(
                    f"has {letter}{value:g}, but only the axes X, Y and Z are read",
                    "Export a program for three axes",
                )
            numbers[letter] = value
        return numbers

    def _take(self, codes: list[str]) -> None:
        """Update the state of the controller by the G and M words of a line."""
        groups = [_MODES[code] for code in codes if code in _MODES]
        if len(set(groups)) < len(groups):
            raise self._refused(
                f"has two words of one group in {' '.join(codes)}", "Remove one of them"
            )
        for code in codes:
            if code in _MODES:
                self._modes[_MODES[code]] = code
            elif code in _STILL or (code[0] == "M" and code not in _SUBPROGRAMS):
                self._left_out.add(code)
            elif code not in _HOME:
                raise self._refused(
                    f"has {code}, which is not supported",
                    "Export the program with plain moves G0, G1, G2 and G3, without canned cycles, "
                    "cutter compensation and subprograms",
                )
            if code in _WORK_OFFSETS:
                if self._offset not in ("", code):
                    raise self._refused(
                        f"uses the work offset {code} after {self._offset}",
                        "Export the operations of each offset as a program of its own",
                    )
                self._offset = code

    def _mm(self, value: float) -> float:
        return value * (_INCH_MM if self._modes["unit"] == "G20" else 1.0)

    def _move(self, numbers: dict[str, float]) -> None:
        """Move to the position that a line states."""
        motion = self._modes["motion"]
        named = {letter: self._mm(numbers[letter]) for letter in "XYZ" if letter in numbers}
        is_arc = motion in ("G2", "G3")
        if extra := set(numbers) - set("XYZIJKRP" if is_arc else "XYZ"):
            raise self._refused(
                f"has {', '.join(sorted(extra))}, which has no meaning there", "Correct the line"
            )
        if not motion:
            raise self._refused("moves without G0, G1, G2 or G3", "Add one of them")
        if motion != "G0" and self._feed_mm_s == 0.0:
            raise self._refused("cuts before any feed F", "Add for example F120, in mm/min")
        if self._modes["distance"] == "G91":
            if missing := [letter for letter in named if letter not in self._place]:
                raise self._refused(
                    f"moves {missing[0]} by a distance from an unknown place",
                    "State the first point in absolute numbers, G90",
                )
            named = {letter: self._place[letter] + step for letter, step in named.items()}
        start = dict(self._place)
        self._place |= named
        unknown = [letter for letter in "XYZ" if letter not in self._place]
        if unknown and motion != "G0":
            raise self._refused(
                f"cuts before {', '.join(unknown)} is known",
                "State X, Y and Z before the first cut",
            )
        if unknown:
            return
        if is_arc:
            self._arc(start, numbers)
        else:
            self._add(self._place)

    def _add(self, place: dict[str, float]) -> None:
        self.points_mm.append([place[letter] for letter in "XYZ"])
        self.feeds_mm_s.append(nan if self._modes["motion"] == "G0" else self._feed_mm_s)

    def _arc(self, start: dict[str, float], numbers: dict[str, float]) -> None:
        """Add the points of an arc or a helix.

        In the plane of the arc, a position is a complex number: the first coordinate plus the
        second coordinate times the imaginary unit.
        """
        if set(start) != set("XYZ"):
            raise self._refused("has an arc from an unknown place", "Start it at a known point")
        if numbers.get("P", 1.0) != 1.0:
            raise self._refused("has an arc of several turns (P)", "Write one line per turn")
        first, second, along = _PLANES[self._modes["plane"]]
        begin = complex(start[first], start[second])
        end = complex(self._place[first], self._place[second])
        sense = 1.0 if self._modes["motion"] == "G3" else -1.0
        centre = self._centre(begin, end, sense, numbers)
        from_r = abs(begin - centre)
        to_r = abs(end - centre)
        if min(from_r, to_r) <= 0.0 or abs(from_r - to_r) > _RADIUS_MM:
            raise self._refused(
                f"has an arc with radii of {from_r:.4g} mm at its start and {to_r:.4g} mm at its "
                "end",
                "Check I, J and K, and whether they are absolute (G90.1)",
            )
        angle = phase(begin - centre)
        turn = sense * (phase(end - centre) - angle) % (2.0 * pi)
        # if start and end are equal, the arc is a full circle
        if abs(end - begin) <= 1e-9 * max(abs(begin), 1.0) or turn == 0.0:
            turn = 2.0 * pi
        widest = 2.0 * acos(max(1.0 - ARC_ERROR_MM / max(from_r, to_r), 0.0))
        count = ceil(turn / min(widest, _WIDEST_RAD))
        for part in (np.arange(1, count) / count).tolist():
            at = centre + rect(from_r + part * (to_r - from_r), angle + sense * part * turn)
            height = start[along] + part * (self._place[along] - start[along])
            self._add({first: at.real, second: at.imag, along: height})
        self._add(self._place)
        self._arcs += 1

    def _centre(
        self, begin: complex, end: complex, sense: float, numbers: dict[str, float]
    ) -> complex:
        """Return the centre of an arc in its plane [mm]."""
        first, second, _ = _PLANES[self._modes["plane"]]
        letters = _OFFSETS[first], _OFFSETS[second]
        if "R" not in numbers:
            given = [letter in numbers for letter in letters]
            is_absolute = self._modes["centre"] == "G90.1"
            if not any(given) or (is_absolute and not all(given)):
                raise self._refused(
                    "has an arc without its centre",
                    f"Give {' and '.join(letters)}, or the radius R",
                )
            offset = complex(*(self._mm(numbers.get(letter, 0.0)) for letter in letters))
            return offset if is_absolute else begin + offset
        radius = self._mm(numbers["R"])
        chord = abs(end - begin)
        if chord == 0.0 or chord > 2.0 * (abs(radius) + _RADIUS_MM):
            raise self._refused(
                f"has an arc of radius {abs(radius):.4g} mm between points {chord:.4g} mm apart",
                f"Give its centre by {' and '.join(letters)}",
            )
        # for a short arc with G3, the centre lies on the left of the chord; R < 0 means the long
        # arc
        away = sqrt(max(radius**2 - 0.25 * chord**2, 0.0)) * sense * (1.0 if radius > 0.0 else -1.0)
        return 0.5 * (begin + end) + 1j * away * (end - begin) / chord

    def _refused(self, problem: str, remedy: str) -> InputError:
        return InputError(f"path: line {self._line} of {self._file} {problem}. {remedy}.")


def read_gcode(file: Path) -> tuple[Array, Array, tuple[str, ...]]:
    """Read the points of a G-code file in the frame of the file.

    Returns
    -------
    Points [mm], shape (n, 3); speed of the move to each point [mm/s], shape (n,), NaN for rapid
    moves; notes.

    Raises
    ------
    InputError
        If a word is not supported, or a line is incomplete.
    """
    program = Program(file)
    text = decoded_text(file, "path", remedy="export it again")
    for number, line in enumerate(text.splitlines(), start=1):
        if not program.read(line, number):
            break
    if not program.points_mm:
        raise InputError(f"path: {file} never states X, Y and Z. Add a first move with all three.")
    points = np.array(program.points_mm, dtype=np.float64).reshape(-1, 3)
    return points, np.array(program.feeds_mm_s), program.notes()
