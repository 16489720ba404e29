"""Files that a run writes for its bone: voxels, carved surface, and carving over time."""

import gzip
from dataclasses import replace
from math import ceil, sqrt
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Array, Bytes
from meshes.base.errors import InputError
from meshes.base.placement import Placement
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from meshes.voxels.volume import VoxelVolume
from tissue.models.tissue_model import TICK_S
from tissue.motion.replay import read_poses, write_poses
from tissue.simulation.bone_surface import (
    CarvedRun,
    CarvedSurface,
    block_means,
    bone_surface,
    changed_box,
    coarse_volume,
    depth_map,
    facing,
    with_depth,
    with_layers,
)
from tissue.simulation.run_folder import SavedRun, saved_placement
from tissue.simulation.saved_fields import require_whole
from tissue.simulation.vtk_files import (
    in_file,
    in_scene,
    write_collection,
    write_vtk,
    write_vtk_xml,
)

if TYPE_CHECKING:
    import pyvista

UNIT_NAMES = {1.0: "mm", 10.0: "cm", 1000.0: "m"}
"""Names of length units in NRRD, keyed by the length of the unit [mm]."""
MOST_FRAMES = 40
"""Largest number of frames in ``carving.pvd``, including the last frame.

This number and `MOST_TRIANGLES` limit the size of the files. Both values were chosen by judgement.
"""
MOST_TRIANGLES = 40_000
"""Largest number of triangles in a frame.

If a surface has more triangles, it is computed again from larger voxels.
"""
STEPS_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 25.0, 50.0, 100.0)
"""Possible intervals between two frames in ``carving.pvd`` [s]."""


def voxel_image(volume: VoxelVolume, remaining: Bytes) -> "pyvista.ImageData":
    """Return the voxels as a pyvista image with lengths in mm.

    The cell arrays are ``start`` and ``remaining`` (255 = full), ``layer`` and ``density_kg_m3``.

    Parameters
    ----------
    volume
        Bone before the first cut.
    remaining
        Bone left in each voxel (255 = full), one value for each voxel of `volume`.
    """
    import pyvista

    image = pyvista.ImageData(
        dimensions=np.array(volume.shape) + 1,
        spacing=(volume.spacing_m * 1e3,) * 3,
        origin=volume.origin_m * 1e3,
    )
    image.cell_data["start"] = volume.fraction.ravel(order="F")
    image.cell_data["remaining"] = remaining.ravel(order="F")
    image.cell_data["layer"] = volume.layer.ravel(order="F")
    image.cell_data["density_kg_m3"] = volume.density_kg_m3.ravel(order="F")
    image.field_data["layer_names"] = list(volume.layer_names)
    image.set_active_scalars("remaining", preference="cell")
    return image


def read_voxels(file: Path, placement: Placement | None = None) -> tuple[VoxelVolume, Bytes]:
    """Read the voxels from the file ``bone.vti`` of a run, and convert them to the scene's frame.

    The function returns the volume before the first cut, and the bone left in each voxel at the end
    of the run (255 = full).

    Raises
    ------
    InputError
        If the file was not written by a run.
    """
    import pyvista

    try:
        image = in_scene(pyvista.read(file), placement)
        shape = tuple(np.array(image.dimensions) - 1)
        start, left, layer, density = (
            np.ascontiguousarray(image.cell_data[name].reshape(shape, order="F"))
            for name in ("start", "remaining", "layer", "density_kg_m3")
        )
        names = tuple(str(name) for name in image.field_data["layer_names"])
    except (KeyError, ValueError, AttributeError, OSError):
        raise InputError(
            "bone.vti", "be a file that a run wrote", file, "run the scene again"
        ) from None
    origin_m = 1e-3 * np.array(image.origin)
    spacing_m = 1e-3 * float(image.spacing[0])
    return VoxelVolume(origin_m, spacing_m, start, layer, density, names, placement), left


def saved_voxels(
    saved: SavedRun,
) -> tuple[VoxelVolume, Bytes, Array | None]:
    """Read the voxels of a run and the poses of the tool during the run.

    The function returns the volume before the first cut, the bone left in each voxel at the end of
    the run (255 = full), and the tool poses. The tool poses are None if they were not saved.

    Raises
    ------
    InputError
        If the folder holds no voxels, or a file is damaged.
    """
    file = saved.path / "bone.vti"
    poses = saved.path / "carving" / "poses.npz"
    if not file.is_file():
        raise InputError(
            "run",
            "have voxels",
            f"{saved.path} without bone.vti",
            "use the trace and the fields of this run",
        )
    require_whole(saved)
    volume, left = read_voxels(file, saved_placement(saved.path))
    if not poses.is_file():
        return volume, left, None
    cut, origin_m, spacing_m = read_poses(poses)
    # The image file rounds origin and spacing. The exact result of the carving depends on their
    # last bits.
    return replace(volume, origin_m=origin_m, spacing_m=spacing_m), left, cut


def carved_surface(run: CarvedRun) -> "pyvista.PolyData":
    """Return the surface of the bone after the run [mm].

    The surface has the point array ``removed_depth_mm``, the cell array ``layer``, and normals.
    """
    depth = depth_map(run)
    surface = with_layers(bone_surface(run.volume, run.remaining), run.volume)
    return with_depth(surface, run.volume, run.remaining, depth_mm=depth.depth_mm, axis=depth.axis)


def write_bone(run: CarvedRun, out: Path) -> None:
    """Write the bone of a finished run into the folder `out`.

    ``bone.vti`` (for ParaView) holds the voxels in mm, with the cell arrays ``remaining`` and
    ``start`` (uint8, 255 = full), ``layer`` (uint8, an index into the field ``layer_names``) and
    ``density_kg_m3`` (uint16). ``bone.nrrd`` holds ``remaining`` for 3D Slicer, which does not read
    .vti files. ``bone.stl`` and ``bone.vtp`` hold the carved surface in mm; ``bone.vtp`` also has
    the arrays ``removed_depth_mm`` and ``layer``. If the run removed all of the bone, ``bone.stl``
    is not written.

    Bone that was read from a file is written in the frame and unit of that file, so the input file
    and the results can be shown together.
    """
    if run.parts.volume is None:
        return
    from vtkmodules.vtkIOGeometry import vtkSTLWriter

    image = voxel_image(run.volume, run.remaining)
    placement = run.parts.placement
    write_vtk_xml(in_file(image, placement), out / "bone.vti")
    _write_nrrd(run, out / "bone.nrrd")
    surface = in_file(carved_surface(run), placement)
    write_vtk_xml(surface, out / "bone.vtp")
    if surface.n_cells:
        writer = vtkSTLWriter()
        writer.SetFileTypeToBinary()
        writer.SetHeader(
            "tissue: carved bone in mm"
            if placement is None
            else "tissue: carved bone in its file's frame"
        )
        write_vtk(writer, surface, out / "bone.stl")


def _write_nrrd(run: CarvedRun, path: Path) -> None:
    """Write the bone left in each voxel (255 = full) as a compressed NRRD image.

    The axes are LPS (left, posterior, superior), which 3D Slicer also uses for surface files.
    """
    volume = run.volume
    placement = run.parts.placement
    directions = volume.spacing_m * 1e3 * np.eye(3)
    origin = (volume.origin_m + 0.5 * volume.spacing_m) * 1e3
    units = []
    if placement is not None:
        directions = directions @ placement.rotation.T / placement.unit_mm
        origin = placement.to_file(origin[None])[0]
        name = UNIT_NAMES.get(placement.unit_mm)
        units = [f'space units: "{name}" "{name}" "{name}"'] if name else []
    header = "\n".join(
        [
            "NRRD0004",
            "type: uint8",
            "dimension: 3",
            "space: left-posterior-superior",
            f"sizes: {' '.join(map(str, volume.shape))}",
            "space directions: "
            + " ".join(f"({','.join(repr(float(v)) for v in row)})" for row in directions),
            *units,
            "kinds: domain domain domain",
            "encoding: gzip",
            f"space origin: ({','.join(repr(float(v)) for v in origin)})",
        ]
    )
    # Level 1 takes a quarter of the time of level 6, for a file that is 1.3 times as large. No time
    # is written, so that equal bone gives equal files.
    data = gzip.compress(run.remaining.tobytes(order="F"), compresslevel=1, mtime=0)
    with whole_file(path) as temporary:
        temporary.write_bytes(header.encode("ascii") + b"\n\n" + data)


def carving_ticks(run: CarvedRun) -> list[int]:
    """Return the ticks for which the bone is written to ``carving.pvd``.

    If the run saves fields, such as displacement, the result contains ticks at which fields are
    saved. Otherwise, the ticks have equal intervals. The last tick is always included.
    """
    last = len(run.trace.rows) - 1
    fields = run.parts.fields
    if fields is not None and len(fields.frames) > 1:
        times = [frame.time_s for frame in fields.frames]
        times = times[:: ceil(len(times) / (MOST_FRAMES - 1))]
    else:
        lasts = last * TICK_S
        step = next(
            (step for step in STEPS_S if lasts <= step * (MOST_FRAMES - 2)),
            # Two times are added: the start and the end.
            lasts / (MOST_FRAMES - 2),
        )
        times = np.arange(0.0, lasts, step).tolist()
    ticks = {round(time / TICK_S) for time in times}
    return sorted({tick for tick in ticks if tick < last} | {last})


def write_carving(run: CarvedRun, out: Path, *, report: Progress = silent) -> None:
    """Write the surface of the bone over time, for ParaView.

    If the run cut no bone, no file is written.

    ``carving.pvd`` lists two surfaces for each time [s]. The part of the surface that changes
    during the run is in ``carving/frame_0000.vtp`` and so on. The rest of the surface is in
    ``carving/rest.vtp``. If the anatomy was read from a file, both surfaces are in the frame and
    unit of that file, otherwise in mm. Both have the arrays ``layer`` and ``removed_depth_mm``. If
    the changing part has more than `MOST_TRIANGLES` triangles, both surfaces are computed from
    larger voxels. ``carving/poses.npz`` holds the tool poses, from which the bone at any other tick
    can be computed.
    """
    box = None if run.poses is None else changed_box(run.volume.fraction, run.remaining)
    if run.poses is None or box is None:
        return
    folder = out / "carving"
    folder.mkdir(parents=True, exist_ok=True)
    write_poses(folder / "poses.npz", run.poses, run.volume)
    axis, _ = facing(run.trace)
    triangles = CarvedSurface(run.volume, box, axis=axis)
    count = triangles.of(run.remaining[triangles.part]).n_cells
    block = ceil(sqrt(max(count / MOST_TRIANGLES, 1.0)))
    low, high = box
    carved = CarvedSurface(
        coarse_volume(run.volume, block), (low // block, -(-high // block)), axis=axis
    )
    fine = tuple(slice(block * one.start, block * one.stop) for one in carved.part)
    placement = run.parts.placement
    _write(carved.rest(), folder / "rest.vtp", placement)
    replay = run.replay()
    ticks = carving_ticks(run)
    seen: Bytes | None = None
    name = ""
    entries = list[tuple[float, int, str]]()
    for index, tick in enumerate(ticks):
        report("writing the carving", index / len(ticks))
        left = block_means(replay.at(tick)[fine], block)
        if seen is None or not np.array_equal(left, seen):
            seen = left.copy()
            name = f"carving/frame_{index:04d}.vtp"
            _write(carved.of(left), out / name, placement)
        time_s = float(run.trace["time_s"][tick])
        entries += [(time_s, 0, name), (time_s, 1, "carving/rest.vtp")]
    write_collection(entries, out / "carving.pvd")


def _write(surface: "pyvista.PolyData", path: Path, placement: Placement | None) -> None:
    if "Normals" in surface.point_data:  # a third of the file, and ParaView makes them
        del surface.point_data["Normals"]
    write_vtk_xml(in_file(surface, placement), path)
