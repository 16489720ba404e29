"""Reading of VTK files in a separate process: surfaces, tetrahedral meshes and saved results.

`meshes.base.isolated_parser` starts this process, because a damaged file can crash VTK. VTK's
readers print errors to VTK's output window and continue with incomplete arrays, so every printed
error counts as a failure. Cells are checked before any filter runs. The check is needed, because a
filter would read memory outside the point array if a cell refers to a missing point.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import DamagedFileError, InputError
from meshes.base.isolated_parser import Answer

_CORNERS = {
    1: 1,
    3: 2,
    5: 3,
    8: 4,
    9: 4,
    10: 4,
    11: 8,
    12: 8,
    13: 6,
    14: 5,
    21: 3,
    22: 6,
    23: 8,
    24: 10,
    25: 20,
    26: 15,
}
"""Number of points of a cell by VTK cell type, for types with a fixed number of points."""
_HEADING = re.compile(
    r"^(ERROR|Warning|Generic Warning): In .*$|^\w+ \(0x[0-9a-f]+\): ", re.MULTILINE
)


def read_vtk(file: Path) -> Any:
    """Read a dataset with pyvista and check its cells.

    Raises
    ------
    DamagedFileError
        If the reader printed an error, or if the arrays of cells and offsets are inconsistent. The
        message contains the first printed error.
    InputError
        If a cell refers to a point that does not exist.
    """
    import pyvista
    from vtkmodules.vtkCommonCore import vtkOutputWindow, vtkStringOutputWindow

    window = vtkStringOutputWindow()
    vtkOutputWindow.SetInstance(window)
    data: Any = pyvista.read(file)
    output = window.GetOutput() or ""
    if "error" in output.lower():
        raise DamagedFileError(
            next(
                (line for line in _HEADING.sub("", output).splitlines() if line.strip()),
                "it is incomplete",
            )
        )
    for block in data if isinstance(data, pyvista.MultiBlock) else [data]:
        if isinstance(block, pyvista.PolyData):
            for cells in (block.GetVerts(), block.GetLines(), block.GetPolys(), block.GetStrips()):
                _require_cells(cells, file, block.n_points)
        elif isinstance(block, pyvista.UnstructuredGrid):
            _require_cells(block.GetCells(), file, block.n_points, np.asarray(block.celltypes))
    return data


def check_vtk(folder: Path, arrays_by_file: dict[str, list[str]]) -> Answer:
    """Read the listed files of a folder, and raise an error if one is damaged or incomplete.

    A file is incomplete if one of its required arrays is missing.

    If ``layer`` is a required array, its values must be indices into the field ``layer_names``. The
    content of the files is not returned.
    """
    for name, wanted in arrays_by_file.items():
        try:
            data = read_vtk(folder / name)
        except (InputError, DamagedFileError) as problem:
            raise DamagedFileError(f"{name} is damaged: {problem}") from None
        # pyvista raises these errors for a dataset of which VTK has read only a part.
        except (AttributeError, OSError, RuntimeError, TypeError, ValueError):
            raise DamagedFileError(f"{name} is damaged or cut off") from None
        missing = [each for each in wanted if each not in data.cell_data and data.n_cells]
        if missing:
            raise DamagedFileError(f"{name} has no cell array {missing[0]}")
        if "layer" in wanted and data.n_cells:
            layers = np.asarray(data.cell_data["layer"])
            names = data.field_data.get("layer_names", ())
            if layers.dtype.kind not in "iu" or layers.min() < 0 or layers.max() >= len(names):
                raise DamagedFileError(f"{name} has layers without a name")
    return {}, {}


def vtk_triangles(file: Path) -> Answer:
    """Return the arrays of the surface that a VTK file contains.

    The arrays are ``points``, shape (n, 3), and ``triangles``, shape (m, 3).
    """
    return {}, outer_triangles(read_vtk(file))


def outer_triangles(data: Any) -> dict[str, NDArray[np.number]]:
    """Return the arrays ``points`` and ``triangles`` of the surface of a dataset."""
    import pyvista

    if not isinstance(data, pyvista.PolyData):
        # For cells with a volume, only the outer faces enclose the solid.
        data = data.extract_surface(algorithm="dataset_surface")
    surface = data.triangulate()
    return {
        "points": np.asarray(surface.points),
        "triangles": np.asarray(surface.faces).reshape(-1, 4)[:, 1:].astype(np.int64),
    }


def _require_cells(
    cells: Any, file: Path, point_count: int, kinds: NDArray[np.integer] | None = None
) -> None:
    """Raise an error for cells that refer to points which do not exist.

    Also raise an error for cells whose number of points does not match the cell type.
    """
    from vtkmodules.util.numpy_support import vtk_to_numpy

    offsets = vtk_to_numpy(cells.GetOffsetsArray()).astype(np.int64)
    points = vtk_to_numpy(cells.GetConnectivityArray()).astype(np.int64)
    sizes = np.diff(offsets)
    if len(offsets) and (offsets[0] != 0 or offsets[-1] != len(points) or (sizes < 0).any()):
        raise DamagedFileError("its cells do not match their offsets")
    if kinds is not None:
        if len(kinds) != len(sizes):
            raise DamagedFileError(f"it has {len(kinds)} cell types for {len(sizes)} cells")
        # A cell type is one byte. Types without a fixed number of points, such as polygons, are not
        # checked.
        expected = np.array([_CORNERS.get(kind, -1) for kind in range(256)])[kinds]
        short = np.flatnonzero((expected >= 0) & (sizes != expected))
        if len(short):
            k = short[0]
            raise InputError(
                f"cells of VTK type {kinds[k]}",
                f"have {expected[k]} points",
                f"{sizes[k]} in cell {k} of {file.name}, counted from 0",
                "export it again",
            )
    wrong = np.flatnonzero((points < 0) | (points >= point_count))
    if len(wrong):
        cell = int(np.searchsorted(offsets, wrong[0], side="right")) - 1
        raise InputError(
            "cells",
            f"refer to the points 0 to {point_count - 1} of the file",
            f"point {points[wrong[0]]} in cell {cell} of {file.name}, counted from 0",
            "export it again",
        )
