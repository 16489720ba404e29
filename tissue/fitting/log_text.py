"""Reader of a measured log as text.

It detects delimiter, preamble, header line and units line. The cells stay text.
"""

import csv
import re
from collections import Counter
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from meshes.base.errors import InputError, counted
from meshes.base.text_tables import number_in

__all__ = ["TextTable", "read_text"]

_DELIMITERS = (",", ";", "\t", " ")
_LOOKED_AT = 50
"""Number of lines at the end of a file that determine the form of a data line."""
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
_AGAIN = "fix that line or export the log again"


@dataclass(frozen=True)
class TextTable:
    """Columns of a text file.

    Attributes
    ----------
    names
        Names in the header line, or numbers from 1 without a header line.
    rows
        Cells, one list per line.
    lines
        Line number of each row, from 1.
    notes
        Remarks on the text around the table.
    """

    names: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    notes: tuple[str, ...]

    def numbers(self, name: str) -> list[float]:
        """Return a column as numbers, NaN where a cell is empty.

        Raises
        ------
        InputError
            If a cell holds no number, or two columns have the same name. The message names the line
            of the cell.
        """
        if self.names.count(name) != 1:
            raise InputError(
                "column",
                "name one column of the log",
                f"{name}, which is there twice",
                "rename one",
            )
        place = self.names.index(name)
        numbers = []
        for line, row in zip(self.lines, self.rows, strict=True):
            cell = row[place].strip()
            try:
                numbers.append(number_in(cell.replace(",", ".")) if cell else float("nan"))
            except ValueError:
                raise InputError(
                    "log", "hold numbers", f"{cell[:40]!r} for {name} in line {line}", _AGAIN
                ) from None
        return numbers


def read_text(path: Path) -> TextTable:
    """Read a table of text and skip any text before it.

    Raises
    ------
    InputError
        If the file holds no table of numbers, or a line of the table has more or fewer cells than
        the others.
    """
    lines = _decoded(path).splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    delimiter, width = _form(lines[-_LOOKED_AT:], path)
    cells = [_cells(line, delimiter) for line in lines]
    start = next(i for i, row in enumerate(cells) if len(row) == width and _is_data(row))
    names, above, has_units = _header(cells[:start], width)
    notes = (
        [f"{counted(above, 'line')} before the header line {above + 1}"] if above and names else []
    )
    notes += [f"the units of line {start}"] if has_units else []
    places = [at for at in range(start, len(lines)) if lines[at].strip()]
    if blank := len(lines) - start - len(places):
        notes.append(f"{counted(blank, 'blank line')} between the rows")
    if len(cells[places[-1]]) < width:
        places.pop()
        notes.append("the last line, which is cut short, is left out")
    numbers = [at + 1 for at in places]
    rows = [cells[at] for at in places]
    for line, row in zip(numbers, rows, strict=True):
        if len(row) != width:
            raise InputError(
                "log",
                f"hold {width} values a line",
                f"{len(row)} in line {line} of {path.name}",
                _AGAIN,
            )
    return TextTable(names or tuple(map(str, range(1, width + 1))), rows, numbers, tuple(notes))


def _decoded(path: Path) -> str:
    """Return the text of a file, decoded as UTF-8, UTF-16 or Windows-1252.

    A file that is not UTF-8 is read as UTF-16 if it begins like UTF-16, otherwise as Windows-1252.
    """
    content = path.read_bytes()
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", "replace")
    if b"\0" in content[:4096]:
        raise InputError(
            "log", "be a table of text", f"other data in {path.name}", "export it as CSV"
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def _form(lines: list[str], path: Path) -> tuple[str, int]:
    """Return the delimiter and the number of cells of the lines that hold data.

    The delimiter that yields the most numbers is chosen.
    """
    best = 0
    form = (",", 0)
    for delimiter in _DELIMITERS:
        rows = [_cells(line, delimiter) for line in lines]
        widths = Counter(len(row) for row in rows if len(row) > 1 and _is_data(row))
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        score = sum(2 * _count(row) - len(row) for row in rows if len(row) == width)
        if score > best:
            best = score
            form = (delimiter, width)
    if not form[1]:
        raise InputError(
            "log",
            "hold a table with at least two columns of numbers",
            f"none in {path.name}",
            "export it as CSV",
        )
    return form


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line. An empty cell after the last delimiter is dropped."""
    if delimiter == " ":
        return line.split()
    row = next(csv.reader(StringIO(line), delimiter=delimiter), [])
    return row[:-1] if len(row) > 1 and not row[-1].strip() and _count(row) == len(row) - 1 else row


def _count(row: list[str]) -> int:
    return sum(_NUMBER.fullmatch(cell.strip()) is not None for cell in row)


def _is_data(row: list[str]) -> bool:
    """Return whether at least half of the non-empty cells hold numbers."""
    filled = sum(bool(cell.strip()) for cell in row)
    return filled > 0 and 2 * _count(row) >= filled


def _header(above: list[list[str]], width: int) -> tuple[tuple[str, ...], int, bool]:
    """Return the column names, the number of lines before them, and a flag.

    The flag is set if a line of units stands between the names and the data.
    """
    at = len(above) - 1
    while at >= 0 and not any(cell.strip() for cell in above[at]):
        at -= 1
    if at < 0 or len(above[at]) != width:
        return (), 0, False
    names = [cell.strip().removeprefix("#").strip() for cell in above[at]]
    units = [re.fullmatch(r"[\[(]?([A-Za-zµ°%/*· -]{0,6})[\])]?", name) for name in names]
    if at > 0 and len(above[at - 1]) == width and all(units):
        first = [cell.strip().removeprefix("#").strip() for cell in above[at - 1]]
        if not _count(first):
            stated = [unit[1].strip() if unit else "" for unit in units]
            joined = [
                f"{name} ({unit})" if unit else name
                for name, unit in zip(first, stated, strict=True)
            ]
            return tuple(joined), at - 1, True
    return tuple(names), at, False
