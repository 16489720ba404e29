"""A tooth from a label image (segmented micro-CT): placed by its enamel, resampled into the axes of its site."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, require_positive
from meshes.base.progress import Progress, silent
from meshes.images.frame import Image
from meshes.shapes.anatomy import Anatomy
from meshes.shapes.sdf import Shape
from meshes.tooth.checks import require_known, require_tooth_size
from meshes.tooth.label_image import EMPTY, LayerImage, layer_image
from meshes.tooth.label_sampling import PlacedLabels, resampled
from meshes.tooth.label_shares import REACH, LabelShares
from meshes.tooth.layers import ENAMEL, PRIORITY, PULP, TOOTH_LAYERS
from meshes.tooth.lesion_site import lesion_site
from meshes.tooth.pulp_cavity import PulpCavity, with_pulp
from meshes.tooth.site import tooth_axes
from meshes.voxels.volume import VoxelVolume
from meshes.voxels.voxelise import voxelise

__all__ = ["CARIES_LABELS", "LabelledTooth", "labelled_tooth"]

CARIES_LABELS: Mapping[int, str] = {1: "caries", 2: "enamel", 3: "dentin"}
"""Labels of segmentations of decay in extracted teeth."""

_FINEST_DEFAULT_MM = 0.1
_CAVITY_M = 0.1e-3
_CAVITY_SAMPLES = 2
_SITE_POINTS = 200_000
_MOST_VOXELS = 4e8


@dataclass(frozen=True, eq=False)
class LabelledTooth:
    """A tooth of labels at a site, from which voxels of any size are made.

    Attributes
    ----------
    placed
        Its labels and their place.
    has_pulp
        Whether a label is the pulp.
    finest_mm
        Smallest side of the image's voxels [mm].
    sentences
        What was found in the image and done to it.
    """

    placed: PlacedLabels
    has_pulp: bool
    finest_mm: float
    sentences: tuple[str, ...]

    @cached_property
    def cavity(self) -> PulpCavity | None:
        """The cavity of the whole tooth, found in voxels of 0.1 mm; None where there is none."""
        return PulpCavity.of(resampled(self.placed, self.placed.corners, _CAVITY_M, most_samples=_CAVITY_SAMPLES))

    def at_lesion(self) -> LabelledTooth:
        """The same tooth with its site over its lesion, see `meshes.tooth.lesion_site.lesion_site`."""
        found = lesion_site(self.volume(resample_mm=1e3 * _CAVITY_M))
        turned = self.placed.rotation @ found.rotation
        origin = self.placed.origin + self.placed.rotation @ found.centre_m
        placed = replace(self.placed, origin=origin, rotation=turned)
        return replace(self, placed=placed, sentences=(*self.sentences, f"Site {found.confidence}."))

    def volume(
        self,
        *,
        resample_mm: float | None = None,
        region_m: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None,
        remark: Callable[[str], None] | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> VoxelVolume:
        """Voxels of the tooth in its site frame, its layers those of `meshes.tooth.layers.TOOTH_LAYERS`.

        Of the whole tooth fractions and layers come from sub-samples no farther apart than the image's voxels: the
        fraction is the part of them in any layer, the layer the commonest, of equal ones the first of `PRIORITY`. In a
        region they, and the distances, are those of the labels' interpolated shares: one surface whatever the voxels.
        Where no label is the pulp, the empty cavity in the dentin is taken as pulp.

        Parameters
        ----------
        resample_mm
            New voxel size [mm]; None: the image's, or 0.1 where that is finer.
        region_m
            Lowest and highest corner [m] in the site frame of what is wanted; None: the whole tooth. A voxel has the
            same content whatever region is asked for.
        remark
            Called with each sentence on what was assumed, found and dropped.
        progress
            Called with the part done, 0 to 1.

        Raises
        ------
        InputError
            If the voxels are too small or too large, or none lies in the tooth.
        """
        finest = require_positive("resample_mm", resample_mm, "use 0.1") if resample_mm is not None else None
        size = 1e-3 * (finest or max(self.finest_mm, _FINEST_DEFAULT_MM))
        corners = self.placed.corners
        _require_resolution(corners, size)
        if region_m is not None:
            corners = np.stack([np.maximum(corners[0], region_m[0]), np.minimum(corners[1], region_m[1])])
            if (corners[0] >= corners[1]).any():
                corners = self.placed.corners  # a refusal of a tool that misses names where the tooth lies
        _require_size(corners, size)
        if region_m is None:
            volume = resampled(self.placed, corners, size, progress=progress)
            if not self.has_pulp and self.cavity is not None:
                volume = with_pulp(volume, self.cavity.voxels(volume))
        else:
            volume = voxelise(self._anatomy(corners), spacing_m=size, region_m=(*corners,), progress=progress)
            if not volume.fraction.any():
                raise InputError(
                    "region",
                    "meet the tooth",
                    "one without any of it",
                    "move the tool to the tooth, or set anatomy.site",
                )
        notes = list(self.sentences)
        if not self.has_pulp and self.cavity is None:
            notes.append("No label for the pulp: its distance and exposure are unknown.")
        elif not self.has_pulp and self.cavity is not None:
            held = f"{1e9 * self.cavity.volume_m3:.3g} mm3"
            notes.append(f"No label for the pulp: the empty cavity of {held} in the dentin is taken as pulp.")
        if remark is not None:
            for sentence in notes:
                remark(sentence)
        return volume

    def _anatomy(self, corners: NDArray[np.float64]) -> Anatomy:
        """The tooth between two corners [m] as a function of position, its cavity filled."""
        labels, start, turn = self.placed.around(corners, REACH)
        if not self.has_pulp and self.cavity is not None:
            back = np.linalg.inv(turn)
            for plane, values in enumerate(labels):
                at = np.argwhere(values == EMPTY)
                index = np.column_stack([np.full(len(at), plane), at])
                values[tuple(at[self.cavity.holds(back @ (index - start).T)].T)] = PULP
        preference = [TOOTH_LAYERS.index(name) for name in PRIORITY]
        shares = LabelShares.of(labels, preference, voxel_m=self.placed.spacing, start=start, turn=turn)
        box = tuple(corners[0].tolist()), tuple(corners[1].tolist())
        shape, placement = Shape(shares.distance, *box), self.placed.placement
        return Anatomy("tooth", shape, TOOTH_LAYERS, shares.classify, sample=shares.sample, placement=placement)


def labelled_tooth(
    image: Image, *, labels: Mapping[int, str] = CARIES_LABELS, progress: Progress = silent
) -> LabelledTooth:
    """Check and place the labels of a tooth.

    The site's origin is where the tooth's long axis through the middle of the enamel leaves the tooth: the enamel, or a
    lesion open to the surface there. z points from the roots to the crown.

    Parameters
    ----------
    image
        Labels, 0 outside.
    labels
        Layer name by label.
    progress
        Called with what is being done and the share of it that is done (0 to 1).

    Raises
    ------
    InputError
        If labels are unknown, enamel or dentin is missing, or the size is no tooth's.
    """
    require_known(labels.values(), "labels")
    progress("naming the layers of the label volume", 0.0)
    named = layer_image(image.values, labels, image.source)
    require_known(named.counts, "labels")
    spacing_mm = np.array(image.spacing_mm)
    sides = spacing_mm * named.layer.shape
    longest = int(np.argmax(sides))
    given = f"{spacing_mm[longest]:g}"
    require_tooth_size(float(sides[longest]), "spacing_mm", given, named.layer.shape[longest])
    progress("placing the tooth by its enamel", 0.5)
    placed, note = _placed(named, 1e-3 * spacing_mm, 1e-3 * np.array(image.origin_mm))
    sentences = (*image.notes, *_sentences(image, named, note))
    return LabelledTooth(placed, "pulp" in named.counts, float(spacing_mm.min()), sentences)


def _placed(named: LayerImage, spacing: NDArray[np.float64], first_m: NDArray[np.float64]) -> tuple[PlacedLabels, str]:
    """The image with its site found, and how."""
    layer = np.ascontiguousarray(np.pad(named.layer, 1, constant_values=EMPTY))
    enamel = _points(layer == ENAMEL, spacing)
    axes = tooth_axes(enamel, _points((layer != ENAMEL) & (layer != EMPTY), spacing))
    first_m = first_m + spacing * (np.array(named.first) - 1)
    placed = PlacedLabels(layer, spacing, first_m, axes.middle_m, axes.rotation)
    reach = float(np.linalg.norm(spacing * layer.shape))
    heights = np.arange(-reach, reach, 0.25 * float(spacing.min()))
    on_axis = placed.on_plane(0.0, np.zeros(1), heights)[0]
    filled = np.flatnonzero(on_axis != EMPTY)
    if len(filled) == 0:
        raise InputError("labels", "fill the tooth's long axis", "none there", "check which label is the enamel")
    top = int(filled[-1])
    origin = axes.middle_m + heights[top] * axes.rotation[:, 2]
    return replace(placed, origin=origin), f"{axes.note}; origin on the {TOOTH_LAYERS[on_axis[top]]}"


def _points(flags: NDArray[np.bool_], spacing: NDArray[np.float64]) -> NDArray[np.float64]:
    """Centres of some of the flagged voxels [m], spread evenly, shape (n, 3)."""
    found = np.flatnonzero(flags)
    found = found[:: max(len(found) // _SITE_POINTS, 1)]
    return np.column_stack(np.unravel_index(found, flags.shape)) * spacing


def _sentences(image: Image, named: LayerImage, note: str) -> list[str]:
    """What was found in the image and done to it."""
    cube_mm3 = float(np.prod(image.spacing_mm))
    volumes = ", ".join(f"{name} {count * cube_mm3:.4g} mm3" for name, count in named.counts.items())
    sentences = [f"The labels of {image.source} hold {volumes}.", f"Long axis: {note}."]
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


def _require_size(corners: NDArray[np.float64], size: float) -> None:
    """Refuse too many voxels."""
    count = float(np.prod(np.ptp(corners, axis=0) / size))
    if count > _MOST_VOXELS:
        raise InputError(
            "resample_mm",
            f"leave at most {_MOST_VOXELS:.0e} voxels",
            f"{1e3 * size:g} which makes {count:.2g}",
            f"use {1e3 * size * (count / _MOST_VOXELS) ** (1 / 3):.2g} or more",
        )


def _require_resolution(corners: NDArray[np.float64], size: float) -> None:
    """Refuse voxels too large for the tooth."""
    sides = np.ptp(corners, axis=0)
    if sides.min() < 8.0 * size:
        raise InputError(
            "resample_mm",
            "leave eight voxels across the tooth",
            f"{1e3 * size:g} for {1e3 * sides.min():.3g} mm",
            "use 0.1",
        )
