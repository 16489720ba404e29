"""``tissue import``."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from cyclopts import Parameter

from meshes.base.errors import InputError, names_of_caller
from tissue.cli.terminal import Flag, MaybeWhole, MemoryGB, Numbers, Texts, console
from tissue.system.progress import progress


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class ImageOptions:
    """Command-line options for the CT and its labels.

    Attributes
    ----------
    labels
        Segmentation of the CT: label volume, folder of masks, DICOM SEG or RTSTRUCT.
    label_names
        Source of the names of numbered labels: totalsegmentator, dentalsegmentator, verse,
        toothfairy, or a TOML file; default the label file.
    region
        Label of the bone or soft organ to import, such as scapula_left.
    crop
        X0,Y0,Z0,X1,Y1,Z1: two opposite corners of the box to which the CT is cropped, in mm.
    threshold
        Image value above which a voxel is bone; default computed from the histogram.
    series
        Number of the DICOM series to read, if the folder contains several series.
    spacing_mm
        S or X,Y,Z: voxel spacing in mm; needed for files that do not contain it, such as TIFF
        slices.
    density
        Conversion of CT values to density: internal (calibration from tissues in the image), the
        name of a published law, or line:SLOPE,OFFSET; default internal if the image is suitable.
    """

    labels: Path | None = None
    label_names: str | None = None
    region: str | None = None
    crop: Numbers = None
    threshold: float | None = None
    series: MaybeWhole = None
    spacing_mm: str | None = None
    density: str = "auto"


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """Command-line options for the scene that is made.

    Attributes
    ----------
    site
        Place where the tool works: glenoid, femoral-head, humeral-head, vertebra[:left],
        tooth[:lesion], a point X,Y,Z in mm, or a .mrk.json file. The default depends on the name of
        the region.
    normal
        X,Y,Z: outward direction at a site that is given as a point; default the surface normal.
    coordinates
        Coordinate system of the options crop, site, normal and path.
    path
        Toolpath in mm: CSV, .mrk.json curve or G-code.
    feed_mm_s
        Feed in mm/s if the path contains no feed; default 2.
    keep_clear
        Label of a structure that the tool must not touch; may be repeated.
    like
        Name of a scene from which tool and motion are copied; the default depends on the site.
    part
        NAME=KPA: label of a structure in the imported soft organ, and Young's modulus of this
        structure in kPa; may be repeated.
    """

    site: Numbers = None
    normal: Numbers = None
    coordinates: Literal["LPS", "RAS"] = "LPS"
    path: Path | None = None
    feed_mm_s: float | None = None
    keep_clear: Texts = ()
    like: str | None = None
    part: Texts = ()


def import_(
    source: Path,
    /,
    *,
    out: Path,
    image: ImageOptions = ImageOptions(),
    scene: SceneOptions = SceneOptions(),
    max_memory_GB: MemoryGB = None,
    overwrite: Flag = False,
) -> None:
    """Make a scene from your own CT.

    Parameters
    ----------
    source
        DICOM folder, .nii.gz, .nrrd, .mha or .vti image, or folder of TIFF or PNG slices.
    out
        Output folder, in which scene.toml is written.
    max_memory_GB
        Memory that the image may take, in GB; default half of the free memory.
    overwrite
        Replace the import that the folder already holds.
    """
    from tissue.ct.importing import import_ct

    options = asdict(image) | asdict(scene)
    flags = {name: f"--{name.replace('_', '-')}" for name in options}
    flags |= {"crop_mm": flags["crop"], "parts": flags["part"]}
    try:
        with names_of_caller(flags), progress() as shown:
            made = import_ct(
                source,
                out,
                **_arguments(options),
                max_memory_GB=max_memory_GB,
                overwrite=overwrite,
                progress=shown,
            )
    except InputError as error:
        for finding in getattr(error, "__notes__", ()):
            console.print(finding)
        raise
    for sentence in made.sentences:
        console.print(sentence)
    console.print(f"files in {made.folder}")
    console.print(
        f"next: tissue {'run' if made.has_site else 'view'} "
        f"{made.scene if made.has_site else made.folder}"
    )


def _arguments(options: dict[str, Any]) -> dict[str, Any]:
    """Convert the options to arguments of `import_ct`."""
    given = dict(options)
    crop = given.pop("crop")
    if crop is not None:
        box = _numbers("crop", crop, 6, "X0,Y0,Z0,X1,Y1,Z1")
        given["crop_mm"] = box[:3], box[3:]
    # A site is a point with commas, or a name without commas.
    if given["site"] and "," in given["site"]:
        given["site"] = _numbers("site", given["site"], 3, "X,Y,Z")
    if given["normal"] is not None:
        given["normal"] = _numbers("normal", given["normal"], 3, "X,Y,Z")
    spacing = given["spacing_mm"]
    if spacing is not None:
        count = 3 if "," in spacing else 1
        numbers = _numbers("spacing_mm", spacing, count, "S or X,Y,Z")
        given["spacing_mm"] = numbers if count == 3 else numbers[0]
    given["parts"] = dict(map(_part, given.pop("part")))
    return given


def _part(text: str) -> tuple[str, float]:
    """Parse a text ``NAME=KPA``; return name and Young's modulus [kPa] of a part."""
    name, _, modulus = text.rpartition("=")
    try:
        return name, float(modulus)
    except ValueError:
        raise InputError("part", "be NAME=KPA", text, "use for example tumour=40") from None


def _numbers(name: str, text: str, count: int, form: str) -> tuple[float, ...]:
    """Parse `count` numbers that are separated by commas."""
    try:
        found = tuple(float(word) for word in text.split(","))
    except ValueError:
        found = ()
    if len(found) != count:
        raise InputError(
            name,
            "be a number" if count == 1 else f"be {count} numbers in the form {form}",
            text,
            "write commas without spaces between the numbers",
        )
    return found
