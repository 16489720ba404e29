"""Columns of Parquet files and of MATLAB files up to version 7; run by `meshes.base.isolated_parser`.

PyArrow ends the process on some damaged files. A few bytes of a MATLAB file can state any number of cells, which SciPy
allocates before it looks for them.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import DamagedFileError
from meshes.base.file_limits import require_memory
from meshes.base.isolated_parser import Answer

__all__ = ["mat_columns", "parquet_columns"]

_BYTES = 8
"""Of a number in memory."""


def parquet_columns(file: Path) -> Answer:
    """Return the columns of a Parquet file by name, after its stated size has been held against the memory limit.

    What holds no numbers is returned as an empty matrix, so that its name is known.
    """
    import pyarrow.parquet

    about = pyarrow.parquet.ParquetFile(file).metadata
    chunks = [about.row_group(k).column(j) for k in range(about.num_row_groups) for j in range(about.num_columns)]
    needed = sum(max(_BYTES * chunk.num_values, chunk.total_uncompressed_size) for chunk in chunks)
    require_memory(max(needed, _BYTES * about.num_rows * about.num_columns), file.name, f"{about.num_rows:.3g} rows")
    table = pyarrow.parquet.read_table(file)
    columns: dict[str, NDArray[np.number]] = {}
    for name, values in zip(table.column_names, table.columns, strict=True):
        _require_new(name, columns)
        columns[name] = _numeric(values.to_numpy(zero_copy_only=False))
    return {}, columns


def mat_columns(file: Path) -> Answer:
    """Return the numeric arrays of a MATLAB file by name, those of structs by the names of their fields.

    What holds no numbers is returned as an empty matrix, so that its name is known.
    """
    from scipy.io import loadmat

    columns: dict[str, NDArray[np.number]] = {}
    for name, value in loadmat(file, squeeze_me=True).items():
        if name.startswith("__"):
            continue
        fields = getattr(getattr(value, "dtype", None), "names", None)
        held = {inner: value[inner].item() for inner in fields} if fields and value.ndim == 0 else {name: value}
        for inner, each in held.items():
            _require_new(inner, columns)
            columns[inner] = _numeric(np.asarray(each))
    return {}, columns


def _require_new(name: str, columns: Mapping[str, object]) -> None:
    """Refuse a file in which two columns have one name."""
    if name in columns:
        raise DamagedFileError(f"two columns named {name}")


def _numeric(values: NDArray[Any]) -> NDArray[np.number]:
    """Return an array of numbers as it is, and an empty matrix for anything else."""
    return values if values.dtype.kind in "fiu" else np.zeros((0, 0))
