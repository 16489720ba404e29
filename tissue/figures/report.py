"""What a run leaves behind to look at: the bone as files, and pictures."""

import gzip
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.whole_file import whole_file
from tissue.simulation.bone_surface import bone_surface, with_depth, with_layers
from tissue.simulation.depth_map import depth_map
from tissue.simulation.file_frame import image_in_file, mesh_in_file
from tissue.simulation.run import Run
from tissue.simulation.vtk_files import write_vtk, write_vtk_xml
from tissue.system.offscreen import end_drawing

if TYPE_CHECKING:
    import pyvista

__all__ = ["carved_surface", "draw_pictures", "write_bone"]

UNIT_NAMES = {1.0: "mm", 10.0: "cm", 1000.0: "m"}
"""Units of a file by their length [mm], as NRRD names them."""


def carved_surface(run: Run) -> "pyvista.PolyData":
    """Surface of the bone after the run [mm]: point array ``removed_depth_mm``, cell array ``layer``, normals."""
    depth = depth_map(run)
    surface = with_layers(bone_surface(run.volume, run.remaining), run.volume)
    return with_depth(surface, run.volume, run.remaining, depth_mm=depth.depth_mm, axis=depth.axis)


def write_bone(run: Run, out: Path) -> None:
    """Write the bone of a finished run.

    ``bone.vti`` holds the voxels in mm with the cell arrays ``remaining`` and ``start`` (uint8, 255 = full), ``layer``
    (uint8, an index into the field ``layer_names``) and ``density_kg_m3`` (uint16); ParaView opens it. ``bone.nrrd``
    holds ``remaining`` for 3D Slicer, which reads no .vti. ``bone.stl`` and ``bone.vtp`` hold the carved surface in mm,
    the latter with ``removed_depth_mm`` and ``layer``. A bone that was cut away altogether has no ``bone.stl``.

    Bone from a file is written in the frame and unit of that file, so that it overlays it.
    """
    if run.parts.volume is None:
        return
    from vtkmodules.vtkIOGeometry import vtkSTLWriter
    from vtkmodules.vtkIOXML import vtkXMLImageDataWriter, vtkXMLPolyDataWriter

    image = run.dataset()
    image.set_active_scalars("remaining", preference="cell")
    placement = run.parts.placement
    write_vtk_xml(vtkXMLImageDataWriter(), image_in_file(image, placement), out / "bone.vti")
    _write_nrrd(run, out / "bone.nrrd")
    surface = mesh_in_file(carved_surface(run), placement)
    write_vtk_xml(vtkXMLPolyDataWriter(), surface, out / "bone.vtp")
    if surface.n_cells:
        writer = vtkSTLWriter()
        writer.SetFileTypeToBinary()
        writer.SetHeader(
            "tissue: carved bone in mm" if placement is None else "tissue: carved bone in its file's frame"
        )
        write_vtk(writer, surface, out / "bone.stl")


def draw_pictures(run: Run, folder: Path) -> list[str]:
    """Draw ``bone_before_after.png``, ``removed_depth.png`` and ``force_torque.png``.

    A soft organ has ``press.png`` and ``held.png`` in place of the first two, a needle ``insertion.png`` as well and a
    wall ``wall.png``. Of a tissue of several layers that tells more of itself than its volumes, a tooth for one, also
    ``section.png`` and ``force_depth.png``; of a run by a hand on a device ``played.png``.

    Returns
    -------
    A sentence for every picture that could not be drawn.
    """
    from tissue.figures.before_after import draw_before_after
    from tissue.figures.force_depth import draw_force_depth
    from tissue.figures.held import draw_held
    from tissue.figures.insertion import draw_insertion
    from tissue.figures.played import draw_played
    from tissue.figures.press import draw_press
    from tissue.figures.section import draw_section
    from tissue.figures.style import draw_force_torque, draw_removed_depth
    from tissue.figures.tool_mesh import tool_surface
    from tissue.figures.wall import draw_wall

    folder.mkdir(parents=True, exist_ok=True)
    notes: dict[str, str | None] = {}
    if run.scene.device != "none":
        draw_played(run, folder / "played.png")
    if run.parts.volume is None:
        with _beside() as beside:
            if (fields := run.parts.tissue.fields) and fields.frames:
                tool, name = tool_surface(run.scene.tool), run.scene.name
                held = beside.submit(draw_held, fields, folder / "held.png", title=name)
                notes["press.png"] = draw_press(fields, run.trace, folder / "press.png", title=name, tool=tool)
                notes["held.png"] = held.result()
            draw_force_torque(run, folder / "force_torque.png")
            if run.scene.tool.kind == "needle":
                draw_insertion(run, folder / "insertion.png")
            if run.scene.anatomy.kind == "wall":
                draw_wall(run, folder / "wall.png")
        return _told(notes)
    depth = depth_map(run)
    with _beside() as beside:
        render = beside.submit(draw_before_after, run, depth, folder / "bone_before_after.png")
        draw_removed_depth(run, depth, folder / "removed_depth.png")
        draw_force_torque(run, folder / "force_torque.png")
        tells = len(run.parts.tissue.layer_names) > 1 and run.parts.tissue.measure_names
        if tells and run.cutter.spin_rad_s != 0.0:
            side = {"axis": depth.axis, "outward": depth.outward}
            draw_section(run, folder / "section.png", **side)
            notes["force_depth.png"] = draw_force_depth(run, folder / "force_depth.png", **side)
        notes["bone_before_after.png"] = render.result()
    return _told(notes)


@contextmanager
def _beside() -> Iterator[ThreadPoolExecutor]:
    """A thread that draws in 3D; what ends the block before its end, such as Ctrl-C, does not wait for it."""
    with ThreadPoolExecutor(1) as thread:
        try:
            yield thread
        except BaseException:
            end_drawing()
            raise


def _told(notes: dict[str, str | None]) -> list[str]:
    """A sentence for every picture that could not be drawn."""
    return [f"{name} was not drawn: {note}" for name, note in notes.items() if note is not None]


def _write_nrrd(run: Run, path: Path) -> None:
    """Write ``remaining`` as a compressed NRRD image; its axes are those of the surface files in 3D Slicer (LPS)."""
    volume, placement = run.volume, run.parts.placement
    directions, origin = volume.spacing_m * 1e3 * np.eye(3), (volume.origin_m + 0.5 * volume.spacing_m) * 1e3
    units = []
    if placement is not None:
        directions, origin = directions @ placement.rotation.T / placement.unit_mm, placement.to_file(origin[None])[0]
        name = UNIT_NAMES.get(placement.unit_mm)
        units = [f'space units: "{name}" "{name}" "{name}"'] if name else []
    header = "\n".join(
        [
            "NRRD0004",
            "type: uint8",
            "dimension: 3",
            "space: left-posterior-superior",
            f"sizes: {' '.join(map(str, volume.shape))}",
            "space directions: " + " ".join(f"({','.join(repr(float(v)) for v in row)})" for row in directions),
            *units,
            "kinds: domain domain domain",
            "encoding: gzip",
            f"space origin: ({','.join(repr(float(v)) for v in origin)})",
        ]
    )
    data = gzip.compress(run.remaining.tobytes(order="F"), compresslevel=1, mtime=0)
    with whole_file(path) as beside:
        beside.write_bytes(header.encode("ascii") + b"\n\n" + data)
