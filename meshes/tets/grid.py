"""A tetrahedral mesh as pyvista and ParaView have it, with its parts."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.errors import InputError
from meshes.base.whole_file import whole_file
from meshes.tets.tetrahedra import TetMesh

if TYPE_CHECKING:
    import pyvista

__all__ = ["grid_of", "write_organ"]

_TETRA = 10


def grid_of(mesh: TetMesh) -> "pyvista.UnstructuredGrid":
    """A mesh in pyvista [mm], with ``part`` over its cells, which counts into the field ``part_names``."""
    import pyvista
    from vtkmodules.vtkCommonCore import vtkStringArray

    cells = np.insert(mesh.cells, 0, 4, axis=1).ravel()
    grid = pyvista.UnstructuredGrid(cells, np.full(len(mesh.cells), _TETRA, dtype=np.uint8), 1e3 * mesh.nodes_m)
    grid.cell_data["part"] = mesh.part
    names = vtkStringArray()  # pyvista's own takes ASCII alone
    names.SetName("part_names")
    for name in mesh.part_names:
        names.InsertNextValue(name)
    grid.GetFieldData().AddArray(names)
    return grid


def write_organ(mesh: TetMesh, path: str | Path) -> None:
    """Write a mesh [mm] with its parts and their names, as ``anatomy.file`` of a scene and `read_tets` read it.

    Raises
    ------
    InputError
        If the file is not named ``.vtu``.
    """
    file = Path(path)
    if file.suffix != ".vtu":
        raise InputError(f"path must end in .vtu, got {file.name}: name it organ.vtu")
    with whole_file(file) as temporary:
        grid_of(mesh).save(temporary)
