"""Files of the trace: written in additional formats, and read from CSV.

Each format has an existing writer.
"""

import csv
from collections.abc import Callable
from importlib.util import find_spec
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import number_in, require_distinct_columns
from meshes.base.whole_file import whole_file
from tissue.simulation.trace import NO_LAYER, Table, TraceLayout

__all__ = [
    "FORMATS",
    "RECORDING",
    "check_format",
    "read_table",
    "read_trace",
    "write_table",
    "write_trace",
]

Columns = dict[str, NDArray[np.generic]]
RECORDING = "recording"
"""Format in which other programs read a run, see `tissue.simulation.recording`."""
WRITERS = {"parquet": ("pyarrow", "parquet"), "h5": ("h5py", "h5"), RECORDING: ("h5py", "h5")}
"""Package that writes a format, and the extra that installs it."""


def check_format(kind: str) -> None:
    """Refuse an unknown format, or a format whose writer is not installed.

    Raises
    ------
    InputError
        If the format cannot be written; the message names the known formats, or the extra to
        install.
    """
    if kind not in (*FORMATS, RECORDING):
        known = ", ".join((*FORMATS, RECORDING))
        raise InputError("format", f"be one of {known}", kind, "csv is always written")
    writer, extra = WRITERS.get(kind, ("", ""))
    if writer and find_spec(writer) is None:
        raise InputError(
            f"format {kind}",
            "have its writer installed",
            f"no {writer}",
            f"pip install 'tissue-sim[{extra}]'",
        )


def write_trace(trace: Table, folder: Path, kind: str) -> Path:
    """Write ``folder/trace.kind`` and return its path."""
    path = folder / f"trace.{kind}"
    with whole_file(path) as temporary:
        FORMATS[kind]({name: trace[name] for name in trace}, temporary)
    return path


def write_table(table: Table, path: Path) -> None:
    """Write columns to a file in the format of its suffix, such as ``.csv``.

    Raises
    ------
    InputError
        If the suffix is unknown, or its writer is not installed.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in ("csv", *FORMATS):
        known = ", ".join(f".{each}" for each in ("csv", *FORMATS))
        raise InputError("path", f"end in one of {known}", path.name, "choose one of these")
    if kind != "csv":
        check_format(kind)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        if kind != "csv":
            FORMATS[kind]({name: table[name] for name in table}, temporary)
            return
        head = StringIO()
        csv.writer(head, lineterminator="\n").writerow(table.columns)
        temporary.write_text(
            head.getvalue() + table.lines(0, len(table.rows)), "utf-8", newline="\n"
        )


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

    # Made in memory: HDF5 ends the process where its file cannot grow on a full disk.
    image = BytesIO()
    with h5py.File(image, "w") as file:
        for name, values in columns.items():
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

    An incomplete last line of a killed run is left out.

    Raises
    ------
    InputError
        If the file is no such table; the message names the line.
    """
    again = "fix that line or run the scene again"
    require_regular(path)
    try:
        content = path.read_bytes()
        text = content[: content.rfind(b"\n") + 1].decode("utf-8")
        whole = list(csv.reader(StringIO(text, newline=""), strict=True))
    except OSError as problem:
        raise InputError(
            path.name, "be a file that can be read", f"{path} ({problem.strerror})", "check it"
        ) from None
    except (UnicodeDecodeError, csv.Error) as problem:
        raise InputError(
            path.name, "be a CSV table", f"other data in {path}", "run the scene again"
        ) from problem
    columns = tuple(whole[0]) if whole else ()
    require_distinct_columns(columns, path.name, path)
    index = {name: float(i) for i, name in enumerate(layer_names)} | {NO_LAYER: -1.0}
    rows = np.empty((max(len(whole) - 1, 0), len(columns)))
    for number, line in enumerate(whole[1:]):
        where = f"in line {number + 2} of {path}: {again}"
        if len(line) != len(columns):
            raise InputError(
                f"{path.name} must hold {len(columns)} values a line, got {len(line)} {where}"
            )
        for place, (name, cell) in enumerate(zip(columns, line, strict=True)):
            try:
                rows[number, place] = index[cell] if name == "layer" else number_in(cell)
            except KeyError:
                known = ", ".join(index)
                raise InputError(
                    f"{path.name} must name a layer of the run ({known}), got {cell[:40]!r} {where}"
                ) from None
            except ValueError:
                raise InputError(
                    f"{path.name} must hold numbers, got {cell[:40]!r} for {name} {where}"
                ) from None
    return Table(columns, rows, layer_names)


def read_trace(path: Path, layer_names: tuple[str, ...]) -> Table:
    """Read the trace of a run; check that its standard columns exist and hold finite numbers.

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
        if table.columns.count(name) != 1:
            raise InputError(
                path.name,
                f"have the column {name} once",
                f"{path} with {table.columns.count(name)} of it",
                "run the scene again",
            )
    places = [table.columns.index(name) for name in wanted]
    bad = np.argwhere(~np.isfinite(table.rows[:, places]))
    if len(bad):
        line, place = bad[0]
        raise InputError(
            path.name,
            "hold finite numbers",
            f"{table.rows[line, places[place]]} for {wanted[place]} in line {line + 2} of {path}",
            "fix that line or run the scene again",
        )
    early = np.flatnonzero(np.diff(table["time_s"]) <= 0.0)
    if len(early):
        raise InputError(
            path.name,
            "have increasing time_s",
            f"line {early[0] + 3} of {path} no later than the one before",
            "fix that line or run the scene again",
        )
    return table
