"""A tooth from a label image (segmented micro-CT): placed by its enamel, resampled into the axes of its site."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.errors import InputError, require_positive
from meshes.grid import Grid
from meshes.image_file import Image, read_image
from meshes.label_image import EMPTY, LayerImage, layer_image
from meshes.pulp_cavity import pulp_cavity, with_pulp
from meshes.tooth_checks import require_known, require_priority, require_tooth_size
from meshes.tooth_layers import ENAMEL, LAYER_DENSITY_KG_M3, TOOTH_LAYERS
from meshes.tooth_site import tooth_axes
from meshes.volume import FULL, VoxelVolume

__all__ = ["CARIES_LABELS", "label_volume", "labelled_volume"]

CARIES_LABELS: Mapping[int, str] = {1: "caries", 2: "enamel", 3: "dentin"}
"""Labels of segmentations of decay in extracted teeth."""

_FINEST_DEFAULT_MM = 0.1
_SITE_POINTS = 200_000
_MOST_SAMPLES = 6  # a voxel's 216 still fit a byte
_MOST_VOXELS = 4e8
_SLAB = 8
_THREADS = 2
_DENSITY = np.array([LAYER_DENSITY_KG_M3[name] for name in TOOTH_LAYERS], dtype=np.uint16)


@dataclass(frozen=True, eq=False)
class _Placed:
    """A layer image with its place in the site frame.

    Attributes
    ----------
    layer
        Layer index, `EMPTY` outside and all along the border, uint8, shape (nx, ny, nz), C-contiguous.
    spacing
        Voxel sizes [m], shape (3,); voxel (0, 0, 0) is centred at the origin of the image's frame.
    origin, rotation
        Site's origin [m] and axes as columns, in the image's frame.
    """

    layer: NDArray[np.uint8]
    spacing: NDArray[np.float64]
    origin: NDArray[np.float64]
    rotation: NDArray[np.float64]

    def on_plane(self, x: float, y: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Layer at the points of a plane of the site frame, shape (ny, nz); a margin of empty voxels is `EMPTY`."""
        number = np.zeros((len(y), len(z)), dtype=np.int32)
        for axis, count in enumerate(self.layer.shape):
            scale = self.rotation[axis] / self.spacing[axis]
            start = float(self.origin[axis] / self.spacing[axis] + scale[0] * x)
            index = (start + scale[1] * y).astype(np.float32)[:, None] + (scale[2] * z).astype(np.float32)
            np.rint(index, out=index)
            np.clip(index, 0, count - 1, out=index)
            number *= count
            number += index.astype(np.int32)
        return self.layer.ravel()[number]

    def corners(self) -> NDArray[np.float64]:
        """Lowest and highest corner [m] of the tooth in the site frame, shape (2, 3)."""
        steps = [max(n // 160, 1) for n in self.layer.shape]
        index = np.argwhere(self.layer[:: steps[0], :: steps[1], :: steps[2]] != EMPTY) * steps
        points = (index * self.spacing - self.origin) @ self.rotation
        reach = float(np.linalg.norm(steps * self.spacing))
        return np.stack([points.min(axis=0) - reach, points.max(axis=0) + reach])


def label_volume(
    path: str | Path,
    *,
    spacing_mm: float | None = None,
    labels: Mapping[int, str] = CARIES_LABELS,
    resample_mm: float | None = None,
    priority: Sequence[str] | None = None,
    pulp_from_cavity: bool = True,
    array: str | None = None,
    remark: Callable[[str], None] | None = None,
) -> VoxelVolume:
    """Tooth from a label image file; `meshes.image_file.read_image` says which files, `labelled_volume` the rest.

    Parameters
    ----------
    spacing_mm
        Voxel size [mm], instead of the file's, which segmentation tools often leave at a placeholder of 1.
    """
    require_known(labels.values(), "labels")
    image = read_image(path, spacing_mm=spacing_mm, array=array)
    return labelled_volume(
        image,
        labels=labels,
        resample_mm=resample_mm,
        priority=priority,
        pulp_from_cavity=pulp_from_cavity,
        remark=remark,
    )


def labelled_volume(
    image: Image,
    *,
    labels: Mapping[int, str] = CARIES_LABELS,
    resample_mm: float | None = None,
    priority: Sequence[str] | None = None,
    pulp_from_cavity: bool = True,
    remark: Callable[[str], None] | None = None,
) -> VoxelVolume:
    """Voxels of a tooth in the site frame of teeth, its layers those of `meshes.tooth_layers.TOOTH_LAYERS`.

    The origin is where the tooth's long axis through the middle of the enamel leaves the tooth: the enamel, or a lesion
    open to the surface there. z points from the roots to the crown. Fractions and layers come from sub-samples no
    farther apart than the image's voxels: the fraction is the part of them in any layer, the layer the commonest.

    Parameters
    ----------
    image
        Labels, 0 outside.
    labels
        Layer name by label.
    resample_mm
        New voxel size [mm]; None: the image's, or 0.1 where that is finer.
    priority
        Layer names: of two layers with equal parts in a voxel, the first named has it. None: caries, pulp, enamel,
        dentin, ligament, bone.
    pulp_from_cavity
        Where no label is the pulp: whether the empty cavity in the dentin is taken as pulp.
    remark
        Called with each sentence on what was assumed, found and dropped.

    Raises
    ------
    InputError
        If labels are unknown, enamel or dentin is missing, the size is no tooth's, or the option is out of range.
    """
    require_known(labels.values(), "labels")
    order = require_priority(priority, labels.values())
    named = layer_image(image.values, labels, image.source)
    require_known(named.counts, "labels")
    spacing_mm = np.array(image.spacing_mm)
    sides = spacing_mm * named.layer.shape
    longest = int(np.argmax(sides))
    given = f"{spacing_mm[longest]:g}"
    require_tooth_size(float(sides[longest]), "spacing_mm", given, named.layer.shape[longest])
    finest = require_positive("resample_mm", resample_mm, "use 0.1") if resample_mm is not None else None
    size = 1e-3 * (finest or max(float(spacing_mm.min()), _FINEST_DEFAULT_MM))
    placed, said = _placed(named, 1e-3 * spacing_mm)
    corners = placed.corners()
    _require_room(corners, size)
    volume = _resampled(placed, corners, size, order)
    sentences = [*image.notes, *_sentences(image, named, said)]
    if "pulp" not in named.counts:
        volume, sentence = _pulp(volume, pulp_from_cavity)
        sentences.append(sentence)
    if remark is not None:
        for sentence in sentences:
            remark(sentence)
    return volume


def _pulp(volume: VoxelVolume, wanted: bool) -> tuple[VoxelVolume, str]:
    """The volume with its cavity as pulp where wanted, and a sentence on it."""
    cavity = pulp_cavity(volume) if wanted else np.zeros(1, dtype=bool)
    if not cavity.any():
        return volume, "No label for the pulp: its distance and exposure cannot be told."
    volume_mm3 = 1e9 * volume.voxel_volume_m3 * np.count_nonzero(cavity)
    return with_pulp(volume, cavity), (
        f"No label for the pulp: the empty cavity of {volume_mm3:.3g} mm3 in the dentin is taken as pulp."
    )


def _placed(named: LayerImage, spacing: NDArray[np.float64]) -> tuple[_Placed, str]:
    """The image with its site found, and how."""
    layer = np.ascontiguousarray(np.pad(named.layer, 1, constant_values=EMPTY))
    enamel = _points(layer == ENAMEL, spacing)
    axes = tooth_axes(enamel, _points((layer != ENAMEL) & (layer != EMPTY), spacing))
    placed = _Placed(layer, spacing, axes.middle_m, axes.rotation)
    reach = float(np.linalg.norm(spacing * layer.shape))
    heights = np.arange(-reach, reach, 0.25 * float(spacing.min()))
    on_axis = placed.on_plane(0.0, np.zeros(1), heights)[0]
    filled = np.flatnonzero(on_axis != EMPTY)
    if len(filled) == 0:
        raise InputError("labels must fill the tooth's long axis, got none there: check which label is the enamel")
    top = int(filled[-1])
    origin = axes.middle_m + heights[top] * axes.rotation[:, 2]
    return _Placed(layer, spacing, origin, axes.rotation), f"{axes.said}; origin on the {TOOTH_LAYERS[on_axis[top]]}"


def _points(flags: NDArray[np.bool_], spacing: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centres of some of the flagged voxels [m], spread evenly, shape (n, 3)."""
    found = np.flatnonzero(flags)
    found = found[:: max(len(found) // _SITE_POINTS, 1)]
    return np.column_stack(np.unravel_index(found, flags.shape)) * spacing


def _sentences(image: Image, named: LayerImage, said: str) -> list[str]:
    """What was found in the image and done to it."""
    cube_mm3 = float(np.prod(image.spacing_mm))
    volumes = ", ".join(f"{name} {count * cube_mm3:.4g} mm3" for name, count in named.counts.items())
    sentences = [f"The labels of {image.source} hold {volumes}.", f"Long axis: {said}."]
    if named.island_count:
        sentences.append(
            f"Dropped {named.island_count} loose pieces of {named.island_voxels} voxels, "
            f"{named.island_voxels * cube_mm3:.2g} mm3 in all."
        )
    if "ligament" not in named.counts:
        sentences.append("No label for the ligament: the tooth has no support but what the scene states.")
    if "caries" in named.counts:
        sentences.append("The lesion is taken as half softened throughout: labels do not grade it.")
    return sentences


def _require_room(corners: NDArray[np.float64], size: float) -> None:
    """Refuse voxels too large for the tooth, or too many of them."""
    sides = np.ptp(corners, axis=0)
    count = float(np.prod(sides / size))
    if count > _MOST_VOXELS:
        raise InputError(
            f"resample_mm must leave at most {_MOST_VOXELS:.0e} voxels, got {1e3 * size:g} which makes {count:.2g}: "
            f"use {1e3 * size * (count / _MOST_VOXELS) ** (1 / 3):.2g} or more"
        )
    if sides.min() < 8.0 * size:
        raise InputError(
            f"resample_mm must leave eight voxels across the tooth, got {1e3 * size:g} for {1e3 * sides.min():.3g} mm: "
            "use 0.1"
        )


def _resampled(placed: _Placed, corners: NDArray[np.float64], size: float, order: Sequence[str]) -> VoxelVolume:
    """Voxels of edge `size` [m] on whole multiples of it, cropped to the tooth."""
    first = np.floor(corners[0] / size).astype(int).tolist()
    count = (np.ceil(corners[1] / size).astype(int) - first).tolist()
    grid = Grid(size, (first[0], first[1], first[2]), (count[0], count[1], count[2]))
    parts = min(max(ceil(size / float(placed.spacing.min()) - 1e-6), 1), _MOST_SAMPLES)
    fraction, layer = np.zeros(grid.shape, np.uint8), np.zeros(grid.shape, np.uint8)
    preference = [TOOTH_LAYERS.index(name) for name in order if (placed.layer == TOOTH_LAYERS.index(name)).any()]

    def fill(start: int) -> None:
        stop = min(start + _SLAB, grid.shape[0])
        held = _parts_by_layer(placed, grid.slab(start, stop), parts, preference)[..., : len(preference)]
        fraction[start:stop] = np.rint(held.sum(axis=3, dtype=np.int32) * (FULL / parts**3))
        layer[start:stop] = np.array(preference, dtype=np.uint8)[np.argmax(held, axis=3)] * (fraction[start:stop] > 0)

    with ThreadPoolExecutor(_THREADS) as pool:
        list(pool.map(fill, range(0, grid.shape[0], _SLAB)))
    spans = [np.flatnonzero(fraction.any(axis=tuple(k for k in range(3) if k != axis))) for axis in range(3)]
    crop = tuple(slice(int(span[0]), int(span[-1]) + 1) for span in spans)
    origin = (np.array(grid.first) + [s.start for s in crop]) * size
    layer, fraction = np.ascontiguousarray(layer[crop]), np.ascontiguousarray(fraction[crop])
    return VoxelVolume(origin, size, fraction, layer, _DENSITY[layer] * (fraction > 0), TOOTH_LAYERS)


def _parts_by_layer(placed: _Placed, grid: Grid, parts: int, layers: Sequence[int]) -> NDArray[np.uint8]:
    """Sub-samples of each voxel in each of up to eight layers, shape (nx, ny, nz, 8).

    Eight counters of a byte share a word, so one sum counts all layers; `parts`³ fits a byte.
    """
    counter = np.zeros(EMPTY + 1, dtype=np.uint64)
    counter[list(layers)] = np.uint64(1) << (np.uint64(8) * np.arange(len(layers), dtype=np.uint64))
    x, y, z = (
        ((np.arange(n * parts) + 0.5) / parts + f) * grid.spacing_m for f, n in zip(grid.first, grid.shape, strict=True)
    )
    held = np.zeros(grid.shape, dtype="<u8")
    for k, height in enumerate(x):
        found = counter[placed.on_plane(height, y, z)]
        for i, j in np.ndindex(parts, parts):
            held[k // parts] += found[i::parts, j::parts]
    return held.view(np.uint8).reshape(*grid.shape, 8)
