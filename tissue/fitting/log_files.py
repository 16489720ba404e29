"""Files of measured logs as columns: CSV, Parquet, HDF5, MATLAB and NumPy, and recordings of
volumetric_drilling.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Numbers
from meshes.base.errors import DamagedFileError, InputError, counted, is_file
from meshes.base.file_limits import read_npz, require_memory
from meshes.base.isolated_parser import Answer, parse_isolated
from meshes.base.text_tables import number_in
from tissue.motion.replay import read_drilling

__all__ = [
    "CHANNELS",
    "QUATERNION",
    "TIPS",
    "LogColumns",
    "mat_columns",
    "parquet_columns",
    "read_columns",
]


_DELIMITERS = (",", ";", "\t", " ")
_LOOKED_AT = 50
"""Number of lines at the end of a file that determine the form of a data line.

Lines at the start may be text of the instrument. The last line may be cut short.
"""
_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
_AGAIN = "fix that line or export the log again"


DRILLING = ("physics_data", "high_frequency_poses")
"""Groups that identify a recording of volumetric_drilling."""
TIPS = ("tool_x_mm", "tool_y_mm", "tool_z_mm")
QUATERNION = ("tool_qx", "tool_qy", "tool_qz", "tool_qw")
CHANNELS = ("force_x_N", "force_y_N", "force_z_N", "torque_x_Nm", "torque_y_Nm", "torque_z_Nm")
"""Loads on the tool, in the scene's frame, torques about the tip."""


@dataclass(frozen=True)
class LogColumns:
    """Columns of a log.

    Attributes
    ----------
    names
        Names of all columns, including columns without numbers.
    numbers
        Function that returns a column's numbers, shape (n,), by its name. It raises InputError if
        the column holds no numbers.
    notes
        Remarks on the columns, in words.
    """

    names: tuple[str, ...]
    numbers: Callable[[str], Array]
    notes: tuple[str, ...] = ()


def _text(path: Path) -> LogColumns:
    """Return the columns of a table of text, without any text before it.

    Columns without a header line have numbers from 1 as names.
    """
    lines = _decoded(path).splitlines()
    while lines and not lines[-1].strip():
        lines.pop()
    delimiter, width = _form(lines[-_LOOKED_AT:], path)
    cells = [_cells(line, delimiter) for line in lines]
    start = next(i for i, row in enumerate(cells) if len(row) == width and _is_data(row))
    header, above, has_units = _header(cells[:start], width)
    names = header or tuple(map(str, range(1, width + 1)))
    notes = []
    if above and header:
        notes.append(f"{counted(above, 'line')} before the header line {above + 1}")
    if has_units:
        notes.append(f"the units of line {start}")
    places = [at for at in range(start, len(lines)) if lines[at].strip()]
    if blank := len(lines) - start - len(places):
        notes.append(f"{counted(blank, 'blank line')} between the rows")
    # a logger that was stopped may leave an incomplete last line
    if len(cells[places[-1]]) < width:
        places.pop()
        notes.append("the last line, which is cut short, is left out")
    for at in places:
        if len(cells[at]) != width:
            found = f"{len(cells[at])} in line {at + 1} of {path.name}"
            raise InputError("log", f"hold {width} values a line", found, _AGAIN)

    def numbers(name: str) -> Array:
        if names.count(name) != 1:
            raise InputError(
                "column",
                "name one column of the log",
                f"{name}, which is there twice",
                "rename one",
            )
        column = names.index(name)
        found = np.empty(len(places))
        for row, at in enumerate(places):
            cell = cells[at][column].strip()
            try:
                found[row] = number_in(cell.replace(",", ".")) if cell else np.nan
            except ValueError:
                # a cell of a damaged file may be long
                text = f"{cell[:40]!r} for {name} in line {at + 1}"
                raise InputError("log", "hold numbers", text, _AGAIN) from None
        return found

    return LogColumns(names, numbers, tuple(notes))


def _decoded(path: Path) -> str:
    """Return the text of a file, decoded as UTF-8, UTF-16 or Windows-1252.

    A file that is not UTF-8 is read as UTF-16 if it begins like UTF-16, otherwise as Windows-1252.
    """
    content = path.read_bytes()
    # the byte order mark of UTF-16
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return content.decode("utf-16", "replace")
    # text in other encodings has no zero bytes; the start of a binary file has some
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
        rows = [row for row in (_cells(line, delimiter) for line in lines) if _is_data(row)]
        widths = Counter(len(row) for row in rows if len(row) > 1)
        if not widths:
            continue
        width = widths.most_common(1)[0][0]
        # numbers minus other cells, so that a wrong delimiter that cuts numbers apart loses
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
    # columns aligned by several spaces
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
    # a unit has at most six characters, such as mm/min; longer cells are names
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


def read_columns(path: Path) -> LogColumns:
    """Read the columns of a log.

    Raises
    ------
    InputError
        If the file is missing, of another kind or damaged, or if the library that reads it is not
        installed.
    """
    if not is_file(path):
        raise InputError(
            "measured", "be an existing file", path, "give a log such as a run's trace.csv"
        )
    require_memory(path.stat().st_size, path.name, "text or numbers")
    kind = path.suffix.lower()
    if kind not in READERS:
        known = ", ".join(READERS)
        raise InputError("measured", f"end in one of {known}", path.name, "export it as CSV")
    try:
        return READERS[kind](path)
    except (InputError, MemoryError):
        raise
    except Exception as problem:  # each reader raises kinds of its own for a damaged file
        raise InputError(
            "measured", f"be a whole {kind} file", f"{path} ({problem})", "export it again"
        ) from None


def _held(columns: Mapping[str, Any]) -> LogColumns:
    """Return columns of arrays. A matrix gives no columns."""
    flat = {name: np.squeeze(np.asarray(values)) for name, values in columns.items()}

    def numbers(name: str) -> Array:
        values = flat[name]
        if values.ndim != 1 or values.dtype.kind not in "fiu":
            raise InputError(
                "measured",
                f"hold a column of numbers as {name}",
                "another kind",
                "export it as numbers",
            )
        return values.astype(np.float64)

    return LogColumns(tuple(flat), numbers)


def _isolated(parser: str, path: Path) -> LogColumns:
    """Return the columns that a parser finds in a separate process."""
    name = f"tissue.fitting.log_files:{parser}"
    return _held(
        parse_isolated(name, path, what=f"{path.suffix} file", remedy="export it again")[1]
    )


def _parquet(path: Path) -> LogColumns:
    _module("pyarrow.parquet", "parquet")
    return _isolated("parquet_columns", path)


def _mat(path: Path) -> LogColumns:
    with path.open("rb") as stream:
        # the length of "MATLAB 7.3"
        first = stream.read(10)
    # such files are HDF5, which the reader of older MATLAB files refuses
    if first == b"MATLAB 7.3":
        return _structs(path)
    return _isolated("mat_columns", path)


def _h5(path: Path) -> LogColumns:
    h5py = _module("h5py", "h5")
    with h5py.File(path, "r") as file:
        # groups that only recordings of volumetric_drilling have
        if any(name in file for name in DRILLING):
            return _drilling(path)
        sets: dict[str, Any] = {}
        file.visititems(
            lambda name, each: sets.update({name: each}) if isinstance(each, h5py.Dataset) else None
        )
        count = sum(each.size or 0 for each in sets.values())
        require_memory(
            sum(each.nbytes for each in sets.values() if each.size),
            path.name,
            f"{count:.3g} numbers",
        )
        return _held({name: each[()] for name, each in sets.items()})


def _structs(path: Path) -> LogColumns:
    """Return the columns of a MATLAB 7.3 file.

    Columns of structs have the names of their fields if these are unique.
    """
    found = _h5(path)
    # MATLAB keeps its own data in groups such as #refs#
    whole = [name for name in found.names if not name.startswith("#")]
    fields = [name.rpartition("/")[2] for name in whole]
    places = {
        field if fields.count(field) == 1 else name: name
        for field, name in zip(fields, whole, strict=True)
    }
    return LogColumns(tuple(places), lambda name: found.numbers(places[name]), found.notes)


def _drilling(path: Path) -> LogColumns:
    """Return poses and loads of a recording of volumetric_drilling, each with separate times."""
    held = read_drilling(path, what="measured")
    poses = np.hstack([1e3 * held.tips_m, held.quaternions])
    columns = {"time_s": held.times_s, **dict(zip(TIPS + QUATERNION, poses.T, strict=True))}
    if held.load_times_s is not None and held.loads is not None and len(held.load_times_s):
        first, last = held.load_times_s[[0, -1]].tolist()
        # the times of forces and poses do not overlap, so they are on different clocks
        if first > held.times_s[-1] or last < 0.0:
            raise InputError(
                "measured",
                "hold forces while the poses last",
                f"forces from {first:.6g} to {last:.6g} s after the first pose and poses for "
                f"{held.times_s[-1]:.6g} s in {path}",
                "bring its time_stamps to one clock",
            )
        columns["load_time_s"] = held.load_times_s
        # torques may have been left out
        columns |= dict(zip(CHANNELS, held.loads.T, strict=False))
    return replace(_held(columns), notes=held.notes)


def _module(name: str, extra: str) -> Any:
    from importlib import import_module

    try:
        return import_module(name)
    except ImportError:
        raise InputError(
            "measured",
            "have what reads it installed",
            f"no {name}",
            f"pip install 'tissue-sim[{extra}]'",
        ) from None


READERS: dict[str, Callable[[Path], LogColumns]] = {
    ".csv": _text,
    ".txt": _text,
    ".tsv": _text,
    ".parquet": _parquet,
    ".npz": lambda path: _held(read_npz(path)),
    ".mat": _mat,
    ".h5": _h5,
    ".hdf5": _h5,
}


_BYTES = 8
"""Size of a number in memory [bytes]."""


def parquet_columns(file: Path) -> Answer:
    """Return the columns of a Parquet file by name.

    The recorded size of the file is first compared with the memory limit. A column without numbers
    is returned as an empty matrix, so that its name is known.
    """
    import pyarrow.parquet

    about = pyarrow.parquet.ParquetFile(file).metadata
    chunks = [
        about.row_group(k).column(j)
        for k in range(about.num_row_groups)
        for j in range(about.num_columns)
    ]
    needed = sum(max(_BYTES * chunk.num_values, chunk.total_uncompressed_size) for chunk in chunks)
    require_memory(
        max(needed, _BYTES * about.num_rows * about.num_columns),
        file.name,
        f"{about.num_rows:.3g} rows",
    )
    table = pyarrow.parquet.read_table(file)
    columns: dict[str, Numbers] = {}
    for name, values in zip(table.column_names, table.columns, strict=True):
        _require_new(name, columns)
        columns[name] = _numeric(values.to_numpy(zero_copy_only=False))
    return {}, columns


def mat_columns(file: Path) -> Answer:
    """Return the numeric arrays of a MATLAB file by name.

    Arrays of structs have the names of their fields. An entry without numbers is returned as an
    empty matrix, so that its name is known.
    """
    from scipy.io import loadmat

    columns: dict[str, Numbers] = {}
    for name, value in loadmat(file, squeeze_me=True).items():
        # SciPy's own entries, such as __header__
        if name.startswith("__"):
            continue
        held = {name: value}
        fields = getattr(getattr(value, "dtype", None), "names", None)
        # one struct of columns; an array of structs is not a column
        if fields and value.ndim == 0:
            held = {inner: value[inner].item() for inner in fields}
        for inner, each in held.items():
            _require_new(inner, columns)
            columns[inner] = _numeric(np.asarray(each))
    return {}, columns


def _require_new(name: str, columns: Mapping[str, object]) -> None:
    """Refuse a file with two columns of the same name."""
    if name in columns:
        raise DamagedFileError(f"two columns named {name}")


def _numeric(values: NDArray[Any]) -> Numbers:
    """Return an array of numbers as it is, and an empty matrix for anything else."""
    return values if values.dtype.kind in "fiu" else np.zeros((0, 0))
