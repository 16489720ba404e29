"""The trace in further file formats, each by an existing writer."""

from collections.abc import Callable, Iterable
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file
from tissue.simulation.trace import Table

__all__ = ["FORMATS", "check_formats", "write_trace"]


def check_formats(formats: Iterable[str]) -> None:
    """Refuse an unknown format, or one whose writer is not installed, before anything is run.

    Raises
    ------
    InputError
        Names the known formats, or the extra to install.
    """
    for kind in formats:
        if kind not in FORMATS:
            raise InputError(f"format must be one of {', '.join(FORMATS)}, got {kind}: csv is always written")
        writer = {"parquet": "pyarrow", "h5": "h5py"}.get(kind)
        if writer is not None:
            try:
                import_module(writer)
            except ImportError:
                raise InputError(
                    f"format {kind} must have its writer installed, got no {writer}: pip install 'tissue-sim[{kind}]'"
                ) from None


def write_trace(trace: Table, folder: Path, kind: str) -> Path:
    """Write ``folder/trace.kind`` and return its path."""
    path = folder / f"trace.{kind}"
    with whole_file(path) as temporary:
        FORMATS[kind]({name: trace[name] for name in trace}, temporary)
    return path


def _npz(columns: dict[str, np.ndarray[Any, Any]], path: Path) -> None:
    np.savez_compressed(path, **columns)  # type: ignore[arg-type]


def _mat(columns: dict[str, np.ndarray[Any, Any]], path: Path) -> None:
    from scipy.io import savemat

    text = {name: values.astype(object) if values.dtype.kind == "U" else values for name, values in columns.items()}
    savemat(path, {"trace": text}, do_compression=True, oned_as="column", long_field_names=True)


def _parquet(columns: dict[str, np.ndarray[Any, Any]], path: Path) -> None:
    import pyarrow
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table(columns), path)


def _h5(columns: dict[str, np.ndarray[Any, Any]], path: Path) -> None:
    import h5py

    # Made in memory: HDF5 ends the process where its file cannot grow on a full disk.
    image = BytesIO()
    with h5py.File(image, "w") as file:
        for name, values in columns.items():
            file.create_dataset(name, data=values.astype("S") if values.dtype.kind == "U" else values)
    path.write_bytes(image.getbuffer())


FORMATS: dict[str, Callable[[dict[str, np.ndarray[Any, Any]], Path], None]] = {
    "parquet": _parquet,
    "npz": _npz,
    "mat": _mat,
    "h5": _h5,
}
