"""Readers of measured logs as columns.

The readers accept CSV, Parquet, HDF5, MATLAB and NumPy files, and recordings of
volumetric_drilling.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Numbers
from meshes.base.errors import DamagedFileError, InputError, enumerated, is_file
from meshes.base.extras import install_command
from meshes.base.file_limits import read_npz, require_memory
from meshes.base.isolated_parser import Answer, parse_isolated
from meshes.base.tables import read_table
from meshes.base.text_tables import number_in
from tissue.motion.drilling_recording import poses_group, read_drilling

_RATE = re.compile(r"(?:rate|frequency)\W*(\d+(?:[.,]\d+)?)\W*Hz", re.IGNORECASE)
"""Pattern of the rate in the text above a table, such as "Acquisition rate : 10.0 [Hz]".
"""
_RATE_NAME = re.compile(
    r"(?:.*/)?(?:fs|f_s|sr|(?:sampl\w*[_ ]?)?(?:rate|freq|frequency))[_ ]?[\[(]?(?:hz)?[\])]?",
    re.IGNORECASE,
)
"""Pattern of names of the sampling rate, such as sample_rate, fs and "Rate [Hz]"."""
TIPS = ("tool_x_mm", "tool_y_mm", "tool_z_mm")
QUATERNION = ("tool_qx", "tool_qy", "tool_qz", "tool_qw")
CHANNELS = ("force_x_N", "force_y_N", "force_z_N", "torque_x_Nm", "torque_y_Nm", "torque_z_Nm")
"""Names of load components on the tool in the scene's frame. Torques are about the tip."""


def refusal(path: Path, requirement: str, value: str, remedy: str) -> InputError:
    """Return the error for a wrong value in a file of measurements."""
    return InputError("measured", requirement, f"{value} in {path.name}", remedy)


@dataclass(frozen=True)
class LogColumns:
    """Columns of a log.

    Attributes
    ----------
    names
        Names of all columns, including columns without numbers.
    numbers
        Function that takes the name of a column and returns the numbers in the column, shape (n,).
        It raises InputError if the column holds no numbers.
    notes
        Remarks on the columns, as sentences.
    rate_Hz
        Sampling rate [Hz] that is stated in the text above the columns, or None.
    """

    names: tuple[str, ...]
    numbers: Callable[[str], Array]
    notes: tuple[str, ...] = ()
    rate_Hz: float | None = None


def _text(path: Path) -> LogColumns:
    """Return the columns of a table of text."""
    table = read_table(path, "measured", may_be_cut=True)
    rates = [found for line in table.above if (found := _RATE.search(line))]
    rate_Hz = number_in(rates[0][1].replace(",", ".")) if len(rates) == 1 else None
    rate_Hz = rate_Hz or _rate_Hz(table.names, table.numbers)
    return LogColumns(table.names, table.numbers, table.notes, rate_Hz)


def _rate_Hz(names: tuple[str, ...], numbers: Callable[[str], NDArray[Any]]) -> float | None:
    """Return the rate [Hz] from a column that is named like a rate and has one value, or None."""
    named = [name for name in names if _RATE_NAME.fullmatch(name)]
    if len(named) != 1:
        return None
    try:
        values = np.unique(numbers(named[0]))
    except InputError:  # a column of text
        return None
    is_rate = len(values) == 1 and values.dtype.kind in "fiu" and values[0] > 0.0
    return float(values[0]) if is_rate else None


def read_columns(path: Path) -> LogColumns:
    """Read the columns of a log.

    Raises
    ------
    InputError
        If the file is missing, damaged or of an unsupported kind, or if the library that reads it
        is not installed.
    """
    if not is_file(path):
        raise InputError(
            "measured", "be an existing file", path, "give a log such as a run's trace.csv"
        )
    require_memory(path.stat().st_size, path.name, "text or numbers")
    kind = path.suffix.lower()
    if kind not in READERS:
        known = enumerated(READERS, "or")
        raise InputError(
            "measured", f"be a file that ends in {known}", path.name, "export it as CSV"
        )
    try:
        return READERS[kind](path)
    except (InputError, MemoryError):
        raise
    except Exception as problem:  # each reader raises other exceptions for a damaged file
        raise InputError(
            "measured", f"be a readable {kind} file", f"{path} ({problem})", "export it again"
        ) from None


def _held(columns: Mapping[str, Any]) -> LogColumns:
    """Return the columns of a file. Only one-dimensional arrays count as numbers."""
    flat = {name: np.squeeze(np.asarray(values)) for name, values in columns.items()}

    def numbers(name: str) -> Array:
        """Return the numbers of a column, shape (n,)."""
        values = flat[name]
        if values.ndim != 1 or values.dtype.kind not in "fiu":
            raise InputError(
                "measured",
                f"have numbers in the column {name}",
                "other content",
                "export the column as numbers",
            )
        return values.astype(np.float64)

    return LogColumns(tuple(flat), numbers, rate_Hz=_rate_Hz(tuple(flat), flat.__getitem__))


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
        if poses_group(file) or "physics_data" in file:
            return _drilling(path)
        sets: dict[str, Any] = {}
        file.visititems(
            lambda name, each: sets.update({name: each}) if isinstance(each, h5py.Dataset) else None
        )
        for each in sets.values():
            # MATLAB 7.3 sets this attribute on objects, whose data lie in an undocumented subsystem
            if "MATLAB_object_decode" in each.attrs:
                kind = each.attrs.get("MATLAB_class", b"unknown")
                raise _matlab_object(path, kind.decode() if isinstance(kind, bytes) else str(kind))
        count = sum(each.size or 0 for each in sets.values())
        require_memory(
            sum(each.nbytes for each in sets.values() if each.size),
            path.name,
            f"{count:.3g} numbers",
        )
        return _held({name: each[()] for name, each in sets.items()})


def _structs(path: Path) -> LogColumns:
    """Return the columns of a MATLAB 7.3 file.

    A column from a struct is named after its field, if no other column has this name.
    """
    found = _h5(path)
    # MATLAB keeps its own data in groups such as #refs#
    whole = [name for name in found.names if not name.startswith("#")]
    fields = [name.rpartition("/")[2] for name in whole]
    places = {
        field if fields.count(field) == 1 else name: name
        for field, name in zip(fields, whole, strict=True)
    }
    return replace(found, names=tuple(places), numbers=lambda name: found.numbers(places[name]))


def _drilling(path: Path) -> LogColumns:
    """Return the poses and loads of a volumetric_drilling recording; both have their own times."""
    held = read_drilling(path, argument="measured")
    poses = np.hstack([1e3 * held.tips_m, held.quaternions])
    columns = {"time_s": held.times_s, **dict(zip(TIPS + QUATERNION, poses.T, strict=True))}
    if held.load_times_s is not None and held.loads is not None and len(held.load_times_s):
        first, last = held.load_times_s[[0, -1]].tolist()
        # the times of forces and poses do not overlap, so they are on different clocks
        if first > held.times_s[-1] or last < 0.0:
            raise InputError(
                "measured",
                "have forces in the time span of the poses",
                f"poses from 0 s to {held.times_s[-1]:.6g} s and forces from {first:.6g} s to "
                f"{last:.6g} s in {path}",
                "use the same clock for all time_stamps",
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
            "be readable with the installed packages",
            f"a file that needs {name}",
            f"run {install_command(extra)}",
        ) from None


READERS: dict[str, Callable[[Path], LogColumns]] = {
    **dict.fromkeys((".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm"), _text),
    ".parquet": _parquet,
    ".npz": lambda path: _held(read_npz(path)),
    ".mat": _mat,
    ".h5": _h5,
    ".hdf5": _h5,
}


_BYTES = 8
"""Size of a number in memory [bytes]."""


def parquet_columns(file: Path) -> Answer:
    """Return the columns of a Parquet file, keyed by name.

    Before the file is read, its recorded size is compared with the memory limit. A column without
    numbers is returned as an empty array, so that its name is still listed.
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
    """Return the numeric arrays of a MATLAB file, keyed by name.

    The arrays in a struct are named after its fields. An entry without numbers is returned as an
    empty array, so that its name is still listed.
    """
    from scipy.io import loadmat
    from scipy.io.matlab import MatlabObject, MatlabOpaque

    columns: dict[str, Numbers] = {}
    for name, value in loadmat(file, squeeze_me=True).items():
        # SciPy's own entries, such as __header__
        if name.startswith("__"):
            continue
        if isinstance(value, MatlabOpaque | MatlabObject):
            kind = value["s2"].item() if isinstance(value, MatlabOpaque) else value.classname
            kind = kind.decode() if isinstance(kind, bytes) else str(kind)
            raise _matlab_object(file, kind)
        held = {name: value}
        fields = getattr(getattr(value, "dtype", None), "names", None)
        # one struct of columns; an array of structs is not a column
        if fields and value.ndim == 0:
            held = {inner: value[inner].item() for inner in fields}
        for inner, each in held.items():
            _require_new(inner, columns)
            columns[inner] = _numeric(np.asarray(each))
    return {}, columns


def _matlab_object(path: Path, kind: str) -> InputError:
    """Return the error for a file with an object of a MATLAB class, such as timetable."""
    return refusal(
        path,
        "contain arrays or structs of numbers",
        f"an object of the MATLAB class {kind}",
        "in MATLAB, write it as CSV by writetimetable(x, 'log.csv') or writetable(x, 'log.csv')",
    )


def _require_new(name: str, columns: Mapping[str, object]) -> None:
    """Refuse a file with two columns of the same name."""
    if name in columns:
        raise DamagedFileError(f"two columns named {name}")


def _numeric(values: NDArray[Any]) -> Numbers:
    """Return numbers unchanged, dates as seconds from 1970, and other values as an empty matrix."""
    if values.dtype.kind == "M":
        return values.astype("datetime64[ns]").astype(np.int64) * 1e-9
    return values if values.dtype.kind in "fiu" else np.zeros((0, 0))
