"""Import of a CT: from an image to a folder with a scene."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from meshes.base.file_limits import memory_limit
from meshes.base.progress import Progress, silent
from tissue.ct.bone import bone_draft
from tissue.ct.draft import RECORD, SCENE, scene_name
from tissue.ct.labelled import organ_draft, tooth_draft
from tissue.ct.request import ImportRequest
from tissue.system.owned_folder import require_folder

__all__ = ["Imported", "import_ct"]


@dataclass(frozen=True)
class Imported:
    """Result of an import.

    Attributes
    ----------
    folder
        Written folder.
    scene
        File of the scene.
    has_site
        True if the scene can be run without changes.
    sentences
        Findings and assumptions.
    """

    folder: Path
    scene: Path
    has_site: bool
    sentences: tuple[str, ...]


def import_ct(
    source: str | Path,
    out: str | Path,
    *,
    max_memory_GB: float | None = None,
    overwrite: bool = False,
    pictures: bool = True,
    progress: Progress = silent,
    **options: Any,
) -> Imported:
    """Convert a CT to a folder with a scene.

    The folder holds a bone with its density, a site and pictures, or a tooth, or a soft organ.

    Parameters
    ----------
    source
        DICOM folder or file, image file (``.nii.gz``, ``.nrrd``, ``.mha``, ``.vti``), or folder of
        TIFF, PNG or BMP slices.
    out
        Folder to write; ``scene.toml`` in it can be loaded and simulated.
    max_memory_GB
        Memory that an image may take [GB]; default half of the free memory.
    overwrite
        Replace another import in the folder.
    pictures
        If true, pictures are drawn.
    progress
        Called with a description of the current step.
    **options
        The options below. None selects the default.

    Other Parameters
    ----------------
    labels : str or Path
        Labels of the same CT: a label volume, a folder of masks, one per label, TIFF, PNG or BMP
        slices, or a DICOM segmentation (SEG) or structure set (RTSTRUCT).
    label_names : str
        ``totalsegmentator``, ``dentalsegmentator``, ``verse`` or another of
        `meshes.ct.label_names.label_sets`, or a TOML file whose table ``[labels]`` gives each name
        its number. Default: the names in the file's header.
    region : str
        Label that is the bone or the organ.
    crop_mm : pair of points
        Lowest and highest corner of the box to keep [mm].
    threshold : float
        Value above which a voxel is bone, without labels. Default: a value suggested by the
        histogram.
    series : int
        Number of the series in a folder with several series.
    spacing_mm : float or three floats
        Distance between neighbours [mm], in all directions or along each axis, for files without
        this information, such as TIFF and PNG slices.
    density : str
        ``internal``, a named law, or ``line:SLOPE,OFFSET``, see
        `meshes.ct.calibration.density_law`; default: internal if the image allows it.
    site : str or point
        ``glenoid``, ``femoral-head``, ``humeral-head``, ``vertebra`` (``:left``, ``:right``),
        ``tooth``, ``tooth:lesion``, a point [mm], or a file of 3D Slicer markups. Default: by the
        region's name.
    normal : point
        Outward direction at a site that is a point. Default: the normal of the surface.
    coordinates : {"LPS", "RAS"}
        Frame of crop, site, normal and path: LPS as in DICOM, or RAS as in NIfTI and 3D Slicer's
        views.
    path : str or Path
        Toolpath in the frame of the image [mm]: CSV, markups curve or G-code, see
        `meshes.paths.toolpath.read_toolpath`.
    feed_mm_s : float
        Speed where the path gives no speed [mm/s]. Default: 2.
    keep_clear : sequence of str
        Labels that the tool must not touch.
    like : str
        Scene that provides tool and motion. Default: by the site.
    parts : mapping of str to float
        Labels in a soft organ that become parts of it, with their Young's moduli [kPa].

    Raises
    ------
    InputError
        If the image or an option cannot be used, or the folder holds another import.
    """
    folder = Path(out)
    # before minutes of reading
    require_folder(folder, "import", (SCENE, RECORD), overwrite=overwrite)
    unknown = sorted(options.keys() - {each.name for each in fields(ImportRequest)})
    if unknown:
        raise TypeError(f"import_ct() got an unexpected keyword argument {unknown[0]!r}")
    given = {name: value for name, value in options.items() if value is not None}
    convert = {"labels": Path, "path": Path, "keep_clear": tuple, "parts": dict}
    request = ImportRequest(
        Path(source),
        **{
            name: convert[name](value) if name in convert else value
            for name, value in given.items()
        },
    )
    draft_of = bone_draft
    if request.is_tooth:
        draft_of = tooth_draft
    elif request.is_soft:
        draft_of = organ_draft
    with memory_limit(max_memory_GB):
        draft = draft_of(request, scene_name(folder), progress)
        sentences = draft.write(folder, overwrite=overwrite, pictures=pictures, progress=progress)
    return Imported(folder, folder / SCENE, draft.has_site, tuple(sentences))
