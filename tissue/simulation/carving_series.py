"""Files of the carving over time for ParaView."""

from math import ceil, sqrt
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from meshes.base.placement import Placement
from meshes.base.progress import Progress, silent
from tissue.models.tissue_model import TICK_S
from tissue.motion.replay import write_poses
from tissue.simulation.carved_surface import CarvedSurface, block_means, changed_box, coarse_volume
from tissue.simulation.depth_map import facing
from tissue.simulation.vtk_files import mesh_in_file, write_collection, write_vtk_xml

if TYPE_CHECKING:
    import pyvista

    from tissue.simulation.run import Run

__all__ = ["carving_ticks", "write_carving"]

MOST_FRAMES = 40
"""Largest number of moments in a file of the carving, the end included."""
MOST_TRIANGLES = 40_000
"""Largest number of triangles of one moment; a larger cut is drawn in blocks of voxels."""
STEPS_S = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 25.0, 50.0, 100.0)
"""Possible intervals between two moments [s]."""


def carving_ticks(run: "Run") -> list[int]:
    """Return the ticks at the end of which the bone is written.

    They are the ticks of the fields, if there are any, and the last tick.
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
            lasts / (MOST_FRAMES - 2),
        )
        times = np.arange(0.0, lasts, step).tolist()
    ticks = {round(time / TICK_S) for time in times}
    return sorted({tick for tick in ticks if tick < last} | {last})


def write_carving(run: "Run", out: Path, *, report: Progress = silent) -> None:
    """Write the bone over time of a run that cut; a run that did not cut writes nothing.

    ``carving.pvd`` names two surfaces for each time [s]. The cut part is in
    ``carving/frame_0000.vtp`` and so on, the rest of the bone in ``carving/rest.vtp``. Both are in
    mm, or in the frame and unit of the anatomy's file, with ``layer`` and ``removed_depth_mm``. A
    cut of many triangles is written in blocks of voxels. ``carving/poses.npz`` holds the poses from
    which the bone at any other tick can be computed.
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
    seen: NDArray[np.uint8] | None = None
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
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

    if "Normals" in surface.point_data:  # a third of the file, and ParaView makes them
        del surface.point_data["Normals"]
    write_vtk_xml(vtkXMLPolyDataWriter(), mesh_in_file(surface, placement), path)
