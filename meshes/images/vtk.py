"""VTK image files, parsed in a process of their own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.isolated_parser import parse_isolated
from meshes.images.frame import StoredImage

__all__ = ["read_vtk_image", "vtk_voxels"]


def read_vtk_image(path: Path, array: str | None) -> StoredImage:
    """Read a `.vti` image; VTK names no frame of a patient, so its axes are taken as LPS.

    Parameters
    ----------
    array
        Name of the array of points or cells; None: the active one.
    """
    parsed = parse_isolated(
        "meshes.images.vtk:vtk_voxels", path, what="image volume", remedy="export it again", array=array
    )
    values, facts = parsed.arrays["values"], parsed.facts
    x, y, z = (float(s) for s in facts["spacing"])
    directions, origin = np.array(facts["directions"]), np.array(facts["origin"])
    return StoredImage(values.reshape(facts["shape"], order="F"), (x, y, z), directions, origin)


def vtk_voxels(file: Path, array: str | None) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Values of an image file, first index fastest, with shape, spacing, directions and the centre of the first voxel.

    Raises
    ------
    InputError
        If it holds no image of one number a voxel, or no array of that name.
    """
    import pyvista

    from meshes.surfaces.vtk_reading import read_vtk

    data = read_vtk(file)
    if not isinstance(data, pyvista.ImageData) or not data.array_names:
        raise InputError(
            f"file must hold an image volume, got {type(data).__name__} without voxels in {file.name}: export it again"
        )
    name = array or data.active_scalars_name or data.array_names[0]
    if name not in data.array_names:
        raise InputError(
            f"anatomy.array must be one of {', '.join(data.array_names)}, got {name}: use one of these names"
        )
    by_cell = name in data.cell_data
    shape = [n - 1 if by_cell else n for n in data.dimensions]
    values = np.asarray(data.cell_data[name] if by_cell else data.point_data[name])
    if values.ndim != 1 or 0 in shape or values.size != int(np.prod(shape)):
        raise InputError(
            f"file must hold one number per voxel, got an array of shape {values.shape} in {file.name}: export grey "
            "values"
        )
    matrix = data.GetDirectionMatrix()
    directions = np.array([[matrix.GetElement(i, j) for j in range(3)] for i in range(3)])
    origin = np.array(data.GetPoint(0)) + (0.5 * directions @ data.spacing if by_cell else 0.0)
    facts = {
        "shape": shape,
        "spacing": [float(s) for s in data.spacing],
        "directions": directions.tolist(),
        "origin": origin.tolist(),
    }
    return facts, {"values": values}
