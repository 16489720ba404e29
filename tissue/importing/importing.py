"""An import from image to folder."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError
from meshes.base.file_limits import memory_limit
from meshes.base.progress import Progress, silent
from meshes.base.whole_file import whole_file
from meshes.ct.density import DensityLaw
from meshes.ct.labelled_bone import Box
from meshes.ct.labels import Labels, on_grid_of
from meshes.images.frame import Image
from tissue.importing.bone import ImportedBone, imported_bone
from tissue.importing.folder import (
    RECORD,
    SCENE,
    Imported,
    import_folder,
    write_density,
    write_labels,
    write_surface,
)
from tissue.importing.kept_clear import kept_clear
from tissue.importing.organ import import_organ
from tissue.importing.path import import_path
from tissue.importing.pictures import PICTURES, draw_pictures
from tissue.importing.placing import Placed, placed
from tissue.importing.request import Coordinates, ImportRequest, Point
from tissue.importing.scene_text import scene_name, scene_text
from tissue.importing.tooth import import_tooth
from tissue.system.owned_folder import require_folder

__all__ = ["Imported", "import_ct"]


def import_ct(
    source: str | Path,
    out: str | Path,
    *,
    labels: str | Path | None = None,
    label_names: str | None = None,
    region: str | None = None,
    crop_mm: Box | None = None,
    threshold: float | None = None,
    series: int | None = None,
    spacing_mm: float | None = None,
    density: str = "auto",
    site: str | Point | None = None,
    normal: Point | None = None,
    coordinates: Coordinates = "LPS",
    path: str | Path | None = None,
    feed_mm_s: float | None = None,
    keep_clear: Sequence[str] = (),
    like: str | None = None,
    parts: Mapping[str, float] | None = None,
    max_memory_GB: float | None = None,
    overwrite: bool = False,
    pictures: bool = True,
    progress: Progress = silent,
) -> Imported:
    """Make a scene of a person's own CT: a folder with a bone, its density, a site and pictures, or with a soft organ.

    Parameters
    ----------
    source
        DICOM folder or image file (``.nii.gz``, ``.nrrd``, ``.mha``, ``.vti``).
    out
        Folder to write; ``scene.toml`` in it can be loaded and simulated.
    labels
        Label volume of the same CT, or folder of masks, one a label.
    label_names
        ``totalsegmentator``, ``dentalsegmentator``, ``verse``, or a TOML file whose table ``[labels]`` gives each name
        its number; default the names in the file's own header.
    region
        Label that is the bone or the organ.
    crop_mm
        Lowest and highest corner of the box to keep [mm].
    threshold
        Value above which a voxel is bone, without labels; default suggested from the histogram.
    series
        Number of the series, of a folder that holds several.
    spacing_mm
        Distance between neighbours [mm] of files that do not state it, such as TIFF slices.
    density
        ``internal``, a named law, or ``line:SLOPE,OFFSET``, see `meshes.ct.laws.density_law`; ``auto`` is internal
        where the image allows it.
    site
        ``glenoid``, ``femoral-head``, ``humeral-head``, ``vertebra`` (``:left``, ``:right``), ``tooth``,
        ``tooth:lesion``, a point [mm], or a file of 3D Slicer markups; default by the region's name.
    normal
        Outward direction at a site that is a point; default that of the surface.
    coordinates
        Frame of crop, site, normal and path: that of DICOM (LPS) or of NIfTI and 3D Slicer's views (RAS).
    path
        Toolpath in the frame of the image [mm]: CSV, markups curve or G-code, see
        `meshes.paths.toolpath.read_toolpath`.
    feed_mm_s
        Speed where the path states none [mm/s]; default 2.
    keep_clear
        Labels that the tool must not touch.
    like
        Scene whose tool and motion are taken; default by the site.
    parts
        Labels in a soft organ that become parts of it, with their Young's moduli [kPa].
    max_memory_GB
        Memory that an image may take [GB]; default half of the free memory.
    overwrite
        Replace another import in the folder.
    pictures
        Whether pictures are drawn.
    progress
        Called with what is being done.

    Raises
    ------
    InputError
        If the image or what is asked of it cannot be used, or the folder holds another import.
    """
    require_folder(Path(out), "import", (SCENE, RECORD), overwrite=overwrite)  # before minutes of reading
    request = ImportRequest(
        Path(source), None if labels is None else Path(labels), label_names, region, crop_mm, threshold, series,
        spacing_mm, density, site, normal, coordinates, None if path is None else Path(path), feed_mm_s,
        tuple(keep_clear), like, dict(parts or {}),
    )  # fmt: skip
    with memory_limit(max_memory_GB):
        if request.is_tooth:
            return import_tooth(request, Path(out), overwrite=overwrite, pictures=pictures, progress=progress)
        if request.is_soft:
            return import_organ(request, Path(out), overwrite=overwrite, pictures=pictures, progress=progress)
        return _import_bone(request, Path(out), overwrite=overwrite, pictures=pictures, progress=progress)


def _import_bone(request: ImportRequest, out: Path, *, overwrite: bool, pictures: bool, progress: Progress) -> Imported:
    """Write a bone as a scene in a folder."""
    bone = imported_bone(request, _law_of, progress)
    clear, kept = kept_clear(request, bone.labels, progress)
    progress("finding the site", 0.0)
    at, sentence = placed(request, bone.surface)
    sentences = [*bone.sentences, sentence, *kept]
    path = None if request.path is None else import_path(request, at, bone.surface)
    sentences += [] if path is None else [path.sentence]
    kept_files = {name: f"keep_clear_{name}.ply" for name in clear}
    files = {"file": "bone.ply"} | ({} if bone.density is None else {"density_file": "density.nrrd"})
    text = scene_text(
        name=scene_name(out),
        description=f"{request.region or 'bone'} of {bone.inspection.source}",
        placed=at,
        dense=bone.density is not None,
        files=files,
        keep_clear=kept_files,
        like=request.like,
        replay=None if path is None else "path.csv",
    )
    written = {
        "bone.ply": True,
        "density.nrrd": bone.density is not None,
        "labels.seg.nrrd": bone.labels is not None,
        **dict.fromkeys(kept_files.values(), True),
        "path.csv": path is not None,
        **dict.fromkeys(PICTURES, pictures),
        "path.png": pictures and path is not None,
    }
    names = [name for name, wanted in written.items() if wanted]
    with import_folder(out, names, _record(bone, at, sentences), overwrite=overwrite):
        progress("writing files", 0.0)
        write_surface(bone.surface, out / "bone.ply")
        if bone.density is not None:
            write_density(bone.density, out / "density.nrrd", law=bone.certainty)
        if bone.labels is not None:
            write_labels(_near(bone.labels, bone.bone.image), out / "labels.seg.nrrd")
        for name, surface in clear.items():
            write_surface(surface, out / kept_files[name])
        if path is not None:
            path.table.write(out / "path.csv")
        with whole_file(out / SCENE) as temporary:
            temporary.write_text(text, "utf-8")
        if pictures:
            progress("drawing", 0.0)
            sentences += draw_pictures(bone, at, clear, out, points_mm=None if path is None else path.points_mm)
            if path is not None and at is not None:
                sentences += path.draw(bone.surface, at, out / "path.png")
    return Imported(out, out / SCENE, at is not None, tuple(sentences))


def _law_of(text: str, image: Image, labels: Labels | None) -> DensityLaw:
    """The law that a request names; the first that the image allows where it names none."""
    from meshes.ct.density import CT_DENSITY
    from meshes.ct.laws import density_law

    if text != "auto":
        return density_law(text, image, labels=labels)
    try:
        return density_law("internal", image, labels=labels)
    except InputError as error:
        return replace(CT_DENSITY, source=f"{CT_DENSITY.source}; no calibration within the image: {error}")


def _near(labels: Labels, image: Image) -> Labels:
    """The labels where the bone lies."""
    return on_grid_of(labels, replace(image, values=np.zeros(image.values.shape, np.uint8)))


def _record(bone: ImportedBone, at: Placed | None, sentences: list[str]) -> dict[str, object]:
    """What was found and assumed, as plain numbers."""
    import tissue

    site: dict[str, object] | None = None
    if at is not None:
        site = {
            "kind": at.kind,
            "centre_mm": (1e3 * at.site.centre_m).tolist(),
            "rotation": at.site.rotation.tolist(),
        }
    inspection = bone.inspection
    return {
        "tissue": tissue.__version__,
        "source": inspection.source,
        "voxels": list(inspection.shape),
        "spacing_mm": list(inspection.spacing_mm),
        "low_mm": list(inspection.low_mm),
        "high_mm": list(inspection.high_mm),
        "noise_HU": inspection.noise,
        "metal_mm3": inspection.metal_mm3,
        "threshold": bone.threshold,
        "bone_mm3": bone.bone.volume_mm3,
        "density_law": None if bone.law is None else bone.law.as_dict(),
        "site": site,
        "sentences": sentences,
    }
