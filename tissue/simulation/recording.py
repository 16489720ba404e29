"""HDF5 file of a run in the layout that the recorder of the program volumetric_drilling uses."""

from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from meshes.base.arrays import Array
from meshes.base.whole_file import whole_file
from meshes.voxels.volume import FULL
from tissue.motion.drilling_recording import EVENTS, POSES, SHAFT_TO_X
from tissue.scene.tool import Tool
from tissue.simulation.bone_surface import CarvedRun
from tissue.simulation.trace import RECORDING, write_table

DRILL = "mastoidectomy_drill"
ANATOMY = "anatomy_object_name"
"""Name of the anatomy in a recording; `DRILL` is the name of the drill.

Both names are the defaults of volumetric_drilling. Scripts for its files therefore also work with
files of this package.
"""
DENSEST_KG_M3 = 2000.0
"""Density above which bone is drawn white [kg/m3].

The densest cortical bone has 1800 to 2000 kg/m3.
"""
ABOUT = (
    "Lengths in m, times in s from the start of the run, forces in N, torques in N m about "
    "the tool's tip. Poses are\n"
    "T_world_obj: x, y, z, qx, qy, qz, qw. The world is the frame of the scene; there is no "
    "camera, and forces on the\n"
    "tool are in the world's axes. The drill's origin lies half the burr's size above its "
    "tip, x towards the shank.\n"
    "The anatomy's origin lies in the middle of the block of voxels, whose axes are the world's.\n"
)
ABOUT_VOXELS = (
    "A row of voxel_removed has the row of its time in voxel_time_stamp, then the voxel's "
    "index along x, y and z. A\n"
    "row of voxel_color has the row of its time, then red, green, blue (from the density) and "
    "alpha (bone before the cut), 0 to 255.\n"
    "Removal is fractional: a voxel is removed in the tick in which less than half of it is left.\n"
)


def write_formats(run: CarvedRun, folder: Path, formats: Iterable[str]) -> None:
    """Write the trace or a recording of a run into a folder, in each of the given formats."""
    for kind in formats:
        if kind == RECORDING:
            write_recording(run, folder / "recording.hdf5")
        else:
            write_table(run.trace, folder / f"trace.{kind}")


def write_recording(run: CarvedRun, path: Path) -> None:
    """Write a run in the file layout of volumetric_drilling's recorder.

    The layout follows version 3 of the note on data in the repository volumetric_drilling.

    Data that a run does not have are left out. The recorder of volumetric_drilling also leaves out
    missing data. Images and camera are always left out. If the tool does not cut, voxels and burr
    are also left out.
    """
    import h5py

    # The file is made in memory, because HDF5 ends the process if its file cannot grow on a full
    # disk.
    image = BytesIO()
    with h5py.File(image, "w") as file:
        for group in (
            "vision_data/intermittent_data",
            "vision_data/continuous_data",
            EVENTS,
            POSES,
        ):
            file.create_group(group)
        file["metadata_v3/README"] = ABOUT
        _write_poses(file, run)
        if run.poses is not None and len(run.trace.rows):
            _write_voxels(file, run)
    with whole_file(path) as temporary:
        temporary.write_bytes(image.getbuffer())


def _write_poses(file: Any, run: CarvedRun) -> None:
    """Write poses of drill and anatomy, forces, and the size of the burr at the start."""
    trace = run.trace
    tool = run.scene.tool
    times = trace["time_s"]
    turns = trace.quaternions()
    held = Rotation.from_quat(turns) if len(turns) else Rotation.identity(0)
    size_mm = tool.diameter_mm if isinstance(tool, Tool) else 0.0
    centres = 1e-3 * trace.vectors("tool", "mm") + (
        held.apply([0.0, 0.0, 0.5e-3 * size_mm]) if len(turns) else 0.0
    )
    _store(
        file,
        f"{POSES}/{DRILL}_pose",
        times,
        pose=np.hstack([centres, (held * SHAFT_TO_X.inv()).as_quat()]),
    )
    place = np.zeros(3)
    if run.poses is not None:
        low, high = run.volume.bounds_m
        place = 0.5 * (low + high)
    still = np.tile([*place, 0.0, 0.0, 0.0, 1.0], (len(times), 1))
    _store(file, f"{POSES}/{ANATOMY}_pose", times, pose=still)
    loads = np.hstack([trace.vectors("force", "N"), trace.vectors("torque", "Nm")])
    _store(file, f"{EVENTS}/drill_force_feedback", times, wrench=loads)
    # In this layout, only a burr has a size.
    if size_mm > 0.0:
        _store(
            file, f"{EVENTS}/burr_change", times[:1], burr_size=np.array([size_mm])[: len(times)]
        )


def _write_voxels(file: Any, run: CarvedRun) -> None:
    """Write the removed voxels, grouped by the tick in which their content fell below one half."""
    volume = run.volume
    file["metadata_v3/voxel_volume"] = 1e9 * volume.voxel_volume_m3
    file["metadata_v3/voxel_volume"].attrs["units"] = "mm^3, millimeters cubed"
    places, ticks = run.replay().removals()
    if len(places) == 0:
        return
    when, group = np.unique(ticks, return_inverse=True)
    at = tuple(places.T)
    grey = 255.0 * np.minimum(volume.density_kg_m3[at] / DENSEST_KG_M3, 1.0)
    colour = np.column_stack([grey, grey, grey, volume.fraction[at] * (255.0 / FULL)])
    name = f"{EVENTS}/voxels_removed"
    for key, values in {
        "voxel_time_stamp": run.trace["time_s"][when],
        "voxel_removed": np.column_stack([group, places]).astype(np.float64),
        "voxel_color": np.column_stack([group, colour]),
    }.items():
        file.create_dataset(f"{name}/{key}", data=values, compression="gzip")
    file[f"{name}/README"] = ABOUT_VOXELS


def _store(file: Any, group: str, times: Array, **values: Array) -> None:
    """Write samples and their times as float64 with gzip compression."""
    for name, samples in {"time_stamp": times, **values}.items():
        file.create_dataset(f"{group}/{name}", data=samples, compression="gzip")
