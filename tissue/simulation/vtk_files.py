"""VTK files of a run: writing, reading, and conversion to the frame of the anatomy's file.

Coordinates are converted to the frame and unit of the file from which the anatomy was read.
Quantities whose name contains a unit are not converted. Point arrays of three numbers are vectors
and are rotated. Cell arrays are not rotated, because the three numbers of a cell may be principal
stresses, which are not a vector. The functions that write files raise an error if the disk is full.
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.placement import Placement
from meshes.base.whole_file import whole_file
from tissue.fem.fields import FieldSeries, Frame

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkIOGeometry import vtkSTLWriter
    from vtkmodules.vtkIOXML import vtkXMLWriter

Data = TypeVar("Data", bound="pyvista.DataSet")
CELL_TYPES = {4: 10, 8: 12}
"""VTK cell types of tetrahedron and hexahedron, keyed by the number of nodes of a cell."""


def in_file(data: Data, placement: Placement | None) -> Data:
    """Convert a mesh or voxels of the scene [mm] to the frame and unit of the anatomy's file.

    The axes of voxels are stored as the direction matrix of the image. Without a placement, the
    data are returned unchanged.
    """
    if placement is None:
        return data
    return _moved(data, placement.to_file, 1.0 / placement.unit_mm, placement.rotation)


def in_scene(data: Data, placement: Placement | None) -> Data:
    """Convert a mesh or voxels in the frame of the anatomy's file to the frame of the scene [mm].

    Without a placement, the data are returned unchanged.
    """
    if placement is None:
        return data
    return _moved(data, placement.to_scene, placement.unit_mm, placement.rotation.T)


def _moved(data: Data, to_other: Callable[[Array], Array], scale: float, turn: Array) -> Data:
    """Return a copy of a mesh or of voxels in another frame.

    Parameters
    ----------
    data
        Mesh or voxels.
    to_other
        Function that converts points, shape (n, 3), to the other frame.
    scale
        Factor by which lengths are multiplied.
    turn
        Rotation matrix by which vectors are multiplied.
    """
    import pyvista

    moved: Any = data.copy(deep=False)
    if isinstance(data, pyvista.ImageData):
        moved.origin = to_other(np.array([data.origin]))[0].tolist()
        moved.spacing = [size * scale for size in data.spacing]
        moved.direction_matrix = turn @ np.array(data.direction_matrix)
        return moved
    points = to_other(np.asarray(data.points, dtype=np.float64))
    single = np.ascontiguousarray(points, dtype=np.float32)
    # An assignment to moved.points would change the original.
    moved.SetPoints(pyvista.vtk_points(single))  # type: ignore[arg-type]
    for name, values in data.point_data.items():
        if values.ndim == 2 and values.shape[1] == 3:
            turned = np.asarray(values, dtype=np.float64) @ turn.T
            moved.point_data[name] = turned.astype(values.dtype)
    return moved


def write_vtk_xml(data: "pyvista.DataSet", path: Path) -> None:
    """Write a VTK XML file with compressed raw data."""
    from vtkmodules.vtkIOXML import vtkXMLDataSetWriter

    writer = vtkXMLDataSetWriter()
    writer.SetCompressorTypeToZLib()
    # Level 1 takes a quarter of the time of level 6, for a file that is 1.3 times as large. VTK
    # compresses block by block; with blocks of 1 MiB there are few blocks.
    writer.SetCompressionLevel(1)
    writer.SetBlockSize(1 << 20)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    write_vtk(writer, data, path)


def write_vtk(writer: "vtkXMLWriter | vtkSTLWriter", data: "pyvista.DataSet", path: Path) -> None:
    """Write a file with a VTK writer, and raise an error if the writer fails silently."""
    from vtkmodules.vtkCommonCore import vtkCommand, vtkObject

    with whole_file(path) as temporary:
        temporary.open("wb").close()
        writer.SetFileName(str(temporary))
        writer.SetInputData(data)
        failures: list[int] = []
        writer.AddObserver(vtkCommand.ErrorEvent, lambda *_: failures.append(writer.GetErrorCode()))
        shown = vtkObject.GetGlobalWarningDisplay()
        # Without this, VTK would also print the error that is raised below.
        vtkObject.SetGlobalWarningDisplay(0)
        try:
            written = writer.Write()
        finally:
            vtkObject.SetGlobalWarningDisplay(shown)
        if not written or failures:
            import errno
            import os

            # VTK has an error code of its own for a full disk. If the file could be opened, a full
            # disk is the only remaining cause.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def write_collection(entries: Iterable[tuple[float, int, str]], path: Path) -> None:
    """Write a .pvd file for ParaView from the time [s], part number and file of each mesh."""
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


def read_collection(index: Path) -> list[tuple[float, int, str]]:
    """Read the times [s], part numbers and files of meshes from a .pvd file that a run wrote.

    Raises
    ------
    InputError
        If the file cannot be read, its times or part numbers are not in order, or a listed file is
        missing or outside the folder.
    """
    from xml.etree import ElementTree

    require_regular(index)
    folder = index.parent.resolve()
    try:
        root = ElementTree.fromstring(index.read_bytes())
        entries = [
            (float(one.attrib["timestep"]), int(one.attrib.get("part", 0)), one.attrib["file"])
            for one in root.iter("DataSet")
        ]
        moments = [entry[:2] for entry in entries]
        files = [(folder / name).resolve() for *_, name in entries]
        are_there = all(file.is_relative_to(folder) and file.is_file() for file in files)
        if root.tag == "VTKFile" and moments == sorted({*moments}) and are_there:
            return entries
    except (ElementTree.ParseError, LookupError, ValueError):
        pass
    raise InputError(
        index.name, "be a ParaView collection with its files", index, "run the scene again"
    )


def frame_mesh(series: FieldSeries, frame: Frame) -> "pyvista.UnstructuredGrid":
    """Return the mesh at the time of one frame [mm], without removed cells and unused nodes.

    The cell array ``layer`` contains indices into the field ``layer_names``. The other arrays have
    the names of the fields of the frame.
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
    """Write ``fields.pvd`` with times in seconds, and one mesh for each frame.

    The files of the meshes are ``fields/frame_0000.vtu`` and so on.

    With a placement, the meshes are in the frame and unit of the anatomy's file.
    """
    (folder / "fields").mkdir(parents=True, exist_ok=True)
    entries = []
    for index, frame in enumerate(series.frames):
        name = f"fields/frame_{index:04d}.vtu"
        mesh = in_file(frame_mesh(series, frame), placement)
        write_vtk_xml(mesh, folder / name)
        entries.append((float(frame.time_s), 0, name))
    write_collection(entries, folder / "fields.pvd")
