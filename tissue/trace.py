"""The trace: one row a tick, append-only, flushed to disk while the run goes on."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from time import perf_counter
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

__all__ = ["TIMING_COLUMNS", "Table", "TraceWriter", "read_table", "trace_columns"]

FLUSH_EVERY_S = 0.1
"""A killed run loses at most this much wall time, plus a tick."""
NO_LAYER = "none"
TIMING_COLUMNS = ("tick_us", "motion_us", "remove_us", "force_us", "record_us", "catch_up_us")


def trace_columns(layer_names: tuple[str, ...], measure_names: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Names of the trace's columns; each carries its unit."""
    return (
        "time_s",
        *(f"tool_{c}_mm" for c in "xyz"),
        *(f"tool_q{c}" for c in "xyzw"),
        *(f"velocity_{c}_mm_s" for c in "xyz"),
        *(f"angular_velocity_{c}_rad_s" for c in "xyz"),
        *(f"force_{c}_N" for c in "xyz"),
        *(f"torque_{c}_Nm" for c in "xyz"),
        *(f"model_force_{c}_N" for c in "xyz"),
        *(f"model_torque_{c}_Nm" for c in "xyz"),
        "removal_rate_mm3_s",
        "removed_mm3",
        *(f"removed_{name}_mm3" for name in layer_names),
        "contact_mm2",
        *measure_names,
        "layer",
    )


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
        for row in self.rows[first:last].tolist():
            if self.columns[-1] == "layer":
                index = int(row.pop())
                row.append(self.layer_names[index] if index >= 0 else NO_LAYER)
                text.append(",".join(map(str, row)))
            else:
                text.append(",".join(map(repr, row)))
        return "\n".join(text) + "\n" if text else ""


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
        self._write(",".join(table.columns) + "\n")

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
    """Read a CSV written by :class:`TraceWriter`; a last line cut short by a killed run is left out."""
    text = path.read_text("utf-8")
    whole = text[: text.rfind("\n") + 1].splitlines()
    columns = tuple(whole[0].split(",")) if whole else ()
    index = {name: float(i) for i, name in enumerate(layer_names)} | {NO_LAYER: -1.0}
    rows = np.array(
        [[index[cell] if cell in index else float(cell) for cell in line.split(",")] for line in whole[1:]]
    ).reshape(len(whole[1:]), len(columns))
    return Table(columns, rows, layer_names)
