"""Text tables exported by programs and instruments.

The encoding, the separator, the decimal mark and the header line are detected from the content.
Dates and times of day are converted to seconds.
"""

import csv
import re
from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from io import StringIO
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from meshes.base.text_tables import number_in

_DELIMITERS = (",", ";", "\t", " ")
_LOOKED_AT = 50
"""Number of lines at the end of a file from which the format of a data line is detected.

The first lines are not used, because they may contain a description from the instrument. The last
line may be incomplete.
"""
_SPACES = "'’\u00a0\u202f"
"""Thousands separators in addition to point, comma and space."""
_NUMBER = re.compile(
    rf"[+-]?(\d{{1,3}}([.,{_SPACES} ]\d{{3}})+([.,]\d*)?|\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?"
    r"|[+-]?(nan|inf)",
    re.IGNORECASE,
)
_BETWEEN_DIGITS = re.compile(rf"(?<=\d)[{_SPACES} ](?=\d{{3}})")
_TIME_OF_DAY = re.compile(
    r"(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[ T]+)?"
    r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)\s*([AaPp][Mm])?"
)
"""Regular expression for a time of day, optionally after a date.

Day and month of the date may have any order.
"""
_DAY_S = 86400.0
_AGAIN = "fix that line or export the file again"


@dataclass(frozen=True, eq=False)
class TextTable:
    """Table whose cells are text.

    Attributes
    ----------
    path
        File.
    what
        Description of the file in error messages.
    names
        Header of each column. If there is no header line, the names are the column numbers,
        starting at 1.
    rows
        Cells of each row.
    lines
        Line number of each row in the file.
    above
        Text lines that precede the header.
    marks
        Decimal mark and thousands separator. The separator may be empty.
    notes
        Assumptions and changes, one sentence each.
    """

    path: Path
    what: str
    names: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]
    above: tuple[str, ...]
    marks: tuple[str, str]
    notes: tuple[str, ...]

    def numbers(self, name: str) -> Array:
        """Return the numbers of a column, shape (n,). An empty cell becomes NaN.

        Dates with times are converted to seconds since 1970 in UTC. Times without a time zone count
        as UTC. Times of day are converted to seconds since the midnight before the first row's
        time.

        Raises
        ------
        InputError
            If no column or several columns have this name, or a cell does not contain a number.
        """
        if self.names.count(name) != 1:
            raise InputError(
                self.what,
                f"have exactly one column named {name}",
                f"{self.names.count(name)} in {self.path.name}",
                "rename the columns",
            )
        column = self.names.index(name)
        cells = [row[column].strip() for row in self.rows]
        is_time = bool(cells) and ":" in cells[0]
        convert = _date_s if is_time else self._number
        found = np.empty(len(cells))
        for row, cell in enumerate(cells):
            try:
                found[row] = convert(cell)
            except ValueError:
                where = f"the column {name} in line {self.lines[row]} of {self.path.name}"
                text = f"{cell[:40]!r} in {where}"
                raise InputError(self.what, "contain only numbers", text, _AGAIN) from None
        if is_time and not (found > _DAY_S).any():
            # Times of day start again at 0 at midnight.
            found += _DAY_S * np.cumsum(np.diff(found, prepend=found[0]) < -0.5 * _DAY_S)
        return found

    def finite(self, name: str) -> Array:
        """Return the numbers of a column as `numbers` does, but do not allow empty cells.

        Raises
        ------
        InputError
            If a cell is empty or not finite.
        """
        found = self.numbers(name)
        wrong = np.flatnonzero(~np.isfinite(found))
        if len(wrong):
            row = int(wrong[0])
            cell = self.rows[row][self.names.index(name)].strip() or "an empty cell"
            text = f"{cell[:40]} in the column {name} in line {self.lines[row]} of {self.path}"
            raise InputError(self.what, "contain only finite numbers", text, "fix that line")
        return found

    def _number(self, cell: str) -> float:
        """Convert a cell to a number. The number of an empty cell is NaN."""
        if not cell:
            return np.nan
        decimal, thousands = self.marks
        is_plain = self.marks == (".", "")
        if is_plain and cell.isascii() and " " not in cell and "'" not in cell:
            return number_in(cell)
        if thousands:
            cell = cell.replace(thousands, "")
        if decimal == ",":
            cell = cell.replace(",", ".")
        return number_in(_BETWEEN_DIGITS.sub("", cell))


def _date_s(text: str) -> float:
    """Convert a date and time to seconds since 1970, or a time of day to seconds since midnight."""
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        found = _TIME_OF_DAY.fullmatch(text)
        if not found:
            raise
        hours = int(found[1])
        if found[4]:
            hours = hours % 12 + (12 if found[4].upper() == "PM" else 0)
        return 3600.0 * hours + 60.0 * int(found[2]) + float(found[3].replace(",", "."))
    # without a time zone, all times are in the same zone, so UTC gives the same differences
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def decoded_text(path: Path, what: str, *, remedy: str = "export it as CSV") -> str:
    """Return the text of a file, decoded as UTF-8, UTF-16 or Windows-1252.

    Parameters
    ----------
    path
        File.
    what
        Description of the file in error messages.
    remedy
        Advice for a file that is not text.

    Raises
    ------
    InputError
        If the file does not contain text.
    """
    content = path.read_bytes()
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):  # byte order mark of UTF-16
        return content.decode("utf-16", "replace")
    # in UTF-16, ASCII text has a zero in every second byte
    for start, encoding in ((1, "utf-16-le"), (0, "utf-16-be")):
        if content[start:4096:2].count(0) > 0.9 * len(content[start:4096:2]) > 1.0:
            return content.decode(encoding, "replace")
    # text in other encodings has no zero bytes, but a binary file has zero bytes near its start
    if b"\0" in content[:4096]:
        raise InputError(what, "be a text file", f"binary data in {path.name}", remedy)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", "replace")


def read_table(path: Path, what: str, *, may_be_cut: bool = False) -> TextTable:
    """Read a text table. Text before the header is stored in `TextTable.above`.

    Parameters
    ----------
    path
        File.
    what
        Description of the file in error messages.
    may_be_cut
        Whether the last line may be incomplete, for example because a logger was stopped. An
        incomplete line is omitted.

    Raises
    ------
    InputError
        If the file does not contain a table, or the rows have different numbers of cells.
    """
    lines = decoded_text(path, what).splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    delimiter, width = _form(lines[-_LOOKED_AT:], path, what)
    cells = [_cells(line, delimiter) for line in lines]
    if not any(row[-1].strip() for row in cells if len(row) == width):
        # every line ends with a separator
        cells = [row[:-1] if len(row) == width else row for row in cells]
        width -= 1
    start = next(i for i, row in enumerate(cells) if len(row) == width and _is_data(row))
    _require_decimal_points(cells[:start], cells[start:], delimiter, path, what)
    header, above, has_units = _header(cells[:start], width)
    notes = []
    if above and header:
        notes.append(f"{counted(above, 'line')} before the header line {above + 1}")
    if has_units:
        notes.append(f"the units of line {start}")
    places = [at for at in range(start, len(lines)) if lines[at].strip()]
    if blank := len(lines) - start - len(places):
        notes.append(f"{counted(blank, 'blank line')} between the rows")
    if may_be_cut and len(cells[places[-1]]) < width:
        places.pop()
        notes.append("the last line, which is cut short, is left out")
    for at in places:
        if len(cells[at]) != width:
            found = f"{len(cells[at])} in line {at + 1} of {path.name}"
            raise InputError(what, f"have {width} values in each line", found, _AGAIN)
    rows = [cells[at] for at in places]
    marks = _marks(rows, delimiter, path, what)
    if marks[1]:
        notes.append(f"numbers have the decimal mark {marks[0]!r} and thousands {marks[1]!r}")
    return TextTable(
        path,
        what,
        header or tuple(map(str, range(1, width + 1))),
        rows,
        [at + 1 for at in places],
        tuple(lines[:above]),
        marks,
        tuple(notes),
    )


def _form(lines: list[str], path: Path, what: str) -> tuple[str, int]:
    """Return the delimiter of the data lines, and the number of cells in each data line.

    The delimiter that gives the most numbers is chosen.
    """
    best = 0
    form = (",", 0)
    for delimiter in _DELIMITERS:
        rows = [row for row in (_cells(line, delimiter) for line in lines) if _is_data(row)]
        widths = Counter(len(row) for row in rows if len(row) > 1)
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        # score of numbers minus other cells, so that a wrong delimiter that splits numbers has a
        # lower score
        score = sum(2 * _count(row) - len(row) for row in rows if len(row) == width)
        if score > best:
            best = score
            form = (delimiter, width)
    if not form[1]:
        raise InputError(
            what,
            "contain a table with at least two columns of numbers",
            f"none in {path.name}",
            "export it as CSV",
        )
    return form


def _cells(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line."""
    # columns may be aligned by several spaces
    if delimiter == " ":
        return line.split()
    return next(csv.reader(StringIO(line), delimiter=delimiter, skipinitialspace=True), [])


def _count(row: list[str]) -> int:
    """Return the number of cells that contain numbers, dates or times."""
    return sum(_is_number(cell.strip()) for cell in row)


def _is_number(cell: str) -> bool:
    if ":" not in cell:
        return _NUMBER.fullmatch(cell) is not None
    try:
        _date_s(cell)
    except ValueError:
        return False
    return True


def _is_data(row: list[str]) -> bool:
    """Return whether at least half of the non-empty cells contain numbers."""
    filled = sum(bool(cell.strip()) for cell in row)
    return filled > 0 and 2 * _count(row) >= filled


def _require_decimal_points(
    above: list[list[str]], rows: list[list[str]], delimiter: str, path: Path, what: str
) -> None:
    """Raise an error for a table that uses commas both as separators and as decimal marks.

    In such a table, rows have more cells than the header, and no cell has a decimal point.
    """
    header = next((row for row in reversed(above) if len(row) > 1), [])
    if delimiter != "," or not header or _count(header):
        return
    filled = [row for row in rows if row]
    if all(len(row) > len(header) for row in filled) and not any("." in "".join(r) for r in filled):
        raise InputError(
            f"{what}: {path.name} has decimal commas, and commas between its columns. Export it "
            "with decimal points, or with semicolons between the columns."
        )


def _marks(rows: list[list[str]], delimiter: str, path: Path, what: str) -> tuple[str, str]:
    """Return the decimal mark and the thousands separator, which may be empty.

    Common notations are tried in turn until one fits all numbers. A number such as 1,234 has a
    thousands separator only if commas also separate the columns, or if another number has a decimal
    point.
    """
    cells = [cell.strip() for row in rows for cell in row if "," in cell or "." in cell]
    if not any("," in cell or cell.count(".") > 1 for cell in cells):
        return ".", ""
    numbers = [cell for cell in cells if _NUMBER.fullmatch(cell)]
    notations = [(".", ""), (",", ""), (".", ","), (",", ".")]
    if delimiter == ",":
        notations.insert(1, (".", ","))
    misfits = dict[str, str]()
    for decimal, thousands in notations:
        whole = rf"\d*|[1-9]\d{{0,2}}([{thousands}{_SPACES} ]\d{{3}})+"
        notation = re.compile(rf"[+-]?({whole})([{decimal}]\d*)?([eE][+-]?\d+)?")
        misfit = next((cell for cell in numbers if not notation.fullmatch(cell)), None)
        if misfit is None:
            return decimal, thousands
        # The last notation of each decimal mark also allows a thousands separator.
        misfits[decimal] = misfit
    comma = misfits["."]
    point = misfits[","]
    if comma == point:
        raise InputError(
            f"{what}: {path.name} has {comma!r}, which is not a number. Write it without a "
            "thousands separator."
        )
    raise InputError(
        f"{what}: {path.name} has numbers with a decimal comma and with a decimal point, for "
        f"example {comma!r} and {point!r}. Export it with one of them."
    )


def _header(above: list[list[str]], width: int) -> tuple[tuple[str, ...], int, bool]:
    """Return the column names, the number of lines before the names, and a flag.

    The flag is set if there is a line of units between the names and the data.
    """
    at = len(above) - 1
    while at >= 0 and not any(cell.strip() for cell in above[at]):
        at -= 1
    if at < 0 or len(above[at]) != width:
        return (), 0, False
    names = [cell.lstrip(" \t#%").strip() for cell in above[at]]
    # a unit has at most six characters, such as mm/min; longer cells are names
    units = [re.fullmatch(r"[\[(]?([A-Za-zµ°%/*· -]{0,6})[\])]?", name) for name in names]
    if at > 0 and len(above[at - 1]) == width and all(units):
        first = [cell.lstrip(" \t#%").strip() for cell in above[at - 1]]
        if not _count(first):
            stated = [unit[1].strip() if unit else "" for unit in units]
            joined = [
                f"{name} ({unit})" if unit else name
                for name, unit in zip(first, stated, strict=True)
            ]
            return tuple(joined), at - 1, True
    return tuple(names), at, False
