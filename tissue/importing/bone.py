"""The bone that an import takes out of an image: cropped, by label or threshold, with its density."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from meshes.ct.density import DensityLaw
from meshes.ct.inspection import Histogram, Inspection, histogram_of, inspect
from meshes.ct.label_check import bone_label_note
from meshes.ct.labelled_bone import BoneOfImage, by_label, by_threshold, cropped
from meshes.ct.labels import Labels, on_grid_of, read_labels
from meshes.ct.laws import DENSITY_LAWS
from meshes.ct.threshold import Suggestion, suggest_threshold
from meshes.images.frame import Image
from meshes.images.reading import read_image
from meshes.surfaces.surface import Surface, surface_from_triangles
from tissue.importing.request import ImportRequest

__all__ = ["ImportedBone", "imported_bone"]

_SIDE_MM = (1.0, 1000.0)
"""Longest side of what can be a bone."""
_KEPT = 0.01
"""Difference of volume up to which a label's volume counts as kept."""
SHOWN_MM = 15.0
"""What pictures show around a bone."""


@dataclass(frozen=True, eq=False)
class ImportedBone:
    """A bone with its density, and what was found.

    Attributes
    ----------
    inspection, histogram
        Of the image, cropped where a crop was asked for.
    labels
        On the voxels of `bone.image`'s file; None without.
    suggestion
        The threshold that was suggested; None with a label.
    threshold
        The one that was used; None with a label.
    bone, around
        Its surface and the part of the image that holds it; that part with more around it, to be shown.
    surface
        Its triangles, closed.
    law, density
        The law of the density, and the density of each voxel [kg/m3]; None for an image of other units.
    certainty
        The law of the density in short, with its band; empty without density.
    sentences
        What a person should know.
    """

    inspection: Inspection
    histogram: Histogram
    labels: Labels | None
    suggestion: Suggestion | None
    threshold: float | None
    bone: BoneOfImage
    around: Image
    surface: Surface
    law: DensityLaw | None
    density: Image | None
    certainty: str
    sentences: tuple[str, ...]


def imported_bone(
    request: ImportRequest, law_of: Callable[[str, Image, Labels | None], DensityLaw], report: Progress
) -> ImportedBone:
    """Take the bone of a request out of its image.

    Parameters
    ----------
    law_of
        The law of the density, of what was asked for, the image and the labels.
    """
    report("reading the image", 0.0)
    with names_of_caller({"file": "source", "anatomy.spacing_mm": "spacing_mm"}):
        image = read_image(request.source, spacing_mm=request.spacing_mm, series=request.series)
    found, histogram = inspect(image), histogram_of(image.values)
    labels = None
    if request.labels is not None:
        report("reading the labels", 0.0)
        with names_of_caller({"file": "labels", "names": "label_names"}):
            labels = on_grid_of(
                read_labels(request.labels, names=request.label_names, spacing_mm=request.spacing_mm), image
            )
    sentences = [*image.notes, *found.sentences(), *(labels.image.notes if labels else ())]
    report("calibrating the density", 0.0)
    law = _law(request, image, labels, law_of, found, sentences)
    if request.box_mm is not None:
        image = cropped(image, request.box_mm)
        labels = labels and Labels(cropped(labels.image, request.box_mm), labels.names)
    suggestion, threshold = None, None
    report("finding the bone", 0.0)
    if labels is not None and request.region is not None:
        with names_of_caller({"label": "region"}):
            mask = labels.mask(request.region)
        if found.is_hounsfield and mask.any() and (note := bone_label_note(image, mask, request.region)):
            sentences.append(note)
        bone = by_label(image, mask)
        sentences.append(f"bone: label {request.region}, its steps smoothed{_kept_volume(bone)}")
    else:
        suggestion = suggest_threshold(histogram, is_hounsfield=found.is_hounsfield)
        threshold = suggestion.threshold if request.threshold is None else request.threshold
        bone = by_threshold(image, threshold)
        sentences.append(suggestion.note if request.threshold is None else f"threshold {threshold:g}, as given")
    surface = _surface(bone, found.source)
    sentences += [*bone.notes, f"bone of {bone.volume_mm3 * 1e-3:.4g} ml, {len(surface.faces)} triangles"]
    report("finding the density", 0.0)
    density, certainty = None, ""
    if law is not None:
        density, certainty = _density(bone, law)
        sentences.append(f"density by {certainty} ({law.source})")
    return ImportedBone(
        found,
        histogram,
        labels,
        suggestion,
        threshold,
        bone,
        _around(image, surface),
        surface,
        law,
        density,
        certainty,
        tuple(sentences),
    )


def _kept_volume(bone: BoneOfImage) -> str:
    """How the volume within the surface differs from that of the label, in words."""
    change = bone.volume_mm3 / bone.label_mm3 - 1.0
    if abs(change) <= _KEPT:
        return f" and its volume of {1e-3 * bone.label_mm3:.4g} ml kept to {_KEPT:.0%}"
    more = "more" if change > 0.0 else "less"
    return f"; the surface encloses {abs(change):.1%} {more} than the label's volume of {1e-3 * bone.label_mm3:.4g} ml"


def _around(image: Image, surface: Surface) -> Image:
    """The part of an image around a surface."""
    low, high = 1e3 * surface.vertices_m.min(axis=0) - SHOWN_MM, 1e3 * surface.vertices_m.max(axis=0) + SHOWN_MM
    return cropped(image, ((low[0], low[1], low[2]), (high[0], high[1], high[2])))


def _surface(bone: BoneOfImage, source: str) -> Surface:
    """The triangles of a bone, closed and turned outward."""
    vertices, faces = bone.triangles
    longest = float(np.ptp(vertices, axis=0).max())
    if not _SIDE_MM[0] <= longest <= _SIDE_MM[1]:
        raise InputError(
            f"the bone must be {_SIDE_MM[0]:g} to {_SIDE_MM[1]:g} mm long, got {longest:.4g} mm in {source}: check the "
            "spacing in the image's header"
        )
    surface = surface_from_triangles(vertices, faces, source="bone.ply", scale_mm=1.0, cut_off=True)
    return replace(surface, caps_m=surface.caps_m + bone.cuts)


def _law(
    request: ImportRequest,
    image: Image,
    labels: Labels | None,
    law_of: Callable[[str, Image, Labels | None], DensityLaw],
    found: Inspection,
    sentences: list[str],
) -> DensityLaw | None:
    """The law of the density, from the whole image; none for an image of other units, of which density is unknown."""
    named = request.density.strip().lower()
    if not found.is_hounsfield and (named == "internal" or named in DENSITY_LAWS):
        raise InputError(
            f"density must be line:SLOPE,OFFSET for an image that is not in Hounsfield units, got {request.density} "
            f"for {found.source} with values from {found.lowest:g} to {found.highest:g}: give the line of your "
            "scanner, or leave it out"
        )
    if not found.is_hounsfield and request.density == "auto":
        sentences.append(
            "density: unknown, for the values are not Hounsfield units; the bone gets a shell of even thickness. "
            "Give --density line:SLOPE,OFFSET to use them"
        )
        return None
    return law_of(request.density, image, labels)


def _density(bone: BoneOfImage, law: DensityLaw) -> tuple[Image, str]:
    """The density of the bone's voxels, and its law in short with the band of its median."""
    density = bone.density(law)
    held = density.values[bone.field > bone.level]  # beyond the surface it goes on, to be interpolated
    middle = float(np.median(held))
    low, high = law.band(np.array([(middle - law.offset_kg_m3) / law.slope_kg_m3]))
    certainty = (
        f"{law.name}: median {middle:.0f} kg/m3, 90 % between {low[0]:.0f} and {high[0]:.0f}; least {held.min():.0f}, "
        f"greatest {held.max():.0f}"
    )
    return density, certainty
