"""A tooth of a segmentation to a scene: its layers in one label volume, a bur over its largest lesion."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from meshes.base.whole_file import whole_file
from meshes.ct.inspection import inspect
from meshes.ct.label_check import bone_label_note
from meshes.ct.labels import Labels, on_grid_of, read_labels
from meshes.images.frame import box_of, part_of
from meshes.images.reading import read_image
from meshes.tooth.layers import TOOTH_LAYERS
from tissue.importing.folder import SCENE, Imported, import_folder, write_labels
from tissue.importing.pictures import draw_tooth
from tissue.importing.request import ImportRequest
from tissue.importing.scene_text import scene_name, stated, toml
from tissue.scene.load import load_scene

__all__ = ["import_tooth"]

LIKE = "caries"
"""Scene whose tool and motion are taken where none is asked for."""
PARTS = ("voxels", "tool", "motion", "cutting", "output", "coupling", "duration_s", "device")
MARGIN = 3
"""Voxels kept around the tooth."""


def import_tooth(request: ImportRequest, out: Path, *, overwrite: bool, pictures: bool, progress: Progress) -> Imported:
    """Write the tooth of a request as a scene in a folder."""
    assert request.labels is not None
    progress("reading the labels", 0.0)
    with names_of_caller({"file": "labels", "names": "label_names"}):
        labels = read_labels(request.labels, names=request.label_names, spacing_mm=request.spacing_mm)
    sentences, image = list(labels.image.notes), labels.image
    if request.source.resolve() == request.labels.resolve():
        if request.series is not None:
            raise InputError(
                f"series must be left out where the labels are the source, got {request.series}: leave it out"
            )
    else:
        with names_of_caller({"file": "source", "anatomy.spacing_mm": "spacing_mm"}):
            image = read_image(request.source, spacing_mm=request.spacing_mm, series=request.series)
        placed = on_grid_of(labels, image)  # refuses labels of another image
        sentences = [*image.notes, *sentences]
        if "enamel" in placed.names.values() and inspect(image).is_hounsfield:
            with names_of_caller({"region": "labels"}):
                note = bone_label_note(image, placed.mask("enamel"), "enamel")
            sentences += [note] if note else []
    tooth = _tooth(labels)
    sentence, at_lesion, middle = _site(tooth, request.site == "tooth:lesion")
    sentences += [f"tooth: {', '.join(tooth.names.values())}", sentence]
    table = stated(load_scene(request.like or LIKE))
    anatomy = {"kind": "molar", "file": "tooth.seg.nrrd", "site": "caries" if at_lesion else "enamel"}
    whole = {
        "name": scene_name(out),
        "description": f"tooth of {tooth.image.source}",
        "anatomy": anatomy,
        **{part: table[part] for part in PARTS if part in table},
    }
    files = ("tooth.seg.nrrd", *(("slices.png",) if pictures else ()))
    with import_folder(out, files, _record(tooth, sentences), overwrite=overwrite):
        progress("writing files", 0.0)
        write_labels(tooth, out / "tooth.seg.nrrd")
        with whole_file(out / SCENE) as temporary:
            temporary.write_text(toml(whole), "utf-8")
        if pictures:
            progress("drawing", 0.0)
            draw_tooth(image, tooth, out / "slices.png", centre_mm=middle)
    return Imported(out, out / SCENE, True, tuple(sentences))


def _tooth(labels: Labels) -> Labels:
    """The layers of a tooth alone, cropped to them."""
    layers = {number: name for number, name in labels.names.items() if name in TOOTH_LAYERS}
    for name in ("enamel", "dentin"):
        if name not in layers.values():
            held = ", ".join(list(labels.names.values())[:12])
            raise InputError(
                f"labels must name enamel and dentin for a tooth, got {held} in {labels.image.source}: name them by "
                "--label-names FILE, of the names " + ", ".join(TOOTH_LAYERS)
            )
    values = np.where(np.isin(labels.image.values, list(layers)), labels.image.values, 0).astype(np.uint8)
    return Labels(part_of(replace(labels.image, values=values), box_of(values > 0, MARGIN)), layers)


def _site(tooth: Labels, wanted: bool) -> tuple[str, bool, NDArray[np.float64]]:
    """Where the tool comes in, a sentence; whether that is over a lesion; middle of the lesion or of the tooth [mm]."""
    from scipy.ndimage import label

    spacing, origin = np.array(tooth.image.spacing_mm), np.array(tooth.image.origin_mm)
    if not wanted:
        middle = origin + spacing * np.argwhere(tooth.image.values).mean(axis=0)
        return "site: where the tooth's long axis leaves the enamel", False, middle
    if "caries" not in tooth.names.values():
        raise InputError(
            f"site must not be tooth:lesion for a tooth without a label caries, got it for {tooth.image.source}: use "
            "--site tooth"
        )
    pieces, _ = label(tooth.mask("caries"))
    counts = np.bincount(pieces.ravel())[1:]
    sizes = np.sort(counts)[::-1]
    volume = float(sizes[0] * np.prod(spacing))
    middle = origin + spacing * np.argwhere(pieces == 1 + int(np.argmax(counts))).mean(axis=0)
    second = f"the second has {sizes[1] / sizes[0]:.1%} of it" if len(sizes) > 1 else "there is no other"
    return f"site: over the largest lesion, {volume:.3g} mm3; {second}", True, middle


def _record(tooth: Labels, sentences: list[str]) -> dict[str, object]:
    """What was found and assumed, as plain numbers."""
    import tissue

    size = float(np.prod(tooth.image.spacing_mm))
    return {
        "tissue": tissue.__version__,
        "source": tooth.image.source,
        "volume_mm3": {name: size * int(tooth.mask(name).sum()) for name in tooth.names.values()},
        "sentences": sentences,
    }
