"""Conversion of segmented teeth and soft organs to scenes.

A tooth is cut by a bur. A soft organ is meshed with tetrahedra and pressed by a ball. It may have
parts with their own moduli.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array, box_of
from meshes.base.errors import InputError, enumerated, names_of_caller
from meshes.base.progress import Progress
from meshes.ct.extraction import cropped
from meshes.ct.inspection import bone_label_note, inspect, soft_label_note
from meshes.ct.labels import Labels, on_grid_of
from meshes.images.frame import Image
from meshes.organs.from_labels import organ_mesh
from meshes.tets.tetrahedra import write_organ
from meshes.tooth.layers import TOOTH_LAYERS
from tissue.ct.draft import Draft, Writer, scene_tables, toml, write_labels
from tissue.ct.request import ImportRequest
from tissue.scene.load import load_scene
from tissue.show.figures.ct_pictures import (
    Marks,
    draw_ct_organ,
    draw_ct_slices,
    middle_of,
    outline_of,
)

LIKE = "caries"
"""Scene that provides tool and motion for a tooth by default."""
PARTS = ("voxels", "tool", "motion", "cutting", "output", "duration_s", "device")
MARGIN = 3
"""Margin around the tooth [voxel].

The margin is needed for closed outlines, and it shows the surroundings in pictures.
"""
FRONT = (0.0, -1.0, 0.0)
"""Direction from an organ to the tool, in LPS: towards the front of a patient on their back."""
BALL_MM = 12.0
DEPTH_MM = 4.0
FEED_MM_S = 5.0
"""Feed of the ball in the default press on an organ [mm/s].

`BALL_MM` is the diameter of the ball, and `DEPTH_MM` is the depth of the press. The depth is 0.67
times the radius of the ball. At this depth, the force of the linear model has an error of more than
10 % (`tissue.models.organ.model.LINEAR_ERROR`), and the run reports this error. At a depth of 2.0
mm the error is 5 %.
"""


def tooth_draft(request: ImportRequest, name: str, progress: Progress) -> Draft:
    """Create the content of the output folder (`Draft`) for a scene with a tooth."""
    progress("reading the labels", 0.0)
    labels = request.read_labels()
    image = labels.image
    sentences = list(image.notes)
    # without a CT, the segmentation is also the image, and no series can be chosen
    if request.labels is not None and request.source.resolve() == request.labels.resolve():
        if request.series is not None:
            raise InputError(
                "series",
                "be left out if the labels are the source",
                request.series,
                "remove it",
            )
    else:
        image = request.read_image()
        with names_of_caller({"region": "labels"}):
            note = _enamel_note(image, labels)
        sentences = [*image.notes, *sentences, *note]
    tooth = _tooth(labels)
    middle, sentence = _site(tooth, at_lesion=request.site == "tooth:lesion")
    sentences += [f"tooth: {', '.join(tooth.names.values())}", sentence]
    scene = {
        "name": name,
        "description": f"tooth of {tooth.image.source}",
        "anatomy": {
            "kind": "molar",
            "file": "tooth.seg.nrrd",
            "site": "caries" if request.site == "tooth:lesion" else "enamel",
        },
        **scene_tables(load_scene(request.like or LIKE), PARTS),
    }
    voxel_mm3 = tooth.image.voxel_mm3
    record = {
        "source": tooth.image.source,
        "volume_mm3": {
            each: voxel_mm3 * int(tooth.mask(each).sum()) for each in tooth.names.values()
        },
    }
    files: dict[str, Writer] = {
        "tooth.seg.nrrd": partial(write_labels, tooth),
        "slices.png": partial(_draw_tooth, image, tooth, middle),
    }
    return Draft(toml(scene), record, files, sentences)


def _enamel_note(image: Image, labels: Labels) -> list[str]:
    """Return a warning if the enamel does not lie on bright voxels.

    Raise an error if the labels do not belong to this image.
    """
    placed = on_grid_of(labels, image)
    # the lower limit of the brightness of enamel is known only in Hounsfield units
    if "enamel" not in placed.names.values() or not inspect(image).is_hounsfield:
        return []
    note = bone_label_note(image, placed.mask("enamel"), "enamel")
    return [note] if note else []


def _tooth(labels: Labels) -> Labels:
    """Return the labels of a tooth without other labels, cropped to the tooth."""
    layers = {number: name for number, name in labels.names.items() if name in TOOTH_LAYERS}
    for name in ("enamel", "dentin"):
        if name not in layers.values():
            # name only some labels, because a segmentation may have a hundred
            held = enumerated(list(labels.names.values())[:12])
            raise InputError(
                "labels",
                "contain the labels enamel and dentin for a tooth",
                f"{held} in {labels.image.source}",
                f"give the labels names such as {enumerated(TOOTH_LAYERS)} by --label-names FILE",
            )
    chosen = labels.only(layers.values())
    return replace(chosen, image=chosen.image.part(box_of(chosen.image.values > 0, MARGIN)))


def _site(tooth: Labels, *, at_lesion: bool) -> tuple[Array, str]:
    """Return the centre [mm, LPS] of the largest lesion or of the tooth, and a message on it."""
    from scipy.ndimage import label

    image = tooth.image
    if not at_lesion:
        return middle_of(
            image, image.values > 0
        ), "site: where the tooth's long axis leaves the enamel"
    if "caries" not in tooth.names.values():
        raise InputError(
            "site",
            "not be tooth:lesion for a tooth without a label caries",
            f"tooth:lesion for {image.source}",
            "use --site tooth",
        )
    pieces, _ = label(tooth.mask("caries"))
    counts = np.bincount(pieces.ravel())[1:]
    middle = middle_of(image, pieces == 1 + int(np.argmax(counts)))
    sizes = np.sort(counts)[::-1]
    second = (
        f"the second lesion has {sizes[1] / sizes[0]:.1%} of its volume"
        if len(sizes) > 1
        else "there is no other"
    )
    return (
        middle,
        f"site: over the largest lesion, {sizes[0] * image.voxel_mm3:.3g} mm3; {second}",
    )


def _draw_tooth(image: Image, tooth: Labels, centre_mm: Array, file: Path) -> None:
    """Draw slices through a point [mm, LPS] of an image, with the layers of a tooth."""
    low = np.array(tooth.image.origin_mm)
    high = low + tooth.image.spacing_mm * (np.array(tooth.image.values.shape) - 1)
    masks = sorted(
        ((name, tooth.mask(name)) for name in tooth.names.values()), key=lambda each: -each[1].sum()
    )
    outlines = {name: outline_of(tooth.image, mask) for name, mask in masks}
    draw_ct_slices(
        cropped(image, (tuple(low.tolist()), tuple(high.tolist()))),
        file,
        outlines,
        Marks(centre_mm),
    )


def organ_draft(request: ImportRequest, name: str, progress: Progress) -> Draft:
    """Create the content of the output folder (`Draft`) for a scene with a soft organ."""
    region = request.region or ""
    progress("reading the image", 0.0)
    image = request.read_image()
    labels = request.read_labels(image)
    for argument, each in [("region", region), *(("parts", part) for part in request.parts)]:
        with names_of_caller({"label": argument}):
            labels.number(each)
    for each, modulus in request.parts.items():
        if not modulus > 0.0:
            raise InputError(
                "parts", "have a modulus above 0", f"{each}={modulus:g}", "give the modulus in kPa"
            )
    mask = labels.mask(region)
    # the check compares the Hounsfield units inside the label with the range of soft tissue
    note = (
        soft_label_note(image, mask, region) if mask.any() and inspect(image).is_hounsfield else ""
    )
    mesh, notes = organ_mesh(labels, region, tuple(request.parts), report=progress)
    sentences = [*image.notes, *labels.image.notes, *([note] if note else [])]
    sentences += [f"{each}: {text}" for each, text in notes.items()]
    names = (region, *request.parts)
    volumes_ml = 1e6 * mesh.volumes_m3
    record = {
        "source": image.source,
        "organ": region,
        "volume_ml": {
            each: float(volumes_ml[mesh.part == number].sum())
            for number, each in enumerate(mesh.part_names)
        },
        "parts_kPa": dict(request.parts),
    }

    def draw(file: Path) -> None:
        masks = {each: labels.mask(each) for each in names}
        draw_ct_organ(image, file, masks=masks, mesh=mesh)

    files: dict[str, Writer] = {
        "organ.vtu": partial(write_organ, mesh),
        "labels.seg.nrrd": partial(write_labels, labels.only(names)),
        "slices.png": draw,
    }
    return Draft(toml(_organ_scene(request, name, image.source)), record, files, sentences)


def _organ_scene(request: ImportRequest, name: str, source: str) -> dict[str, Any]:
    """Return the scene in which a ball presses an organ."""
    region = request.region or ""
    anatomy: dict[str, object] = {
        "kind": "liver",
        "file": "organ.vtu",
        "scale_mm": 1.0,
        "normal": list(request.normal_lps or FRONT),
        "held": "below",
    }
    if request.point_mm is not None:
        # positions are rounded to 1 um, far below the spacing of any CT
        anatomy["centre_mm"] = [round(value, 3) for value in request.point_mm]
    # the library has materials for these two organs; any other organ uses the material of the liver
    organ: dict[str, object] = {"material": "kidney" if "kidney" in region.lower() else "liver"}
    if request.parts:
        organ["parts"] = {each: float(modulus) for each, modulus in request.parts.items()}
    return {
        "name": name,
        "description": f"{region} of {source}",
        "anatomy": anatomy,
        "organ": organ,
        "tool": {"kind": "sphere-probe", "diameter_mm": BALL_MM},
        "motion": {
            "kind": "path",
            # the motion begins 2 mm above the surface
            "points_mm": [[0, 0, 2], [0, 0, -DEPTH_MM]],
            "feed_mm_s": FEED_MM_S,
        },
    }
