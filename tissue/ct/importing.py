"""Import of a CT: conversion of an image to a folder with a scene."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from meshes.base.file_limits import memory_limit
from meshes.base.hints import nearest
from meshes.base.progress import Progress, silent
from tissue.ct.bone import bone_draft
from tissue.ct.draft import RECORD, SCENE, scene_name
from tissue.ct.labelled import organ_draft, tooth_draft
from tissue.ct.request import ImportRequest
from tissue.system.owned_folder import require_folder


@dataclass(frozen=True)
class Imported:
    """Result of an import.

    Attributes
    ----------
    folder
        Output folder.
    scene
        File of the scene.
    has_site
        True if the scene contains the site that a run needs, or if a run needs no site.
    sentences
        Results and assumptions.
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

    The folder contains a scene and pictures. The scene contains a tooth, a soft organ, or a bone
    with its density and a site.

    Parameters
    ----------
    source
        DICOM folder or file, image file (``.nii.gz``, ``.nrrd``, ``.mha``, ``.vti``), or folder of
        TIFF, PNG or BMP slices.
    out
        Output folder. Its file ``scene.toml`` can be loaded and simulated.
    max_memory_GB
        Memory that an image may use [GB]. Default: half of the free memory.
    overwrite
        If true, an earlier import in the folder is replaced.
    pictures
        If true, pictures are drawn.
    progress
        Function that is called with the name of the current step and the completed share (0 to 1).
    **options
        Further options, listed below. The value None selects the default of an option.

    Other Parameters
    ----------------
    labels : str or Path
        Labels of the same CT: a label volume, a folder with one mask per label, a folder of TIFF,
        PNG or BMP slices, a DICOM segmentation (SEG), or a DICOM structure set (RTSTRUCT).
    label_names : str
        Name of a set in `meshes.ct.label_names.label_sets`, such as ``totalsegmentator``,
        ``dentalsegmentator`` or ``verse``; or a TOML file. The table ``[labels]`` of the file
        assigns a number to each name. Default: the names in the file's header.
    region : str
        Name of the label of the bone or organ.
    crop_mm : pair of points
        Lowest and highest corner of the box to keep [mm].
    threshold : float
        Value above which a voxel is bone if there are no labels. Default: a value computed from the
        histogram.
    series : int
        Number of the series in a folder with several series.
    spacing_mm : float or three floats
        Distance between neighbouring voxels [mm], in all directions or along each axis. Use this
        option for files that do not contain the spacing, such as TIFF and PNG slices.
    density : str
        Density law: ``internal``, a named law, or ``line:SLOPE,OFFSET``, see
        `meshes.ct.calibration.density_law`. Default: internal if the image allows it.
    site : str or point
        ``glenoid``, ``femoral-head``, ``humeral-head``, ``vertebra`` (``:left``, ``:right``),
        ``tooth``, ``tooth:lesion``, a point [mm], or a file of 3D Slicer markups. Default: the
        usual site for the name of the region.
    normal : point
        Outward direction at the site, if the site is given as a point. Default: the normal of the
        surface.
    coordinates : {"LPS", "RAS"}
        Frame of the options `crop_mm`, `site`, `normal` and `path`: LPS as in DICOM, or RAS as in
        NIfTI and in the views of 3D Slicer.
    path : str or Path
        Toolpath in the frame of the image [mm]: CSV, markups curve or G-code, see
        `meshes.paths.toolpath.read_toolpath`.
    feed_mm_s : float
        Speed [mm/s] along parts of the path for which the file gives no speed. Default: 2.
    keep_clear : sequence of str
        Labels that the tool must not touch.
    like : str
        Scene that provides tool and motion. Default: the usual scene for the site.
    parts : mapping of str to float
        Young's moduli [kPa] of structures in a soft organ, keyed by their label. Each structure
        becomes a part of the organ.

    Raises
    ------
    InputError
        If the image or an option cannot be used, or the folder holds another import.
    """
    folder = Path(out)
    # check before reading, which may take minutes
    require_folder(folder, "import", (SCENE, RECORD), overwrite=overwrite)
    known = [each.name for each in fields(ImportRequest)]
    unknown = [name for name in options if name not in known]
    if unknown:
        hint = nearest(unknown[0], known)
        raise TypeError(f"import_ct() got an unexpected keyword argument {unknown[0]!r}{hint}")
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
