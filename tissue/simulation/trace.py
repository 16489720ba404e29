"""Trace of a run: its columns, one row a tick, append-only, written to disk during the run."""

import csv
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from time import perf_counter
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray

from meshes.base.whole_file import claim

__all__ = [
    "LEAST_LOAD",
    "NO_LAYER",
    "TIMING_COLUMNS",
    "Table",
    "TraceLayout",
    "TraceWriter",
    "load_columns",
]

FLUSH_EVERY_S = 0.1
"""Longest time between two flushes [s].

A killed run loses at most this much wall time, plus a tick.
"""
NO_LAYER = "none"
LEAST_LOAD = 1e-12
"""Forces [N] and torques [N m] below which a trace holds 0.

A filter leaves such small values after the end of a contact.
"""
TIMING_COLUMNS = ("tick_us", "motion_us", "remove_us", "force_us", "record_us", "catch_up_us")


@dataclass(eq=False)
class Table(Mapping[str, NDArray[Any]]):
    """Table of columns by name, whose rows are only appended.

    The column ``layer`` holds names, all other columns hold numbers.

    Parameters
    ----------
    columns
        Names of the columns.
    rows
        Values, shape (rows, columns); ``layer`` as an index into ``layer_names``, -1 for none.
    layer_names
        Names of the layers.
    """

    columns: tuple[str, ...]
    rows: NDArray[np.float64]
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

    def vectors(self, name: str, unit: str) -> NDArray[np.float64]:
        """Return columns ``name_x_unit``, ``name_y_unit``, ``name_z_unit``, shape (rows, 3)."""
        return np.column_stack([self[f"{name}_{c}_{unit}"] for c in "xyz"])

    def lines(self, first: int, last: int) -> str:
        """Return rows as CSV text; reading the numbers back gives the same bits."""
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
    """Return a line of CSV without its end, quoted where necessary."""
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
        """Write the first ``row_count`` rows to disk if the last flush was long enough ago."""
        now = perf_counter()
        if force or now - self._flushed_at > FLUSH_EVERY_S:
            text = self._table.lines(self._written, row_count)
            # first: Ctrl-C may come when the rows are on disk
            self._written = row_count
            self._flushed_at = now
            self._write(text)

    def _write(self, text: str) -> None:
        """Write text to disk; an error names the file, which the system's error does not."""
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
    """Positions of the quantities in a row of the trace; fields are in the order of the columns.

    Attributes
    ----------
    columns
        Names of all columns; each carries its unit.
    time, removal_rate, removed, contact, layer
        Index of one column.
    tip, quaternion, velocity, spin
        Pose of the tool and its rates.
    commanded, wrench
        Force, then torque, as played and as the model gave them.
    removed_by_layer, measures
        One column per layer, and the measures of the tissue and the motion.
    """

    columns: tuple[str, ...]
    time: int
    tip: slice
    quaternion: slice
    velocity: slice
    spin: slice
    commanded: slice
    wrench: slice
    removal_rate: int
    removed: int
    removed_by_layer: slice
    contact: int
    measures: slice
    layer: int

    @classmethod
    def of(cls, layer_names: tuple[str, ...], measure_names: tuple[str, ...] = ()) -> "TraceLayout":
        """Return the layout for these layers and measures."""
        groups: dict[str, str | tuple[str, ...]] = {
            "time": "time_s",
            "tip": tuple(f"tool_{c}_mm" for c in "xyz"),
            "quaternion": tuple(f"tool_q{c}" for c in "xyzw"),
            "velocity": tuple(f"velocity_{c}_mm_s" for c in "xyz"),
            "spin": tuple(f"angular_velocity_{c}_rad_s" for c in "xyz"),
            "commanded": (*(f"force_{c}_N" for c in "xyz"), *(f"torque_{c}_Nm" for c in "xyz")),
            "wrench": (
                *(f"model_force_{c}_N" for c in "xyz"),
                *(f"model_torque_{c}_Nm" for c in "xyz"),
            ),
            "removal_rate": "removal_rate_mm3_s",
            "removed": "removed_mm3",
            "removed_by_layer": tuple(f"removed_{name}_mm3" for name in layer_names),
            "contact": "contact_mm2",
            "measures": measure_names,
            "layer": "layer",
        }
        columns: list[str] = []
        places: dict[str, Any] = {}
        for field, names in groups.items():
            start = len(columns)
            columns += [names] if isinstance(names, str) else names
            places[field] = start if isinstance(names, str) else slice(start, len(columns))
        return cls(tuple(columns), **places)


def load_columns(columns: tuple[str, ...]) -> NDArray[np.intp]:
    """Return indices of the forces and torques among the columns of a trace."""
    return np.array(
        [place for place, name in enumerate(columns) if name.endswith(("_N", "_Nm"))], dtype=np.intp
    )
