"""Conversion of a bone in a CT to a scene.

The bone is cropped, and selected by a label or a threshold. The scene contains its density, its
site (the place where the tool works) and its surroundings.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from meshes.ct.calibration import density_law
from meshes.ct.density import CT_DENSITY, DENSITY_LAWS, DensityLaw
from meshes.ct.extraction import BoneOfImage, by_label, by_threshold, cropped
from meshes.ct.inspection import (
    Histogram,
    Inspection,
    bone_label_note,
    histogram_of,
    inspect,
    suggest_threshold,
)
from meshes.ct.labels import Labels, on_grid_of
from meshes.images.frame import Image
from meshes.surfaces.surface import Surface, surface_from_triangles
from tissue.ct.draft import (
    Draft,
    Writer,
    scene_tables,
    toml,
    write_density,
    write_labels,
    write_surface,
)
from tissue.ct.request import ImportedPath, ImportRequest, Placed, import_path, kept_clear, placed
from tissue.scene.load import load_scene
from tissue.scene.tool import Tool
from tissue.show.figures.ct_pictures import (
    Marks,
    depth_below,
    draw_ct_bone,
    draw_ct_histogram,
    draw_ct_slices,
    draw_path_depth,
)

__all__ = ["bone_draft"]

_SIDE_MM = (1.0, 1000.0)
"""Plausible range of the longest side of a bone.

Outside this range, the unit of the spacing in the header is assumed to be wrong.
"""
SHOWN_MM = 15.0
"""Width of the surroundings shown in pictures, so that the other bone of a joint is visible."""
USUAL = {
    "glenoid": "glenoid",
    "vertebra": "pedicle",
    "vertebra:left": "pedicle",
    "vertebra:right": "pedicle",
}
"""Default scene that provides tool and motion, by kind of the site."""
PLUNGE: Mapping[str, Mapping[str, object]] = {
    "voxels": {"spacing_mm": 0.2},
    "tool": {"kind": "ball-burr", "diameter_mm": 4.0, "flutes": 6, "spin_rpm": 20000.0},
    "motion": {"kind": "path", "points_mm": [[0, 0, 3], [0, 0, -2]], "feed_mm_s": 1.0},
}
"""Default motion at other sites: a ball burr moves 2 mm into the bone along the normal.

The feed per tooth of 0.5 um is far below 0.1 mm, the upper limit of the cutting law
(`docs/models.md`). With voxels of 0.2 mm, the radius of the burr is ten voxels.
"""
HOLE = ("guide_hole_diameter_mm", "guide_hole_depth_mm")
HEAD = ("duration_s", "seed")
TABLES = ("voxels", "tool", "motion", "cutting", "output", "device", "fidelity")
REMARKS = {
    "file": "mm, in the frame of the image (LPS)",
    "density_file": "apparent density, kg/m3",
    "centre_mm": "the site, mm in the frame of the image (LPS); the motion is given from there",
    "normal": "out of the bone: the site's z",
    "along": "the site's x",
}


@dataclass(frozen=True, eq=False)
class _Source:
    """Cropped image and labels of a bone, and results of the inspection of the whole image."""

    image: Image
    labels: Labels | None
    inspection: Inspection
    histogram: Histogram
    law: DensityLaw | None


def bone_draft(request: ImportRequest, name: str, progress: Progress) -> Draft:
    """Create the content of the output folder (`Draft`) for a scene with a bone.

    Raises
    ------
    InputError
        If the image or an option cannot be used. The error then has the findings so far as notes.
    """
    source, sentences = _source(request, progress)
    try:
        return _draft(request, name, progress, (source, sentences))
    except InputError as error:
        for sentence in sentences:
            error.add_note(sentence)
        raise


def _draft(
    request: ImportRequest,
    name: str,
    progress: Progress,
    inspected: tuple[_Source, list[str]],
) -> Draft:
    """Create the draft from an inspected image, and append findings to the given sentences."""
    source, sentences = inspected
    progress("finding the bone", 0.0)
    bone, threshold, found = _bone(request, source)
    surface = _surface(bone, source.inspection.source)
    sentences += [
        *found,
        *bone.notes,
        f"bone of {bone.volume_mm3 * 1e-3:.4g} ml, {len(surface.faces)} triangles",
    ]
    files: dict[str, Writer] = {"bone.ply": partial(write_surface, surface)}
    tables: dict[str, Any] = {"kind": "bone", "file": "bone.ply"}
    density = None
    if source.law is not None:
        progress("finding the density", 0.0)
        density = bone.density(source.law)
        certainty = _certainty(bone, density, source.law)
        sentences.append(f"density by {certainty} ({source.law.source})")
        files["density.nrrd"] = partial(write_density, density, law=certainty)
        tables["density_file"] = "density.nrrd"
    # the user's labels are resampled to the voxels of the bone
    if source.labels is not None:
        blank = replace(bone.image, values=np.zeros(bone.image.values.shape, np.uint8))
        files["labels.seg.nrrd"] = partial(write_labels, on_grid_of(source.labels, blank))
    clear, kept = kept_clear(request, source.labels, progress)
    kept_files = {each: f"keep_clear_{each}.ply" for each in clear}
    files |= {
        kept_files[each]: partial(write_surface, structure) for each, structure in clear.items()
    }
    progress("finding the site", 0.0)
    at, sentence = placed(request, surface)
    sentences += [sentence, *kept]
    path = import_path(request, at, surface)
    if path is not None:
        sentences.append(path.sentence)
        files["path.csv"] = path.table.write
    files |= _pictures(source, bone, surface, clear, (at, path), (threshold, density))
    scene = _scene_text(
        {"name": name, "description": f"{request.region or 'bone'} of {source.inspection.source}"},
        tables | {"scale_mm": 1.0},
        at,
        _followed(request.like, at, replay=path is not None),
        {"keep_clear": {"files": kept_files}} if clear else {},
    )
    record = _record(source, at) | {"threshold": threshold, "bone_mm3": bone.volume_mm3}
    return Draft(scene, record, files, sentences, has_site=at is not None)


def _source(request: ImportRequest, progress: Progress) -> tuple[_Source, list[str]]:
    """Read and inspect the image and the labels, and calibrate the density."""
    progress("reading the image", 0.0)
    image = request.read_image()
    found = inspect(image)
    labels = None
    if request.labels is not None:
        progress("reading the labels", 0.0)
        labels = request.read_labels(image)
    sentences = [*image.notes, *found.sentences(), *(labels.image.notes if labels else ())]
    progress("calibrating the density", 0.0)
    law = _law(request.density.strip(), image, found)
    if law is None:
        sentences.append(
            "density: unknown, for the values are not Hounsfield units; the bone gets a "
            "shell of even thickness. "
            "Give --density line:SLOPE,OFFSET to use them"
        )
    # inspect the whole image, because a threshold needs air and soft tissue, which a crop may not
    # contain
    histogram = histogram_of(image.values)
    box = request.box_mm
    if box is not None:
        with names_of_caller({"crop": "crop_mm"}):
            image = cropped(image, box)
        labels = labels and replace(labels, image=cropped(labels.image, box))
    return _Source(image, labels, found, histogram, law), sentences


def _law(text: str, image: Image, found: Inspection) -> DensityLaw | None:
    """Return the density law that a request names.

    The default is the first density law that the image allows. The result is None if the image does
    not allow any law.
    """
    is_auto = text == "auto"
    if not found.is_hounsfield:
        if is_auto:
            return None
        # these laws need Hounsfield units; a line given by the user may use any values
        if text.lower() == "internal" or text.lower() in DENSITY_LAWS:
            raise InputError(
                "density",
                "be line:SLOPE,OFFSET for an image that is not in Hounsfield units",
                f"{text} for {found.source} with values from {found.lowest:g} to {found.highest:g}",
                "give the line of your scanner, or leave density out",
            )
    try:
        return density_law("internal" if is_auto else text, image)
    except InputError as error:
        # the user has requested this calibration; only the default may use the line of another
        # scanner instead
        if not is_auto:
            raise
        return replace(
            CT_DENSITY, source=f"{CT_DENSITY.source}; no calibration within the image: {error}"
        )


def _bone(request: ImportRequest, source: _Source) -> tuple[BoneOfImage, float | None, list[str]]:
    """Extract the bone from the image.

    Return the bone, its threshold if it has one, and sentences.
    """
    if source.labels is None or request.region is None:
        threshold, note = suggest_threshold(
            source.histogram, is_hounsfield=source.inspection.is_hounsfield
        )
        # a threshold given by the user replaces the suggested threshold
        if request.threshold is not None:
            threshold = request.threshold
            note = f"threshold {threshold:g}, as given"
        return by_threshold(source.image, threshold), threshold, [note]
    with names_of_caller({"label": "region"}):
        mask = source.labels.mask(request.region)
    sentences = []
    if source.inspection.is_hounsfield and mask.any():
        note = bone_label_note(source.image, mask, request.region)
        sentences += [note] if note else []
    bone = by_label(source.image, mask)
    sentences.append(
        f"bone: {request.region} of the labels, its steps smoothed; volume "
        f"{bone.volume_mm3 / bone.label_mm3 - 1.0:+.1%} against {1e-3 * bone.label_mm3:.4g} ml of "
        "the label"
    )
    return bone, None, sentences


def _surface(bone: BoneOfImage, source: str) -> Surface:
    """Return the surface of a bone as closed triangles with outward normals."""
    vertices, faces = bone.triangles
    longest = float(np.ptp(vertices, axis=0).max())
    if not _SIDE_MM[0] <= longest <= _SIDE_MM[1]:
        raise InputError(
            "the bone",
            f"be {_SIDE_MM[0]:g} to {_SIDE_MM[1]:g} mm long",
            f"{longest:.4g} mm in {source}",
            "check the spacing in the image's header",
        )
    surface = surface_from_triangles(vertices, faces, source=source, scale_mm=1.0, cut_off=True)
    return replace(surface, caps_m=surface.caps_m + bone.cuts)


def _certainty(bone: BoneOfImage, density: Image, law: DensityLaw) -> str:
    """Describe the density law briefly, with the uncertainty band of the bone's median density.

    The range of densities leaves out the voxels at the surface, because their densities are
    corrected for the soft tissue in them.
    """
    from scipy.ndimage import minimum_filter

    inside = bone.field > bone.level  # the density extends beyond the surface
    middle = float(np.median(density.values[inside]))
    low, high = law.band(np.array([(middle - law.offset_kg_m3) / law.slope_kg_m3]))
    text = f"{law.name}: median {middle:.0f} kg/m3"
    if high[0] > low[0]:
        text += f", 90 % between {low[0]:.0f} and {high[0]:.0f} by the uncertainty of the law"
    below = density.values[minimum_filter(inside, 3)]
    if below.size:
        text += f"; voxels below the surface from {below.min():.0f} to {below.max():.0f}"
    return text


def _followed(like: str | None, at: Placed | None, *, replay: bool) -> dict[str, Any]:
    """Return the head and the tables of the scene that provides tool and motion.

    A guide hole is returned under ``anatomy``.
    """
    wanted = like or USUAL.get((at.kind if at else None) or "")
    # no scene is available for the site, so the tool moves into the bone along the site's normal
    if wanted is None:
        tables: dict[str, Any] = dict(PLUNGE)
    else:
        scene = load_scene(wanted)
        if not isinstance(scene.tool, Tool):
            raise InputError(
                "like", "be a scene in which a tool cuts", like, "use milling or glenoid"
            )
        tables = scene_tables(scene, (*HEAD, *TABLES, "anatomy"))
        tables["anatomy"] = {key: value for key, value in tables["anatomy"].items() if key in HOLE}
    if replay:
        tables["motion"] = {"kind": "replay", "file": "path.csv"}
        # a replay has the duration of its path
        tables.pop("duration_s", None)
    return tables


def _scene_text(
    head: dict[str, Any],
    anatomy: dict[str, Any],
    at: Placed | None,
    followed: dict[str, Any],
    keep_clear: dict[str, Any],
) -> str:
    """Return the TOML text of the scene.

    The text has comments on settings that users may want to change.
    """
    head |= {key: followed.pop(key) for key in HEAD if key in followed}
    if at is not None:
        anatomy |= {
            # positions are rounded to 1 um and directions to 1e-6, far below the spacing of any CT
            "centre_mm": [round(value, 3) for value in (1e3 * at.site.centre_m).tolist()],
            "normal": [round(value, 6) for value in at.site.rotation[:, 2].tolist()],
            "along": [round(value, 6) for value in at.site.rotation[:, 0].tolist()],
        }
        # the radius marks the joint's surface in a density map; it has no effect without this map
        if "density_file" in anatomy and at.articular_radius_mm:
            anatomy["articular_radius_mm"] = at.articular_radius_mm
    anatomy |= followed.pop("anatomy", {})
    lines = toml({"anatomy": anatomy}).splitlines()
    for number, line in enumerate(lines):
        remark = REMARKS.get(line.partition(" = ")[0])
        if remark is not None:
            lines[number] = f"{line}  # {remark}"
    text = "\n".join([toml(head), *lines, "", toml(keep_clear | followed)])
    if at is None:
        return (
            "# No site yet: pick one by `tissue view` of this folder, or write "
            f"anatomy.centre_mm and normal.\n{text}"
        )
    return text


def _record(source: _Source, at: Placed | None) -> dict[str, Any]:
    """Return the results of the inspection as plain numbers."""
    found = source.inspection
    site = None
    if at is not None:
        site = {
            "kind": at.kind,
            "centre_mm": (1e3 * at.site.centre_m).tolist(),
            "rotation": at.site.rotation.tolist(),
        }
    return {
        "source": found.source,
        "voxels": list(found.shape),
        "spacing_mm": list(found.spacing_mm),
        "low_mm": list(found.low_mm),
        "high_mm": list(found.high_mm),
        "noise_HU": found.noise,
        "metal_mm3": found.metal_mm3,
        "density_law": None if source.law is None else source.law.as_dict(),
        "site": site,
    }


def _pictures(
    source: _Source,
    bone: BoneOfImage,
    surface: Surface,
    clear: Mapping[str, Surface],
    work: tuple[Placed | None, ImportedPath | None],
    found: tuple[float | None, Image | None],
) -> dict[str, Writer]:
    """Return functions that draw pictures of a bone with its site, path and surroundings.

    `work` contains the site and the path, and `found` the threshold and the density of the bone.
    """
    at, path = work
    threshold, density = found
    title = source.inspection.source
    low_mm = 1e3 * surface.vertices_m.min(axis=0)
    high_mm = 1e3 * surface.vertices_m.max(axis=0)
    normal = None if at is None else at.site.rotation[:, 2]
    points_mm = None if path is None else path.depth.points_mm
    centre_mm = None if at is None else 1e3 * at.site.centre_m
    marks = Marks(centre_mm, normal, points_mm)
    low = tuple((low_mm - SHOWN_MM).tolist())
    high = tuple((high_mm + SHOWN_MM).tolist())
    around = cropped(source.image, (low, high))

    def draw_slices(file: Path) -> None:
        """Draw slices of the CT with the outlines of the bone and of its surroundings."""
        depth = replace(bone.image, values=bone.field - np.float32(bone.level))
        outlines = {"bone": depth}
        for name, structure in clear.items():
            outlines[f"{name}, to keep clear of"] = depth_below(
                structure.vertices_m, structure.faces, bone.image
            )
        middle_mm = 0.5 * (low_mm + high_mm)
        # without a site, the slices go through the middle of the bone
        around_site = marks if centre_mm is not None else replace(marks, centre_mm=middle_mm)
        draw_ct_slices(around, file, outlines, around_site)

    def draw_histogram(file: Path) -> None:
        """Draw the histograms of the image and of the bone."""
        draw_ct_histogram(
            source.histogram,
            bone.image.values[bone.field > bone.level],
            file,
            threshold=threshold,
            law=source.law,
            title=title,
        )

    pictures: dict[str, Writer] = {
        "slices.png": draw_slices,
        "histogram.png": draw_histogram,
        "bone.png": lambda file: draw_ct_bone(surface, file, marks, density=density, title=title),
    }
    # the view of the path is along the site's normal
    if path is not None and normal is not None:
        pictures["path.png"] = lambda file: draw_path_depth(
            surface, path.depth, file, normal=normal
        )
    return pictures
