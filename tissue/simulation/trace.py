"""The trace: one row a tick, append-only, flushed to disk while the run goes on."""

import csv
from collections.abc import Iterable, Iterator, Mapping
from io import StringIO
from pathlib import Path
from time import perf_counter
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.simulation.trace_layout import TraceLayout

__all__ = [
    "LEAST_LOAD",
    "TIMING_COLUMNS",
    "Table",
    "TraceWriter",
    "read_table",
    "read_trace",
]

FLUSH_EVERY_S = 0.1
"""A killed run loses at most this much wall time, plus a tick."""
NO_LAYER = "none"
LEAST_LOAD = 1e-12
"""Forces [N] and torques [N m] of a trace below it are written as 0: what a filter leaves of a contact that is over."""
TIMING_COLUMNS = ("tick_us", "motion_us", "remove_us", "force_us", "record_us", "catch_up_us")


class Table(Mapping[str, NDArray[Any]]):
    """Columns by name over rows that are only appended. The column ``layer`` holds names, all others numbers.

    Parameters
    ----------
    columns
        Names of the columns.
    rows
        Values, shape (rows, columns); ``layer`` as an index into ``layer_names``, -1 for none.
    layer_names
        Names of the layers.
    """

    def __init__(self, columns: tuple[str, ...], rows: NDArray[np.float64], layer_names: tuple[str, ...] = ()) -> None:
        self.columns, self.rows, self.layer_names = columns, rows, layer_names

    def __getitem__(self, name: str) -> NDArray[Any]:
        """One column, shape (rows,)."""
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

    def vectors(self, name: str, unit: str) -> NDArray[np.float64]:
        """Columns ``name_x_unit``, ``name_y_unit``, ``name_z_unit``, shape (rows, 3)."""
        return np.column_stack([self[f"{name}_{c}_{unit}"] for c in "xyz"])

    def lines(self, first: int, last: int) -> str:
        """Rows as CSV text; numbers print so that reading them back gives the same bits."""
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
    """A line of CSV without its end, quoted where it has to be."""
    line = StringIO()
    csv.writer(line, lineterminator="").writerow(cells)
    return line.getvalue()


class TraceWriter:
    """Appends the rows of one table to a CSV file while they are made.

    Parameters
    ----------
    path
        File to write.
    table
        The table whose rows fill up during the run.
    """

    def __init__(self, path: Path, table: Table) -> None:
        self._table, self._path = table, path
        self._file: TextIO = path.open("w", encoding="utf-8", newline="\n")
        self._written = 0
        self._flushed_at = 0.0
        self._write(_cells(table.columns) + "\n")

    def flush(self, row_count: int, *, force: bool = False) -> None:
        """Bring the first ``row_count`` rows to disk if the last flush was a while ago."""
        now = perf_counter()
        if force or now - self._flushed_at > FLUSH_EVERY_S:
            self._write(self._table.lines(self._written, row_count))
            self._written, self._flushed_at = row_count, now

    def _write(self, text: str) -> None:
        """Bring text to disk; an error names the file, which the system's own does not."""
        try:
            self._file.write(text)
            self._file.flush()
        except OSError as error:
            error.filename = str(self._path)
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_table(path: Path, layer_names: tuple[str, ...]) -> Table:
    """Read a CSV written by :class:`TraceWriter`; a last line cut short by a killed run is left out.

    Raises
    ------
    InputError
        If the file is no such table, naming the line.
    """
    again = "mend that line or run the scene again"
    try:
        content = path.read_bytes()
        text = content[: content.rfind(b"\n") + 1].decode("utf-8")
        whole = list(csv.reader(StringIO(text, newline=""), strict=True))
    except OSError as problem:
        raise InputError(
            f"{path.name} must be a file that can be read, got {path} ({problem.strerror}): check it"
        ) from None
    except (UnicodeDecodeError, csv.Error) as problem:
        raise InputError(f"{path.name} must be a CSV table, got other data in {path}: run the scene again") from problem
    columns = tuple(whole[0]) if whole else ()
    index = {name: float(i) for i, name in enumerate(layer_names)} | {NO_LAYER: -1.0}
    rows = np.empty((max(len(whole) - 1, 0), len(columns)))
    for number, line in enumerate(whole[1:]):
        where = f"in line {number + 2} of {path}: {again}"
        if len(line) != len(columns):
            raise InputError(f"{path.name} must hold {len(columns)} values a line, got {len(line)} {where}")
        for place, (name, cell) in enumerate(zip(columns, line, strict=True)):
            try:
                rows[number, place] = index[cell] if name == "layer" else float(cell)
            except KeyError:
                known = ", ".join(index)
                raise InputError(
                    f"{path.name} must name a layer of the run ({known}), got {cell[:40]!r} {where}"
                ) from None
            except ValueError:
                raise InputError(f"{path.name} must hold numbers, got {cell[:40]!r} for {name} {where}") from None
    return Table(columns, rows, layer_names)


def read_trace(path: Path, layer_names: tuple[str, ...]) -> Table:
    """Read the trace of a run, with all the columns that every run has and finite numbers in them.

    Raises
    ------
    InputError
        As `read_table`, or if a column is missing, a number not finite, or the time does not increase.
    """
    table = read_table(path, layer_names)
    if not table.columns:
        return table
    wanted = TraceLayout.of(layer_names).columns
    for name in wanted:
        if table.columns.count(name) != 1:
            raise InputError(
                f"{path.name} must have the column {name} once, got {path} with {table.columns.count(name)} of it: run "
                "the scene again"
            )
    places = [table.columns.index(name) for name in wanted]
    bad = np.argwhere(~np.isfinite(table.rows[:, places]))
    if len(bad):
        line, place = bad[0]
        raise InputError(
            f"{path.name} must hold finite numbers, got {table.rows[line, places[place]]} for {wanted[place]} in line "
            f"{line + 2} of {path}: mend that line or run the scene again"
        )
    early = np.flatnonzero(np.diff(table["time_s"]) <= 0.0)
    if len(early):
        raise InputError(
            f"{path.name} must have increasing time_s, got line {early[0] + 3} of {path} no later than the one before: "
            "mend that line or run the scene again"
        )
    return table
