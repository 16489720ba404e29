"""Bone as voxels: how full, which layer, how dense."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive
from meshes.base.placement import Placement

if TYPE_CHECKING:
    import pyvista

__all__ = ["FULL", "VoxelVolume"]

FULL = 255
"""Stored fraction of a voxel that is bone throughout."""


@dataclass(frozen=True, eq=False)
class VoxelVolume:
    """A block of cubic voxels with the part of each that is bone.

    Attributes
    ----------
    origin_m
        Corner of voxel (0, 0, 0) with the lowest coordinates [m], shape (3,), float64.
    spacing_m
        Edge of a voxel [m].
    fraction
        Bone in the voxel, 255 = full, uint8, shape (nx, ny, nz).
    layer
        Index into `layer_names`, uint8, shape (nx, ny, nz); meaningless where `fraction` is 0.
    density_kg_m3
        Apparent density of the bone in the voxel [kg/m3], uint16, shape (nx, ny, nz).
    layer_names
        Name of each layer.
    placement
        Where the frame lies in that of the file that the bone came from; None where it came from none.

    Raises
    ------
    InputError
        If arrays differ in shape or type, are not C-contiguous, or a layer has no name.
    """

    origin_m: NDArray[np.float64]
    spacing_m: float
    fraction: NDArray[np.uint8]
    layer: NDArray[np.uint8]
    density_kg_m3: NDArray[np.uint16]
    layer_names: tuple[str, ...]
    placement: Placement | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_m", np.asarray(self.origin_m, dtype=np.float64))
        if self.origin_m.shape != (3,) or not np.isfinite(self.origin_m).all():
            raise InputError(f"origin_m must be three finite numbers, got {self.origin_m}: use for example (0, 0, 0)")
        require_positive("spacing_m", self.spacing_m, "use about 1e-4 (0.1 mm)")
        _require_array("fraction", self.fraction, np.uint8, self.fraction.shape)
        _require_array("layer", self.layer, np.uint8, self.fraction.shape)
        _require_array("density_kg_m3", self.density_kg_m3, np.uint16, self.fraction.shape)
        highest = int(self.layer.max())
        if highest >= len(self.layer_names):
            raise InputError(
                f"layer must index layer_names, got {highest} with {len(self.layer_names)} names: name every layer"
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along x, y and z."""
        nx, ny, nz = self.fraction.shape
        return nx, ny, nz

    @property
    def voxel_volume_m3(self) -> float:
        """Volume of one full voxel [m3]."""
        return self.spacing_m**3

    @property
    def bounds_m(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest corner of the block [m], each shape (3,)."""
        return self.origin_m, self.origin_m + self.spacing_m * np.array(self.shape)

    def volume_m3(self, layer: str | None = None) -> float:
        """Bone volume [m3], of one named layer or of all.

        Raises
        ------
        InputError
            If the layer is unknown; the message lists the known ones.
        """
        if layer is None:
            return float(self.fraction.sum(dtype=np.int64)) / FULL * self.voxel_volume_m3
        if layer not in self.layer_names:
            raise InputError(f"layer must be one of {', '.join(self.layer_names)}, got {layer}: use one of these names")
        inside = self.layer == self.layer_names.index(layer)
        return float(np.sum(self.fraction, where=inside, dtype=np.int64)) / FULL * self.voxel_volume_m3

    def centres_m(self, axis: int) -> NDArray[np.float64]:
        """Coordinates [m] of the voxel centres along one axis, shape (n_axis,)."""
        return self.origin_m[axis] + self.spacing_m * (np.arange(self.shape[axis]) + 0.5)

    def cropped(self, lower_m: NDArray[np.float64], upper_m: NDArray[np.float64]) -> VoxelVolume:
        """The voxels that a box [m] touches; the whole volume where the box does not meet it."""
        low = np.floor((np.asarray(lower_m) - self.origin_m) / self.spacing_m + 1e-6).astype(int)
        high = np.ceil((np.asarray(upper_m) - self.origin_m) / self.spacing_m - 1e-6).astype(int)
        low, high = np.clip(low, 0, self.shape), np.clip(high, 0, self.shape)
        if (low >= high).any():
            return self
        part = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
        return VoxelVolume(
            self.origin_m + self.spacing_m * low,
            self.spacing_m,
            np.ascontiguousarray(self.fraction[part]),
            np.ascontiguousarray(self.layer[part]),
            np.ascontiguousarray(self.density_kg_m3[part]),
            self.layer_names,
            self.placement,
        )

    def to_image(self) -> pyvista.ImageData:
        """Return a pyvista image in mm with cell arrays `fraction` (0 to 1), `layer` and `density_kg_m3`."""
        import pyvista

        image = pyvista.ImageData(
            dimensions=[n + 1 for n in self.shape],
            spacing=[self.spacing_m * 1e3] * 3,
            origin=(self.origin_m * 1e3).tolist(),
        )
        image.cell_data["fraction"] = self.fraction.ravel(order="F").astype(np.float32) / np.float32(FULL)
        image.cell_data["layer"] = self.layer.ravel(order="F")
        image.cell_data["density_kg_m3"] = self.density_kg_m3.ravel(order="F")
        return image

    def surface(self, level: float = 0.5) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Closed triangle mesh of the surface where the fraction is `level` (marching cubes on the voxel centres).

        Returns
        -------
        Vertices [m], shape (n, 3), in the volume's frame, and triangles, shape (m, 3), wound outward.

        Raises
        ------
        InputError
            If `level` is not inside (0, 1) or no voxel reaches it.
        """
        if not 0.0 < level < 1.0:
            raise InputError(f"level must be in (0, 1), got {level}: use 0.5")
        if int(self.fraction.max()) < level * FULL:
            raise InputError(
                f"level must be reached by a voxel, got {level} where the fullest holds "
                f"{int(self.fraction.max()) / FULL:g}: use a volume with bone in it"
            )
        from skimage.measure import marching_cubes

        padded = np.pad(self.fraction, 1)
        vertices, faces, _, _ = marching_cubes(padded, level * FULL)
        return self.origin_m + self.spacing_m * (vertices.astype(np.float64) - 0.5), faces[:, ::-1].astype(np.int64)


def _require_array(name: str, array: NDArray[Any], dtype: type, shape: tuple[int, ...]) -> None:
    if array.ndim != 3 or 0 in array.shape or array.shape != shape:
        raise InputError(
            f"{name} must have the shape (nx, ny, nz) of fraction with no zero, got {array.shape}: "
            "give all three arrays the same shape"
        )
    if array.dtype != dtype or not array.flags.c_contiguous:
        raise InputError(
            f"{name} must be a C-contiguous {np.dtype(dtype)} array, got {array.dtype}: "
            f"use numpy.ascontiguousarray(array, dtype='{np.dtype(dtype)}')"
        )
