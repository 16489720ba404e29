"""A soft organ of a segmentation to a scene: tetrahedra with parts, a modulus each, and a press on them."""

from pathlib import Path

import numpy as np

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from meshes.base.whole_file import whole_file
from meshes.ct.inspection import inspect
from meshes.ct.label_check import soft_label_note
from meshes.ct.labels import Labels, on_grid_of, read_labels
from meshes.images.reading import read_image
from meshes.organs.from_labels import organ_mesh
from meshes.tets.tetrahedra import TetMesh, write_organ
from tissue.figures.ct_organ import draw_ct_organ
from tissue.importing.folder import SCENE, Imported, import_folder, write_labels
from tissue.importing.request import ImportRequest
from tissue.importing.scene_text import scene_name, toml

__all__ = ["import_organ"]

FRONT = (0.0, -1.0, 0.0)
"""Direction to the tool: the front, in LPS, of a person who lies on the back."""
MATERIALS = {"kidney": "kidney"}
"""Cited material by a word of the organ's name; the liver's else."""
BALL_MM, DEPTH_MM, FEED_MM_S = 12.0, 4.0, 5.0
"""What presses at first: within the depth at which linear elasticity is good to 5 %."""


def import_organ(request: ImportRequest, out: Path, *, overwrite: bool, pictures: bool, progress: Progress) -> Imported:
    """Write a soft organ of a request as a scene in a folder."""
    assert request.labels is not None and request.region is not None
    progress("reading the image", 0.0)
    with names_of_caller({"file": "source", "anatomy.spacing_mm": "spacing_mm"}):
        image = read_image(request.source, spacing_mm=request.spacing_mm, series=request.series)
    with names_of_caller({"file": "labels", "names": "label_names"}):
        labels = on_grid_of(
            read_labels(request.labels, names=request.label_names, spacing_mm=request.spacing_mm), image
        )
    with names_of_caller({"label": "region"}):
        labels.number(request.region)
    for name, modulus in request.parts.items():
        with names_of_caller({"label": "part"}):
            labels.number(name)
        if not modulus > 0.0:
            raise InputError(f"part must have a modulus above 0, got {name}={modulus:g}: give kPa")
    mask = labels.mask(request.region)
    checked = soft_label_note(image, mask, request.region) if mask.any() and inspect(image).is_hounsfield else ""
    mesh, notes = organ_mesh(labels, request.region, tuple(request.parts), report=progress)
    sentences = [*image.notes, *labels.image.notes, *([checked] if checked else [])]
    sentences += [f"{name}: {note}" for name, note in notes.items()]
    text = _scene(request, mesh, scene_name(out), image.source)
    files = ("organ.vtu", "labels.seg.nrrd", *(("slices.png",) if pictures else ()))
    record = _record(request, mesh, image.source, sentences)
    with import_folder(out, files, record, overwrite=overwrite):
        progress("writing files", 0.0)
        write_organ(mesh, out / "organ.vtu")
        write_labels(_of_parts(labels, request), out / "labels.seg.nrrd")
        with whole_file(out / SCENE) as temporary:
            temporary.write_text(text, "utf-8")
        if pictures:
            progress("drawing", 0.0)
            masks = {name: labels.mask(name) for name in (request.region, *request.parts)}
            draw_ct_organ(image, out / "slices.png", masks=masks, mesh=mesh, title=image.source)
    return Imported(out, out / SCENE, True, tuple(sentences))


def _scene(request: ImportRequest, mesh: TetMesh, name: str, source: str) -> str:
    """TOML of a scene in which a ball presses the organ."""
    region = request.region or ""
    material = next((each for word, each in MATERIALS.items() if word in region.lower()), "liver")
    anatomy: dict[str, object] = {
        "kind": "liver",
        "file": "organ.vtu",
        "scale_mm": 1.0,
        "normal": list(request.normal_lps or FRONT),
        "held": "below",
    }
    if request.point_mm is not None:
        anatomy["centre_mm"] = [round(value, 3) for value in request.point_mm]
    organ: dict[str, object] = {"material": material}
    if request.parts:
        organ["parts"] = {each: float(modulus) for each, modulus in request.parts.items()}
    return toml(
        {
            "name": name,
            "description": f"{region} of {source}",
            "anatomy": anatomy,
            "organ": organ,
            "tool": {"kind": "sphere-probe", "diameter_mm": BALL_MM},
            "motion": {"kind": "path", "points_mm": [[0, 0, 2], [0, 0, -DEPTH_MM]], "feed_mm_s": FEED_MM_S},
        }
    )


def _of_parts(labels: Labels, request: ImportRequest) -> Labels:
    """The labels of the organ and its parts alone."""
    from dataclasses import replace

    kept = {labels.number(name): name for name in (request.region or "", *request.parts)}
    values = np.where(np.isin(labels.image.values, list(kept)), labels.image.values, 0).astype(np.uint8)
    return Labels(replace(labels.image, values=values), kept)


def _record(request: ImportRequest, mesh: TetMesh, source: str, sentences: list[str]) -> dict[str, object]:
    """What was found and assumed, as plain numbers."""
    import tissue

    volumes = mesh.volumes_m3
    return {
        "tissue": tissue.__version__,
        "source": source,
        "organ": request.region,
        "volume_ml": {
            name: 1e6 * float(volumes[mesh.part == number].sum()) for number, name in enumerate(mesh.part_names)
        },
        "parts_kPa": dict(request.parts),
        "sentences": sentences,
    }
