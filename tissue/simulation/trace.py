"""Trace of a run with one row per tick: table in memory, and files in several formats."""

import csv
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO, StringIO
from pathlib import Path
from time import perf_counter
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import PRESENT, InputError
from meshes.base.extras import install_command
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import number_in, require_distinct_columns
from meshes.base.whole_file import claim, whole_file

FLUSH_EVERY_S = 0.1
"""Longest time between two writes of new rows to disk [s].

If the process is killed, at most the rows of this time and of one tick are lost.
"""
NO_LAYER = "none"
AGAIN = "run the scene again"
LEAST_LOAD = 1e-12
"""Smallest force [N] or torque [N m] in a trace; smaller values are written as 0.

A filter produces such small values after the end of a contact.
"""
TIMING_COLUMNS = ("tick_us", "motion_us", "remove_us", "force_us", "record_us", "catch_up_us")
Columns = dict[str, NDArray[np.generic]]
RECORDING = "recording"
"""Name of the format in which a run is recorded for other programs.

See `tissue.simulation.recording`.
"""
WRITERS = {"parquet": ("pyarrow", "parquet"), "h5": ("h5py", "h5"), RECORDING: ("h5py", "h5")}
"""Package that writes a format, and the extra of tissue that installs the package.

The keys are the names of the formats.
"""


def components(name: str, unit: str) -> tuple[str, ...]:
    """Return the names of the three columns of a vector."""
    return tuple(f"{name}_{c}_{unit}" for c in "xyz")


@dataclass(eq=False)
class Table(Mapping[str, NDArray[Any]]):
    """Table of columns, keyed by name; rows are only appended.

    The column ``layer`` contains names. All other columns contain numbers.

    Parameters
    ----------
    columns
        Names of the columns.
    rows
        Values, shape (rows, columns). The column ``layer`` contains indices into ``layer_names``,
        and -1 for no layer.
    layer_names
        Names of the layers.
    """

    columns: tuple[str, ...]
    rows: Array
    layer_names: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return one column, shape (rows,)."""
        if name not in self.columns:
            raise KeyError(f"{name!r} is not a column; known: {', '.join(self.columns)}")
        values = self.rows[:, self.columns.index(name)]
        if name == "layer":
            return np.array([*self.layer_names, NO_LAYER])[values.astype(int)]
        return values

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def vectors(self, name: str, unit: str) -> Array:
        """Return columns ``name_x_unit``, ``name_y_unit``, ``name_z_unit``, shape (rows, 3)."""
        return np.column_stack([self[each] for each in components(name, unit)])

    def quaternions(self, name: str = "tool") -> Array:
        """Return the orientations of the tool or of the device (x, y, z, w), shape (rows, 4)."""
        return np.column_stack([self[f"{name}_q{c}"] for c in "xyzw"])

    def lines(self, first: int, last: int) -> str:
        """Return rows as CSV text with enough digits to read the numbers back bit for bit."""
        text = []
        names = [*map(_cells, ([name] for name in self.layer_names)), NO_LAYER]
        for row in self.rows[first:last].tolist():
            if self.columns[-1] == "layer":
                row[-1] = names[int(row[-1])]
                text.append(",".join(map(str, row)))
            else:
                text.append(",".join(map(repr, row)))
        return "\n".join(text) + "\n" if text else ""


def _cells(cells: Iterable[str]) -> str:
    """Return a line of CSV without line end; cells are quoted if necessary."""
    line = StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    return line.getvalue()


class TraceWriter:
    """Writer that appends the rows of a table to a CSV file during the run.

    Parameters
    ----------
    path
        File to write.
    table
        Table whose rows are filled during the run.
    """

    def __init__(self, path: Path, table: Table) -> None:
        self._table = table
        self._path = path
        claim(path)
        self._file: TextIO = path.open("w", encoding="utf-8", newline="\n")
        self._written = 0
        self._flushed_at = 0.0
        self._write(_cells(table.columns) + "\n")

    def flush(self, row_count: int, *, force: bool = False) -> None:
        """Write the first ``row_count`` rows to disk; do nothing if the last write was recent."""
        now = perf_counter()
        if force or now - self._flushed_at > FLUSH_EVERY_S:
            text = self._table.lines(self._written, row_count)
            # This is set first, because Ctrl-C may come when the rows are on disk.
            self._written = row_count
            self._flushed_at = now
            self._write(text)

    def _write(self, text: str) -> None:
        """Write text to disk; if this fails, raise an error that names the file."""
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            error.filename = str(self._path)
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@dataclass(frozen=True)
class TraceLayout:
    """Columns of the trace.

    Attributes
    ----------
    columns
        Names of all columns, which end with the unit.
    at
        Indices of the columns of each quantity. The keys are ``time``, ``tip``, ``quaternion``,
        ``velocity``, ``spin``, ``commanded``, ``wrench``, ``removal_rate``, ``removed``,
        ``removed_by_layer``, ``contact``, ``tissue_measures``, ``motion_measures``,
        ``clear_measures`` and ``layer``. ``commanded`` are the forces and torques commanded to the
        device. ``wrench`` are the force and torque that the model computes. ``clear_measures`` are
        the distances to structures that must not be touched.
    """

    columns: tuple[str, ...]
    at: dict[str, slice]

    @classmethod
    def of(
        cls,
        layer_names: tuple[str, ...],
        tissue_measures: tuple[str, ...] = (),
        motion_measures: tuple[str, ...] = (),
        clear_measures: tuple[str, ...] = (),
    ) -> "TraceLayout":
        """Return the layout for the given layers and measures."""
        groups = {
            "time": ("time_s",),
            "tip": components("tool", "mm"),
            "quaternion": tuple(f"tool_q{c}" for c in "xyzw"),
            "velocity": components("velocity", "mm_s"),
            "spin": components("angular_velocity", "rad_s"),
            "commanded": components("force", "N") + components("torque", "Nm"),
            "wrench": components("model_force", "N") + components("model_torque", "Nm"),
            "removal_rate": ("removal_rate_mm3_s",),
            "removed": ("removed_mm3",),
            "removed_by_layer": tuple(
                f"removed_{name}_mm3".replace(" ", "_") for name in layer_names
            ),
            "contact": ("contact_mm2",),
            "tissue_measures": tissue_measures,
            "motion_measures": motion_measures,
            "clear_measures": clear_measures,
            "layer": ("layer",),
        }
        columns: list[str] = []
        at = {}
        for quantity, names in groups.items():
            at[quantity] = slice(len(columns), len(columns) + len(names))
            columns += names
        return cls(tuple(columns), at)


def check_format(kind: str) -> None:
    """Check that a format is known and that the package for the format is installed.

    Raises
    ------
    InputError
        If the format is unknown or its package is missing. The message shows the known formats, or
        the extra to install.
    """
    if kind not in (*FORMATS, RECORDING):
        known = ", ".join((*FORMATS, RECORDING))
        raise InputError("format", f"be one of {known}", kind, "CSV is always written")
    writer, extra = WRITERS.get(kind, ("", ""))
    if writer and find_spec(writer) is None:
        raise InputError(
            f"format {kind}",
            f"have the package {writer} installed",
            PRESENT,
            f"run {install_command(extra)}",
        )


def write_columns(columns: Columns, path: Path) -> None:
    """Write columns to a file; the file suffix, one of `FORMATS`, determines the format."""
    with whole_file(path) as temporary:
        FORMATS[path.suffix.lower().removeprefix(".")](columns, temporary)


def write_table(table: Table, path: Path) -> None:
    """Write columns to a file in the format of its suffix, such as ``.csv``.

    Raises
    ------
    InputError
        If the suffix is unknown, or the package that writes the format is not installed.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("csv", *FORMATS):
        known = ", ".join(f".{each}" for each in ("csv", *FORMATS))
        raise InputError("path", f"end in one of {known}", path.name, "choose one of these")
    if kind != "csv":
        check_format(kind)
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind != "csv":
        write_columns({name: table[name] for name in table}, path)
        return
    with whole_file(path) as temporary:
        text = f"{_cells(table.columns)}\n{table.lines(0, len(table.rows))}"
        temporary.write_text(text, "utf-8", newline="\n")


def _npz(columns: Columns, path: Path) -> None:
    np.savez_compressed(path, **columns)  # type: ignore[arg-type]


def _mat(columns: Columns, path: Path) -> None:
    from scipy.io import savemat

    text = {
        name: values.astype(object) if values.dtype.kind == "U" else values
        for name, values in columns.items()
    }
    savemat(path, {"trace": text}, do_compression=True, oned_as="column", long_field_names=True)


def _parquet(columns: Columns, path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table(columns), path)


def _h5(columns: Columns, path: Path) -> None:
    import h5py

    # The file is made in memory, because HDF5 ends the process if its file cannot grow on a full
    # disk.
    image = BytesIO()
    with h5py.File(image, "w") as file:
        for name, values in columns.items():
            # h5py refuses NumPy's Unicode text ("No conversion path for dtype").
            file.create_dataset(
                name, data=values.astype("S") if values.dtype.kind == "U" else values
            )
    path.write_bytes(image.getbuffer())


FORMATS: dict[str, Callable[[Columns, Path], None]] = {
    "parquet": _parquet,
    "npz": _npz,
    "mat": _mat,
    "h5": _h5,
}


def read_table(path: Path, layer_names: tuple[str, ...]) -> Table:
    """Read a CSV file written by :class:`TraceWriter`.

    An incomplete last line, written by a process that was killed, is ignored.

    Raises
    ------
    InputError
        If the file was not written by a `TraceWriter`. The message names the line.
    """
    require_regular(path)
    try:
        content = path.read_bytes()
        text = content[: content.rfind(b"\n") + 1].decode("utf-8")
        whole = list(csv.reader(StringIO(text, newline=""), strict=True))
    except OSError as problem:
        raise InputError(
            path.name,
            "be a file that can be read",
            f"{path} ({problem.strerror})",
            "check the file",
        ) from None
    except (UnicodeDecodeError, csv.Error) as problem:
        raise InputError(path.name, "be a CSV table", f"other data in {path}", AGAIN) from problem
    columns = tuple(whole[0]) if whole else ()
    require_distinct_columns(columns, path.name, path)
    index = {name: float(i) for i, name in enumerate(layer_names)} | {NO_LAYER: -1.0}
    rows = np.empty((max(len(whole) - 1, 0), len(columns)))
    for number, line in enumerate(whole[1:]):
        if len(line) != len(columns):
            raise _line_error(path, number, f"have {len(columns)} values in each line", len(line))
        for place, (name, cell) in enumerate(zip(columns, line, strict=True)):
            try:
                rows[number, place] = index[cell] if name == "layer" else number_in(cell)
            except KeyError:
                wanted = f"name a layer of the run ({', '.join(index)})"
                raise _line_error(path, number, wanted, repr(cell[:40])) from None
            except ValueError:
                # A damaged cell may be long, so the message is cut.
                got = f"{cell[:40]!r} for {name}"
                raise _line_error(path, number, "contain only numbers", got) from None
    return Table(columns, rows, layer_names)


def _line_error(path: Path, row: int, wanted: str, got: object) -> InputError:
    """Return the error for an invalid row of a CSV file."""
    where = f"{got} in line {row + 2} of {path}"
    return InputError(path.name, wanted, where, f"fix that line or {AGAIN}")


def read_trace(path: Path, layer_names: tuple[str, ...]) -> Table:
    """Read the trace of a run, and check that its standard columns exist and are finite.

    Raises
    ------
    InputError
        As for `read_table`, or if a column is missing, a number is not finite, or the time does not
        increase.
    """
    table = read_table(path, layer_names)
    if not table.columns:
        return table
    wanted = TraceLayout.of(layer_names).columns
    for name in wanted:
        if name not in table.columns:
            raise InputError(path.name, f"have the column {name}", f"{path} without it", AGAIN)
    places = [table.columns.index(name) for name in wanted]
    bad = np.argwhere(~np.isfinite(table.rows[:, places]))
    if len(bad):
        row, place = bad[0]
        got = f"{table.rows[row, places[place]]} for {wanted[place]}"
        raise _line_error(path, row, "contain only finite numbers", got)
    early = np.flatnonzero(np.diff(table["time_s"]) <= 0.0)
    if len(early):
        raise _line_error(path, early[0] + 1, "have increasing time_s", "an earlier time")
    return table
