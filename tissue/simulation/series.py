"""Files of fields over time for ParaView."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.placement import Placement
from tissue.fem.fields import FieldSeries, Frame
from tissue.simulation.vtk_files import mesh_in_file, write_collection, write_vtk_xml

if TYPE_CHECKING:
    import pyvista

__all__ = ["frame_mesh", "write_fields"]

CELL_TYPES = {4: 10, 8: 12}
"""VTK's number of a cell type, tetrahedron or hexahedron, by its count of nodes."""


def frame_mesh(series: FieldSeries, frame: Frame) -> "pyvista.UnstructuredGrid":
    """Return the mesh of one frame [mm], without removed cells and unused nodes.

    The cell array ``layer`` is an index into the field ``layer_names``. The other arrays have the
    names of the frame's fields.
    """
    import pyvista

    there = np.ones(len(series.cells), dtype=bool)
    for values in frame.cells.values():
        there &= np.isfinite(values.reshape(len(values), -1)).all(axis=1)
    corners = series.cells.shape[1]
    used, cells = np.unique(series.cells[there], return_inverse=True)
    cells = np.insert(cells.reshape(-1, corners), 0, corners, axis=1)
    mesh = pyvista.UnstructuredGrid(
        cells.ravel(),
        np.full(len(cells), CELL_TYPES[corners], dtype=np.uint8),
        (1e3 * series.nodes_m[used]).astype(np.float32),
    )
    mesh.field_data["layer_names"] = list(series.layer_names)
    if not there.any():
        return mesh
    for name, values in frame.points.items():
        mesh.point_data[name] = values[used]
    for name, values in frame.cells.items():
        mesh.cell_data[name] = values[there]
    mesh.cell_data["layer"] = series.layer[there]
    return mesh


def write_fields(series: FieldSeries, folder: Path, placement: Placement | None = None) -> None:
    """Write ``fields.pvd`` with times in seconds, and a mesh for each frame.

    The meshes are ``fields/frame_0000.vtu`` and so on.

    With a placement the meshes have the frame and unit of the anatomy's file.
    """
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridWriter

    (folder / "fields").mkdir(parents=True, exist_ok=True)
    entries = []
    for index, frame in enumerate(series.frames):
        name = f"fields/frame_{index:04d}.vtu"
        mesh = mesh_in_file(frame_mesh(series, frame), placement)
        write_vtk_xml(vtkXMLUnstructuredGridWriter(), mesh, folder / name)
        entries.append((float(frame.time_s), 0, name))
    write_collection(entries, folder / "fields.pvd")
