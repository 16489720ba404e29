"""Tooth from a label image (segmented micro-CT).

The position of the enamel determines the orientation of the tooth. The image is resampled along the
axes of the tooth's site.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from meshes.base.arrays import Array, Bytes, Flags
from meshes.base.errors import InputError, enumerated, require_positive
from meshes.images.frame import Image
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.tooth.label_sampling import REACH, LabelShares, PlacedLabels, resampled
from meshes.tooth.layers import (
    EMPTY,
    ENAMEL,
    PRIORITY,
    PULP,
    TOOTH_LAYERS,
    lesion_site,
    require_known,
    require_tooth_size,
    tooth_axes,
)
from meshes.tooth.pulp_cavity import PulpCavity, with_pulp
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise

CARIES_LABELS: Mapping[int, str] = {1: "caries", 2: "enamel", 3: "dentin"}
"""Default layer names of the labels, as in segmentations of carious extracted teeth."""

_FINEST_DEFAULT_MM = 0.1
"""Smallest default voxel size [mm]. With the voxel size of a micro-CT, a tooth takes gigabytes."""
_CAVITY_M = 0.1e-3
"""Size [m] of the voxels in which pulp and lesion are searched, equal to the scenes' default."""
_CAVITY_SAMPLES = 2
"""Number of sub-samples along a voxel edge in the search for the pulp cavity."""
_SITE_POINTS = 200_000
"""Number of voxels from which the axes of a tooth are computed.

The error of the tooth's centre is then 0.01 mm.
"""
_MOST_VOXELS = 4e8
"""Largest number of voxels. The arrays take 4 bytes per voxel, 1.6 GB in total."""


@dataclass(frozen=True, eq=False)
class LabelledTooth:
    """Tooth that was read from a label image, with the tooth's site.

    The tooth can be converted to voxels of any size.

    Attributes
    ----------
    placed
        Labels of the tooth with their position.
    has_pulp
        Whether one of the labels is the pulp.
    finest_mm
        Smallest side of the image's voxels [mm].
    sentences
        Sentences on findings in the image and on changes of the image.
    """

    placed: PlacedLabels
    has_pulp: bool
    finest_mm: float
    sentences: tuple[str, ...]

    @cached_property
    def cavity(self) -> PulpCavity | None:
        """Pulp cavity of the tooth, found in voxels of 0.1 mm; None if there is no cavity."""
        return PulpCavity.of(resampled(self.placed, _CAVITY_M, most_samples=_CAVITY_SAMPLES))

    def at_lesion(self) -> LabelledTooth:
        """Return a copy of the tooth whose site is above the lesion.

        See `meshes.tooth.layers.lesion_site`.
        """
        found = lesion_site(self.volume(resample_mm=1e3 * _CAVITY_M))
        turned = self.placed.rotation @ found.rotation
        origin = self.placed.origin + self.placed.rotation @ found.centre_m
        placed = replace(self.placed, origin=origin, rotation=turned)
        return replace(
            self, placed=placed, sentences=(*self.sentences, f"Site {found.confidence}.")
        )

    def volume(
        self,
        *,
        resample_mm: float | None = None,
        region_m: tuple[Array, Array] | None = None,
        remark: Callable[[str], None] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> VoxelVolume:
        """Convert the tooth to voxels in the site frame.

        The layers have the names in `meshes.tooth.layers.TOOTH_LAYERS`.

        For the whole tooth, fractions and layers are computed from sub-samples, see
        `meshes.tooth.label_sampling.resampled`. For a region, fractions, layers and distances are
        computed from the interpolated shares of the labels. The surface of the tooth in a region is
        therefore the same for all voxel sizes. If no label is the pulp, the empty cavity in the
        dentin is used as the pulp.

        Parameters
        ----------
        resample_mm
            New voxel size [mm]. If None, the size is the larger of the image's voxel size and 0.1
            mm.
        region_m
            Smallest and largest coordinates [m] of the region in the site frame. If None, the whole
            tooth is converted. A voxel has the same content in every region that contains it.
        remark
            Function that is called once for each assumption, finding or removed piece, with a
            sentence that describes it.
        progress
            Function that is called with the finished fraction, 0 to 1.

        Raises
        ------
        InputError
            If the voxels are too small or too large, or no voxel lies in the tooth.
        """
        finest = (
            require_positive("resample_mm", resample_mm, "use a value such as 0.1")
            if resample_mm is not None
            else None
        )
        size = 1e-3 * (finest or max(self.finest_mm, _FINEST_DEFAULT_MM))
        corners = self.placed.corners
        sides = np.ptp(corners, axis=0)
        # Voxels above about 1 mm do not show enamel, which is 1 to 2 mm thick.
        if sides.min() < 8.0 * size:
            raise InputError(
                "resample_mm",
                "leave at least eight voxels across the tooth",
                f"{1000.0 * size:g} for a tooth of {1000.0 * sides.min():.3g} mm",
                "use a value such as 0.1",
            )
        if region_m is not None:
            corners = np.stack(
                [np.maximum(corners[0], region_m[0]), np.minimum(corners[1], region_m[1])]
            )
            if (corners[0] >= corners[1]).any():
                # the error for a region outside the tooth states the position of the tooth
                corners = self.placed.corners
        count = float(np.prod(np.ptp(corners, axis=0) / size))
        if count > _MOST_VOXELS:
            raise InputError(
                "resample_mm",
                f"leave at most {_MOST_VOXELS:.0e} voxels",
                f"{1000.0 * size:g}, which makes {count:.2g} voxels",
                f"use {1000.0 * size * (count / _MOST_VOXELS) ** (1 / 3):.2g} or more",
            )
        if region_m is None:
            volume = resampled(self.placed, size, progress=progress)
            if not self.has_pulp and self.cavity is not None:
                volume = with_pulp(volume, self.cavity.voxels(volume))
        else:
            volume = voxelise(
                self._anatomy(corners), spacing_m=size, region_m=(*corners,), progress=progress
            )
            if not volume.fraction.any():
                raise InputError(
                    "region",
                    "contain a part of the tooth",
                    "a region outside the tooth",
                    "move the tool to the tooth, or set anatomy.site",
                )
        if remark is not None:
            for sentence in (*self.sentences, *self._pulp_note()):
                remark(sentence)
        return volume

    def _pulp_note(self) -> tuple[str, ...]:
        """Return a note on the region that is used as pulp if no label is the pulp."""
        if self.has_pulp:
            return ()
        if self.cavity is None:
            return ("No label for the pulp: its distance and exposure are unknown.",)
        held = f"{1e9 * self.cavity.volume_m3:.3g} mm3"
        return (
            f"No label for the pulp: the empty cavity of {held} in the dentin is taken as pulp.",
        )

    def _anatomy(self, corners: Array) -> Anatomy:
        """Return the anatomy of the tooth in a box [m], with the pulp cavity filled."""
        labels, start, turn = self.placed.around(corners, REACH)
        if not self.has_pulp and self.cavity is not None:
            back = np.linalg.inv(turn)
            for plane, values in enumerate(labels):
                at = np.argwhere(values == EMPTY)
                index = np.column_stack([np.full(len(at), plane), at])
                values[tuple(at[self.cavity.contains(back @ (index - start).T)].T)] = PULP
        preference = [TOOTH_LAYERS.index(name) for name in PRIORITY]
        shares = LabelShares.of(
            labels, preference, voxel_m=self.placed.spacing, start=start, turn=turn
        )
        box = tuple(corners[0].tolist()), tuple(corners[1].tolist())
        shape = Shape(shares.distance, *box)
        placement = self.placed.placement
        return Anatomy(
            "tooth", shape, TOOTH_LAYERS, shares.classify, sample=shares.sample, placement=placement
        )


def labelled_tooth(image: Image, *, labels: Mapping[int, str] = CARIES_LABELS) -> LabelledTooth:
    """Check the labels of a tooth and find its site.

    The long axis of the tooth passes through the middle of the enamel. The origin of the site is
    the point where this axis leaves the tooth. At this point, the surface is enamel or an open
    lesion. z points from the roots to the crown.

    Parameters
    ----------
    image
        Label image, 0 outside the tooth.
    labels
        Dictionary from label to layer name.

    Raises
    ------
    InputError
        If a label is unknown, if enamel or dentin is missing, or if the size is not plausible for a
        tooth.
    """
    require_known(labels.values(), "labels")
    layer, first, islands = _layers(image, labels)
    counts = np.bincount(layer.ravel(order="K"), minlength=EMPTY + 1)
    cube_mm3 = image.voxel_mm3
    volumes_mm3 = {name: counts[k] * cube_mm3 for k, name in enumerate(TOOTH_LAYERS) if counts[k]}
    require_known(volumes_mm3, "labels")
    spacing_mm = np.array(image.spacing_mm)
    sides = spacing_mm * layer.shape
    longest = int(np.argmax(sides))
    require_tooth_size(
        float(sides[longest]), "spacing_mm", f"{spacing_mm[longest]:g}", layer.shape[longest]
    )
    placed, note = _placed(
        layer, 1e-3 * spacing_mm, 1e-3 * (np.array(image.origin_mm) + spacing_mm * first)
    )
    held = ", ".join(f"{name} {volume:.4g} mm3" for name, volume in volumes_mm3.items())
    sentences = [
        *image.notes,
        f"The labels of {image.source} have {held}.",
        f"Long axis: {note}.",
        *islands,
    ]
    if "ligament" not in volumes_mm3:
        held = "at the bone" if "bone" in volumes_mm3 else "at its lower third"
        sentences.append(f"No label for the ligament. To compute stress, the tooth is held {held}.")
    if "caries" in volumes_mm3:
        sentences.append(
            "The whole lesion is assumed half softened, because labels have no grades."
        )
    return LabelledTooth(placed, "pulp" in volumes_mm3, float(spacing_mm.min()), tuple(sentences))


def _layers(image: Image, labels: Mapping[int, str]) -> tuple[Bytes, list[int], list[str]]:
    """Crop a label image to the tooth in the image, and convert labels to layers.

    Pieces that are not connected to the largest piece by faces are removed.

    Returns
    -------
    Layer index, `EMPTY` outside the tooth; image index of the first voxel; note on the removed
    pieces.
    """
    from scipy.ndimage import find_objects
    from scipy.ndimage import label as label_pieces

    filled = image.values != 0
    boxes = find_objects(filled.view(np.uint8))
    if not boxes:
        raise InputError(
            "labels", "mark a tooth", f"nothing but 0 in {image.source}", "check the file"
        )
    cropped = image.values[boxes[0]]
    low = float(cropped.min())
    high = float(cropped.max())
    if low < 0 or high > EMPTY or any((plane != np.rint(plane)).any() for plane in cropped.T):
        raise InputError(
            "labels",
            f"be whole numbers from 0 to {EMPTY}",
            f"other values from {low:g} to {high:g} in {image.source}",
            "use a label image",
        )
    cropped = cropped.astype(np.uint8)
    # Count plane by plane, because counting a whole image takes eight bytes per voxel.
    counts = np.sum(
        [np.bincount(plane.ravel(), minlength=EMPTY + 1) for plane in cropped.T], axis=0
    )
    found = [label for label in np.flatnonzero(counts).tolist() if label]
    unknown = enumerated(
        f"{label} ({counts[label]} voxels)" for label in found if label not in labels
    )
    if unknown:
        raise InputError(
            "labels",
            f"name every label of {image.source}",
            f"no name for {unknown}",
            "add the missing names, or set them to 0 in the file",
        )
    pieces, count = label_pieces(cropped)
    sizes = np.bincount(pieces.ravel())
    sizes[0] = 0
    layer_of = np.full(EMPTY + 1, EMPTY, dtype=np.uint8)
    layer_of[found] = [TOOTH_LAYERS.index(labels[label]) for label in found]
    layer = layer_of[cropped]
    layer[pieces != np.argmax(sizes)] = EMPTY
    dropped = int(sizes.sum() - sizes.max())
    cube_mm3 = image.voxel_mm3
    islands = (
        f"Dropped {count - 1} loose pieces of {dropped} voxels, {dropped * cube_mm3:.2g} mm3 in "
        "all."
    )
    return layer, [side.start for side in boxes[0]], [islands] if count > 1 else []


def _placed(layer: Bytes, spacing: Array, first_m: Array) -> tuple[PlacedLabels, str]:
    """Find the site of a tooth. Return the labels at this site, and a text on the method."""
    layer = np.ascontiguousarray(np.pad(layer, 1, constant_values=EMPTY))
    axes = tooth_axes(
        _points(layer == ENAMEL, spacing), _points((layer != ENAMEL) & (layer != EMPTY), spacing)
    )
    placed = PlacedLabels(layer, spacing, first_m - spacing, axes.middle_m, axes.rotation)
    reach = float(np.linalg.norm(spacing * layer.shape))
    # With steps of a quarter of a voxel, the error of the surface is at most half a step.
    heights = np.arange(-reach, reach, 0.25 * float(spacing.min()))
    on_axis = placed.on_plane(0.0, np.zeros(1), heights)[0]
    filled = np.flatnonzero(on_axis != EMPTY)
    if len(filled) == 0:
        raise InputError(
            "labels",
            "fill the long axis of the tooth",
            "no label there",
            "check which label is the enamel",
        )
    top = int(filled[-1])
    origin = axes.middle_m + heights[top] * axes.rotation[:, 2]
    return replace(
        placed, origin=origin
    ), f"{axes.note}; origin on the {TOOTH_LAYERS[on_axis[top]]}"


def _points(flags: Flags, spacing: Array) -> Array:
    """Return the centres [m], shape (n, 3), of evenly selected flagged voxels."""
    found = np.flatnonzero(flags)
    found = found[:: max(len(found) // _SITE_POINTS, 1)]
    return np.column_stack(np.unravel_index(found, flags.shape)) * spacing
