"""Columns of MATLAB files up to version 7; run by `meshes.base.isolated_parser`, which bounds time and memory.

A few bytes of such a file can state any number of cells, which SciPy allocates before it looks for them.
"""

from pathlib import Path

import numpy as np

from meshes.base.errors import DamagedFileError
from meshes.base.isolated_parser import Answer

__all__ = ["mat_columns"]


def mat_columns(file: Path) -> Answer:
    """Return the numeric arrays of a MATLAB file by name, those of structs by the names of their fields.

    What holds no numbers is returned as an empty matrix, so that its name is known.
    """
    from scipy.io import loadmat

    columns = {}
    for name, value in loadmat(file, squeeze_me=True).items():
        if name.startswith("__"):
            continue
        fields = getattr(getattr(value, "dtype", None), "names", None)
        held = {inner: value[inner].item() for inner in fields} if fields and value.ndim == 0 else {name: value}
        for inner, each in held.items():
            if inner in columns:
                raise DamagedFileError(f"two columns of the name {inner}")
            array = np.asarray(each)
            columns[inner] = array if array.dtype.kind in "fiu" else np.zeros((0, 0))
    return {}, columns
