"""VTK files, written so that a full disk is an error."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from meshes.base.whole_file import whole_file

if TYPE_CHECKING:
    import pyvista
    from vtkmodules.vtkIOGeometry import vtkSTLWriter
    from vtkmodules.vtkIOXML import vtkXMLWriter

__all__ = ["write_collection", "write_vtk", "write_vtk_xml"]


def write_vtk_xml(writer: "vtkXMLWriter", data: "pyvista.DataSet", path: Path) -> None:
    """Write a VTK XML file with compressed raw data."""
    writer.SetCompressorTypeToZLib()
    writer.SetCompressionLevel(1)
    writer.SetBlockSize(1 << 20)
    writer.SetDataModeToAppended()
    writer.EncodeAppendedDataOff()
    write_vtk(writer, data, path)


def write_vtk(writer: "vtkXMLWriter | vtkSTLWriter", data: "pyvista.DataSet", path: Path) -> None:
    """Let a VTK writer write, and turn its silent failure into the system's error."""
    from vtkmodules.vtkCommonCore import vtkCommand, vtkObject

    with whole_file(path) as temporary:
        temporary.open("wb").close()
        writer.SetFileName(str(temporary))
        writer.SetInputData(data)
        failures: list[int] = []
        writer.AddObserver(vtkCommand.ErrorEvent, lambda *_: failures.append(writer.GetErrorCode()))
        shown = vtkObject.GetGlobalWarningDisplay()
        vtkObject.SetGlobalWarningDisplay(0)  # VTK would print its own account of what is raised below
        try:
            written = writer.Write()
        finally:
            vtkObject.SetGlobalWarningDisplay(shown)
        if not written or failures:
            import errno
            import os

            # VTK reports a full disk as an error of its own; it is the only one left once the file could be opened.
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


def write_collection(entries: Iterable[tuple[float, int, str]], path: Path) -> None:
    """Write a .pvd file, which ParaView plays: time [s], part and file of each mesh."""
    lines = [f'    <DataSet timestep="{time!r}" part="{part}" file="{file}"/>\n' for time, part, file in entries]
    with whole_file(path) as temporary:
        temporary.write_text(
            '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">\n'
            "  <Collection>\n" + "".join(lines) + "  </Collection>\n</VTKFile>\n",
            "utf-8",
        )
