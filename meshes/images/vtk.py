"""VTK image files, parsed in a process of their own."""

from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from meshes.base.isolated_parser import Answer, parse_isolated
from meshes.images.frame import StoredImage

__all__ = ["read_vtk_image", "vtk_voxels"]


def read_vtk_image(path: Path) -> StoredImage:
    """Read the active array of a `.vti` image; VTK names no frame of a patient, so its axes are taken as LPS."""
    facts, arrays = parse_isolated("meshes.images.vtk:vtk_voxels", path, what="image volume", remedy="export it again")
    values, frame = arrays["values"], arrays["frame"].astype(np.float64)
    x, y, z = frame[3].tolist()
    return StoredImage(values.reshape(facts["shape"], order="F"), (x, y, z), frame[:3], frame[4])


def vtk_voxels(file: Path) -> Answer:
    """Array of an image file, first index fastest, with its shape, and the rows of its frame: directions
    (three), spacing, and the centre of the first voxel.

    Raises
    ------
    InputError
        If it holds no image of one number a voxel.
    """
    import pyvista

    from meshes.surfaces.vtk_reading import read_vtk

    data = read_vtk(file)
    if not isinstance(data, pyvista.ImageData) or not data.array_names:
        raise InputError(
            f"file must hold an image volume, got {type(data).__name__} without voxels in {file.name}: export it again"
        )
    name = data.active_scalars_name or data.array_names[0]
    by_cell = name in data.cell_data
    shape = [n - 1 if by_cell else n for n in data.dimensions]
    values = np.asarray(data.cell_data[name] if by_cell else data.point_data[name])
    if values.ndim != 1 or 0 in shape or values.size != int(np.prod(shape)):
        raise InputError(
            f"file must hold one number per voxel, got an array of shape {values.shape} in {file.name}: export grey "
            "values"
        )
    directions = np.asarray(data.direction_matrix, dtype=np.float64)
    origin = np.array(data.GetPoint(0)) + (0.5 * directions @ data.spacing if by_cell else 0.0)
    return {"shape": shape}, {"values": values, "frame": np.stack([*directions, data.spacing, origin])}
