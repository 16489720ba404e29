"""Conversion of a bone in a CT to a scene.

The bone is cropped, and selected by a label or a threshold. The scene contains the density of the
bone, the site (the place where the tool works) and the surroundings.
"""

from collections.abc import Mapping
from dataclasses import replace
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
from tissue.ct.request import ImportRequest, Placed, import_path, kept_clear, placed
from tissue.scene.load import load_scene
from tissue.scene.tool import Tool
from tissue.show.figures.ct_pictures import (
    Marks,
    draw_ct_bone,
    draw_ct_histogram,
    draw_ct_slices,
    draw_path_depth,
    mesh_of,
)

_SIDE_MM = (1.0, 1000.0)
"""Plausible range of the longest side of a bone [mm].

Outside this range, the unit of the spacing in the header is assumed to be wrong.
"""
SHOWN_MM = 15.0
"""Width of the surroundings in pictures [mm], in which the other bone of a joint is visible."""
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
"""Default motion at sites not in `USUAL`: a ball burr moves 2 mm into the bone along the normal.

The feed per tooth of 0.5 um is far below 0.1 mm, the upper limit of the cutting law
(`docs/models.md`). With voxels of 0.2 mm, the radius of the burr is ten voxels.
"""
HOLE = ("guide_hole_diameter_mm", "guide_hole_depth_mm")
HEAD = ("duration_s", "seed")
TABLES = ("voxels", "tool", "motion", "cutting", "output", "device", "fidelity")
REMARKS = {
    "file": "mm, in the frame of the image (LPS)",
    "density_file": "apparent density, kg/m3",
    "centre_mm": "site in mm, in the frame of the image (LPS); origin of the motion",
    "normal": "z axis of the site, out of the bone",
    "along": "x axis of the site",
}


class _BoneImport:
    """Import of a bone. The method `draft` sets the attributes one after the other.

    Attributes
    ----------
    request
        Options of the import.
    image, labels
        Cropped image and labels; `labels` is None without labels.
    inspection, histogram
        Properties of the whole image. A threshold needs air and soft tissue, which a crop may not
        contain.
    law
        Density law; None if the image does not allow one.
    bone, threshold
        The bone; and the grey value above which a voxel is bone, None with labels.
    surface, density
        Surface of the bone, and its apparent density [kg/m3] or None.
    clear
        Structures to keep clear of, keyed by their names in the scene.
    at, path
        Site and toolpath. Each is None if the import has no site or no toolpath.
    sentences
        Findings and assumptions for the user.
    """

    labels: Labels | None = None
    threshold: float | None = None
    density: Image | None = None

    def __init__(self, request: ImportRequest) -> None:
        self.request = request
        self.sentences: list[str] = []

    def draft(self, name: str, progress: Progress) -> Draft:
        """Create the content of the output folder for a scene called `name`."""
        request = self.request
        self._read(progress)
        progress("finding the bone", 0.0)
        self._find_bone()
        bone = self.bone
        self.surface = _surface(bone, self.inspection.source)
        self.sentences += [
            *bone.notes,
            f"bone of {bone.volume_mm3 * 1e-3:.4g} ml, {len(self.surface.faces)} triangles",
        ]
        files: dict[str, Writer] = {"bone.ply": partial(write_surface, self.surface)}
        anatomy: dict[str, Any] = {"kind": "bone", "file": "bone.ply"}
        if self.law is not None:
            progress("finding the density", 0.0)
            self.density = bone.density(self.law)
            certainty = _certainty(bone, self.density, self.law)
            self.sentences.append(f"density by {certainty} ({self.law.source})")
            files["density.nrrd"] = partial(write_density, self.density, law=certainty)
            anatomy["density_file"] = "density.nrrd"
        # the user's labels are resampled to the voxels of the bone
        if self.labels is not None:
            blank = replace(bone.image, values=np.zeros(bone.image.values.shape, np.uint8))
            files["labels.seg.nrrd"] = partial(write_labels, on_grid_of(self.labels, blank))
        self.clear, kept = kept_clear(request, self.labels, progress)
        kept_files = {each: f"keep_clear_{each}.ply" for each in self.clear}
        for each, structure in self.clear.items():
            files[kept_files[each]] = partial(write_surface, structure)
        progress("finding the site", 0.0)
        self.at, sentence = placed(request, self.surface)
        self.sentences += [sentence, *kept]
        self.path = import_path(request, self.at, self.surface)
        if self.path is not None:
            self.sentences.append(self.path.sentence)
            files["path.csv"] = self.path.table.write
        scene = _scene_text(
            {
                "name": name,
                "description": f"{request.region or 'bone'} of {self.inspection.source}",
            },
            anatomy | {"scale_mm": 1.0},
            self.at,
            _followed(request.like, self.at, replay=self.path is not None),
            {"keep_clear": {"files": kept_files}} if kept_files else {},
        )
        has_site = self.at is not None
        return Draft(scene, self._record(), files | self._pictures(), self.sentences, has_site)

    def _read(self, progress: Progress) -> None:
        """Read and inspect the image and the labels, and calibrate the density."""
        request = self.request
        progress("reading the image", 0.0)
        image = request.read_image()
        self.inspection = inspect(image)
        self.sentences += [*image.notes, *self.inspection.sentences()]
        if request.labels is not None:
            progress("reading the labels", 0.0)
            self.labels = request.read_labels(image)
            self.sentences += self.labels.image.notes
        progress("calibrating the density", 0.0)
        self.law = _law(request.density.strip(), image, self.inspection)
        if self.law is None:
            self.sentences.append(
                "density: unknown, because the values are not Hounsfield units. The bone gets a "
                "cortical shell of constant thickness. To use the values, give --density "
                "line:SLOPE,OFFSET"
            )
        self.histogram = histogram_of(image.values)
        if (box := request.box_mm) is not None:
            with names_of_caller({"crop": "crop_mm"}):
                image = cropped(image, box, stated_in=request.coordinates)
            if self.labels is not None:
                self.labels = replace(self.labels, image=cropped(self.labels.image, box))
        self.image = image

    def _find_bone(self) -> None:
        """Extract the bone from the image by its label, or by a threshold."""
        region = self.request.region
        is_hounsfield = self.inspection.is_hounsfield
        if self.labels is None or region is None:
            threshold, note = suggest_threshold(self.histogram, is_hounsfield=is_hounsfield)
            # a threshold given by the user replaces the suggested threshold
            if self.request.threshold is not None:
                threshold = self.request.threshold
                note = f"threshold {threshold:g}, as given"
            self.bone = by_threshold(self.image, threshold)
            self.threshold = threshold
            self.sentences.append(note)
            return
        with names_of_caller({"label": "region"}):
            mask = self.labels.mask(region)
        if is_hounsfield and mask.any():
            note = bone_label_note(self.image, mask, region)
            self.sentences += [note] if note else []
        self.bone = bone = by_label(self.image, mask)
        self.sentences.append(
            f"bone: {region} of the labels, its steps smoothed; volume "
            f"{bone.volume_mm3 / bone.label_mm3 - 1.0:+.1%} against {1e-3 * bone.label_mm3:.4g} ml "
            "of the label"
        )

    def _record(self) -> dict[str, Any]:
        """Return the results as plain numbers."""
        found = self.inspection
        site = None
        if self.at is not None:
            site = {
                "kind": self.at.kind,
                "centre_mm": (1e3 * self.at.site.centre_m).tolist(),
                "rotation": self.at.site.rotation.tolist(),
            }
        return {
            "source": found.source,
            "voxels": list(found.shape),
            "spacing_mm": list(found.spacing_mm),
            "low_mm": list(found.low_mm),
            "high_mm": list(found.high_mm),
            "noise_HU": found.noise,
            "metal_mm3": found.metal_mm3,
            "density_law": None if self.law is None else self.law.as_dict(),
            "site": site,
            "threshold": self.threshold,
            "bone_mm3": self.bone.volume_mm3,
        }

    def _pictures(self) -> dict[str, Writer]:
        """Return functions that draw pictures of the bone with its site, path and surroundings."""
        title = self.inspection.source
        vertices_mm = 1e3 * self.surface.vertices_m
        low_mm = vertices_mm.min(axis=0)
        high_mm = vertices_mm.max(axis=0)
        # without a site, the slices go through the middle of the bone
        marks = Marks(0.5 * (low_mm + high_mm))
        if self.at is not None:
            marks = Marks(1e3 * self.at.site.centre_m, self.at.site.rotation[:, 2])
        if self.path is not None:
            marks = replace(marks, points_mm=self.path.depth.points_mm)
        outlines = {"bone": self.surface}
        outlines |= {f"{each}, to keep clear of": found for each, found in self.clear.items()}
        box_mm = tuple((low_mm - SHOWN_MM).tolist()), tuple((high_mm + SHOWN_MM).tolist())
        around = cropped(self.image, box_mm)
        inside = self.bone.image.values[self.bone.field > self.bone.level]

        def draw_slices(file: Path) -> None:
            """Draw slices of the CT with the outlines of the bone and of its surroundings."""
            meshes = {
                each: mesh_of(1e3 * found.vertices_m, found.faces)
                for each, found in outlines.items()
            }
            draw_ct_slices(around, file, meshes, marks)

        pictures: dict[str, Writer] = {
            "slices.png": draw_slices,
            "histogram.png": lambda file: draw_ct_histogram(
                self.histogram, inside, file, threshold=self.threshold, law=self.law, title=title
            ),
            "bone.png": lambda file: draw_ct_bone(
                self.surface, file, marks, density=self.density, title=title
            ),
        }
        if self.path is not None:
            pictures["path.png"] = partial(draw_path_depth, self.path.depth, title=title)
        return pictures


def bone_draft(request: ImportRequest, name: str, progress: Progress) -> Draft:
    """Create the content of the output folder (`Draft`) for a scene with a bone.

    Raises
    ------
    InputError
        If the image or an option cannot be used. The notes of the error then contain the findings
        so far.
    """
    found = _BoneImport(request)
    try:
        return found.draft(name, progress)
    except InputError as error:
        for sentence in found.sentences:
            error.add_note(sentence)
        raise


def _law(text: str, image: Image, found: Inspection) -> DensityLaw | None:
    """Return the density law that the text of an import option names.

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

    The range of densities excludes voxels at the surface, because the densities of these voxels are
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
    """Return the top-level keys and the tables of the scene that provides tool and motion.

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
                "like",
                "be a scene in which a tool cuts",
                like,
                "use for example milling or glenoid",
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
