"""Conversion of an image volume (CT or micro-CT) to voxels with bone fraction and density."""

import math
from collections.abc import Callable

import numpy as np

from meshes.base.arrays import Array, Ints, Numbers, Singles
from meshes.base.errors import InputError, require_positive, require_range
from meshes.base.placement import Placement
from meshes.images.frame import Image
from meshes.shapes.anatomy import CORTICAL_KG_M3
from meshes.voxels.volume import FULL, VoxelVolume

Density = Callable[[Numbers], Singles]
"""Function from grey values to densities [kg/m3], such as a `meshes.ct.density.DensityLaw`."""

_ISOTROPY = 1e-3
"""Relative difference up to which two spacings count as equal, because headers round them."""
_MOST_VOXELS = 5e8
"""Largest number of voxels after resampling. Each of three float32 arrays then takes 2 GB."""


def image_volume(
    image: Image,
    *,
    threshold: float,
    density_kg_m3: float | Density = CORTICAL_KG_M3,
    resample_mm: float | None = None,
    remark: Callable[[str], None] | None = None,
) -> VoxelVolume:
    """Convert an image to bone voxels of a single material layer.

    The origin of the result is the centre of the top face of the voxel block, and +z is upward. The
    result also contains the position of the voxel block in the patient frame LPS.

    Parameters
    ----------
    threshold
        Grey value above which a voxel is bone.
    density_kg_m3
        Density of the bone in a voxel: one value [kg/m3], or a function that computes the density
        from the grey value.
    resample_mm
        New voxel size [mm]. For finer voxels, grey values are interpolated first. For coarser
        voxels, the bone fractions are averaged, so the bone volume does not change. If None, the
        voxel size of the image is used. If the image has different voxel sizes along its axes, the
        smallest is used.
    remark
        Function that is called once for each assumption, with a sentence that describes the
        assumption.

    Raises
    ------
    InputError
        If an option is out of range, or no voxel has a value above the threshold.
    """
    limit = require_range(
        # 1e9: any finite grey value
        "anatomy.threshold",
        threshold,
        -1e9,
        1e9,
        "use 63 for 8-bit micro-CT, about 200 for CT",
    )
    spacing = (
        min(image.spacing_mm)
        if resample_mm is None
        else require_positive("resample_mm", resample_mm, "use a value such as 0.1")
    )
    notes = list(image.notes)
    if resample_mm is None and max(image.spacing_mm) > (1.0 + _ISOTROPY) * spacing:
        notes.append(f"The voxels of {image.source} are not cubes; resampled to {spacing:g} mm.")
    _require_size(image.values.shape, image.spacing_mm, spacing)
    values = _refined(image.values, image.spacing_mm, spacing)
    fraction = (values > limit).astype(np.float32)
    if not fraction.any():
        raise _no_bone(limit, values, image.source)
    # A value outside this range has another unit, such as g/cm3.
    mass = fraction * (
        density_kg_m3(values)
        if callable(density_kg_m3)
        else np.float32(
            require_range("density_kg_m3", density_kg_m3, 50.0, 20000.0, "use a value such as 1800")
        )
    )
    for axis, size in enumerate(image.spacing_mm):
        fraction, mass = (_averaged(a, axis, spacing / size) for a in (fraction, mass))
    if remark is not None:
        for note in notes:
            remark(note)
    # Fractions below half a step are stored as 0. For these, the quotient would only be rounding
    # errors.
    density = np.divide(mass, fraction, out=np.zeros_like(mass), where=fraction > 0.25 / FULL)
    nx, ny, nz = fraction.shape
    origin = -1e-3 * spacing * np.array([nx // 2, ny // 2, nz], dtype=np.float64)
    corner_mm = np.array(image.origin_mm) - 0.5 * np.array(image.spacing_mm)
    return VoxelVolume(
        origin,
        1e-3 * spacing,
        np.ascontiguousarray(np.rint(fraction * FULL), dtype=np.uint8),
        np.zeros(fraction.shape, np.uint8),
        np.ascontiguousarray(np.rint(density), dtype=np.uint16),
        ("trabecular",),
        Placement(corner_mm - 1e3 * origin, np.eye(3)),
    )


def _no_bone(threshold: float, values: Numbers, source: str) -> InputError:
    """Return the error for a threshold above all grey values."""
    return InputError(
        "anatomy.threshold",
        "leave bone",
        f"{threshold:g}, but the values of {source} are {values.min():g} to {values.max():g}",
        "use a threshold between these two values",
    )


def _require_size(
    shape: tuple[int, ...], from_mm: tuple[float, float, float], to_mm: float
) -> None:
    """Raise an error if the resampled image would have too many voxels."""
    count = math.prod(n * max(size / to_mm, 1.0) for n, size in zip(shape, from_mm, strict=True))
    if count > _MOST_VOXELS:
        fitting = to_mm * (count / _MOST_VOXELS) ** (1.0 / 3.0)
        raise InputError(
            "resample_mm",
            f"leave at most {_MOST_VOXELS:.0e} voxels",
            f"{to_mm:g}, which makes {count:.2g} voxels",
            f"crop the image, or use {fitting:.2g} or more",
        )


def _refined(values: Numbers, from_mm: tuple[float, float, float], to_mm: float) -> Numbers:
    """Interpolate linearly to the spacing `to_mm` along each axis with a coarser spacing."""
    from scipy.ndimage import affine_transform

    sizes = np.array(from_mm)
    steps = np.where(sizes > (1.0 + _ISOTROPY) * to_mm, to_mm / sizes, 1.0)
    if (steps == 1.0).all():
        return values
    # 1e-6 keeps the last voxel if the quotient is rounded to just below a whole number.
    count = np.floor(np.array(values.shape) / steps + 1e-6).astype(int)
    return np.asarray(
        affine_transform(
            values.astype(np.float32),
            steps,
            0.5 * steps - 0.5,
            tuple(count.tolist()),
            order=1,
            mode="nearest",
        )
    )


def _averaged(values: Singles, axis: int, ratio: float) -> Singles:
    """Average groups of `ratio` consecutive voxels along an axis. The ratio need not be an integer.

    The weight of a voxel is the fraction of the voxel that lies in the group. With a ratio of 1,
    the values are returned unchanged.

    Voxels at the end that do not fill a group are omitted.
    """
    if ratio <= 1.0 + _ISOTROPY:
        return values
    count = values.shape[axis]
    # 1e-6 keeps the last voxel if count / ratio is rounded to just below a whole number.
    edges = np.arange(math.floor(count / ratio + 1e-6) + 1) * ratio
    if len(edges) < 2:
        raise InputError(
            "resample_mm",
            "leave at least one voxel along every axis",
            f"a length of {ratio:g} image voxels along an axis with {count}",
            "use a smaller resample_mm",
        )
    before = [(1, 0) if k == axis else (0, 0) for k in range(3)]
    running = np.pad(np.cumsum(values, axis=axis, dtype=np.float64), before)
    low = np.minimum(edges.astype(np.int64), count - 1)
    part = (edges - low).reshape([-1 if k == axis else 1 for k in range(3)])
    below = np.take(running, low, axis=axis)
    above = np.take(running, low + 1, axis=axis)
    return (np.diff(below + (above - below) * part, axis=axis) / ratio).astype(np.float32)


def image_triangles(image: Image, *, threshold: float) -> tuple[Array, Ints]:
    """Return vertices [mm] and triangles of the surface around all values above a threshold.

    Vertices and triangles have the shapes (n, 3) and (m, 3).

    Raises
    ------
    InputError
        If no voxel lies above the threshold.
    """
    from skimage.measure import marching_cubes

    values = image.values.astype(np.float32)
    if not values.max() > threshold:
        raise _no_bone(threshold, values, image.source)
    # The densest bone at the edge then ends half a voxel outside the last voxel centre, which is
    # the end of its voxel.
    outside = min(float(values.min()), 2.0 * threshold - float(values.max()))
    padded = np.pad(values, 1, constant_values=outside)
    vertices, faces, _, _ = marching_cubes(padded, threshold, spacing=image.spacing_mm)
    return vertices - np.asarray(image.spacing_mm) + np.asarray(image.origin_mm), faces[
        :, ::-1
    ].astype(np.int64)


def image_cuts(image: Image, *, threshold: float) -> tuple[Array, ...]:
    """Return points [m] on the cuts, where boundary voxels of the image exceed a threshold.

    The result has one array, shape (k, 3), for each connected area of the cuts.
    """
    from scipy.ndimage import find_objects, label

    cuts = []
    for axis in range(3):
        for end in (0, image.values.shape[axis] - 1):
            pieces, _ = label(np.take(image.values, end, axis=axis) > threshold)
            for number, box in enumerate(find_objects(pieces), start=1):
                first = [each.start for each in box]
                index = np.insert(np.argwhere(pieces[box] == number) + first, axis, end, axis=1)
                cuts.append(
                    1e-3 * (index * np.asarray(image.spacing_mm) + np.asarray(image.origin_mm))
                )
    return tuple(cuts)
