"""VTK files of a run: frames of scene and anatomy file, writers, and fields over time.

Coordinates take the file's unit; quantities with a unit in their name keep it. Point arrays of
three numbers are vectors and are rotated. Cell arrays are not (principal stresses are three
numbers, but no vector). A full disk raises an error when files are written.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from meshes.base.arrays import Array
from meshes.base.placement import Placement
from meshes.base.whole_file import whole_file
from tissue.fem.fields import FieldSeries, Frame

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkIOGeometry import vtkSTLWriter
    from vtkmodules.vtkIOXML import vtkXMLWriter

__all__ = [
    "frame_mesh",
    "image_in_file",
    "image_in_scene",
    "mesh_in_file",
    "mesh_in_scene",
    "write_collection",
    "write_fields",
    "write_vtk",
    "write_vtk_xml",
]

Mesh = TypeVar("Mesh", bound="pyvista.PointSet")
CELL_TYPES = {4: 10, 8: 12}
"""VTK's number of a cell type, tetrahedron or hexahedron, by its count of nodes."""


def mesh_in_file(mesh: Mesh, placement: Placement | None) -> Mesh:
    """Return a mesh of the scene [mm] in the file's frame and unit; unchanged without a file."""
    if placement is None:
        return mesh
    return _moved(mesh, placement.to_file(_points(mesh)), placement.rotation.T)


def mesh_in_scene(mesh: Any, placement: Placement | None) -> Any:
    """Return a mesh of the file in the scene's frame [mm]; unchanged without a file."""
    if placement is None:
        return mesh
    return _moved(mesh, placement.to_scene(_points(mesh)), placement.rotation)


def image_in_file(image: Any, placement: Placement | None) -> "pyvista.ImageData":
    """Return voxels of the scene [mm] in the file's frame and unit, with a direction matrix.

    They are unchanged without a file.
    """
    if placement is None:
        return image
    origin = placement.to_file(np.array([image.origin]))[0]
    spacing = [size / placement.unit_mm for size in image.spacing]
    return _placed(image, origin, spacing, placement.rotation)


def image_in_scene(image: Any, placement: Placement | None) -> "pyvista.ImageData":
    """Return voxels of the file in the scene's frame [mm]; unchanged without a file."""
    if placement is None:
        return image
    origin = placement.to_scene(np.array([image.origin]))[0]
    spacing = [size * placement.unit_mm for size in image.spacing]
    return _placed(image, origin, spacing, placement.rotation.T @ np.array(image.direction_matrix))


def _placed(image: Any, origin: Array, spacing: list[float], turn: Array) -> Any:
    """Return a shallow copy of an image at another place."""
    moved = image.copy(deep=False)
    moved.origin = origin.tolist()
    moved.spacing = spacing
    moved.direction_matrix = turn
    return moved


def write_vtk_xml(writer: "vtkXMLWriter", data: "pyvista.DataSet", path: Path) -> None:
    """Write a VTK XML file with compressed raw data."""
    writer.SetCompressorTypeToZLib()
    # Level 1 takes a quarter of the time of level 6 for a file 1.3 times as large. VTK compresses
    # block by block: 1 MiB leaves few blocks.
    writer.SetCompressionLevel(1)
    writer.SetBlockSize(1 << 20)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    write_vtk(writer, data, path)


def write_vtk(writer: "vtkXMLWriter | vtkSTLWriter", data: "pyvista.DataSet", path: Path) -> None:
    """Write a file with a VTK writer, and raise an error where it fails silently."""
    from vtkmodules.vtkCommonCore import vtkCommand, vtkObject

    with whole_file(path) as temporary:
        temporary.open("wb").close()
        writer.SetFileName(str(temporary))
        writer.SetInputData(data)
        failures: list[int] = []
        writer.AddObserver(vtkCommand.ErrorEvent, lambda *_: failures.append(writer.GetErrorCode()))
        shown = vtkObject.GetGlobalWarningDisplay()
        # otherwise VTK would also print the error that is raised below
        vtkObject.SetGlobalWarningDisplay(0)
        try:
            written = writer.Write()
        finally:
            vtkObject.SetGlobalWarningDisplay(shown)
        if not written or failures:
            import errno
            import os

            # VTK reports a full disk by its own error code. Once the file was opened, a full disk
            # is the only cause left.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def write_collection(entries: Iterable[tuple[float, int, str]], path: Path) -> None:
    """Write a .pvd file for ParaView: time [s], part and file of each mesh."""
    lines = [
        f'    <DataSet timestep="{time!r}" part="{part}" file="{file}"/>\n'
        for time, part, file in entries
    ]
    with whole_file(path) as temporary:
        temporary.write_text(
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" '
            'byte_order="LittleEndian">\n'
            "  <Collection>\n" + "".join(lines) + "  </Collection>\n</VTKFile>\n",
            "utf-8",
        )


def _points(mesh: "pyvista.PointSet") -> Array:
    return np.asarray(mesh.points, dtype=np.float64)


def _moved(mesh: Mesh, points: Array, turn: Array) -> Mesh:
    """Return a copy of a mesh at other points, with its vectors rotated (rows times `turn`)."""
    import pyvista

    moved = mesh.copy(deep=False)
    single = np.ascontiguousarray(points, dtype=np.float32)
    moved.SetPoints(pyvista.vtk_points(single))  # type: ignore[arg-type]  # moved.points = would change the original
    for name, values in mesh.point_data.items():
        if values.ndim == 2 and values.shape[1] == 3:
            moved.point_data[name] = (np.asarray(values, dtype=np.float64) @ turn).astype(
                values.dtype
            )
    return moved


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
    nodes = (1e3 * series.nodes_m[used]).astype(np.float32)
    mesh = pyvista.UnstructuredGrid({CELL_TYPES[corners]: cells.reshape(-1, corners)}, nodes)
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
