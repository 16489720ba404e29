"""``tissue import``."""

from pathlib import Path
from typing import Literal

from meshes.base.errors import InputError
from tissue.cli.terminal import Flag, MaybeWhole, MemoryGB, Texts, console, progress

__all__ = ["import_"]


def import_(
    source: Path,
    /,
    *,
    out: Path,
    labels: Path | None = None,
    label_names: str | None = None,
    region: str | None = None,
    crop: str | None = None,
    threshold: float | None = None,
    series: MaybeWhole = None,
    spacing_mm: float | None = None,
    density: str = "auto",
    site: str | None = None,
    normal: str | None = None,
    coordinates: Literal["LPS", "RAS"] = "LPS",
    path: Path | None = None,
    feed_mm_s: float | None = None,
    keep_clear: Texts = (),
    like: str | None = None,
    part: Texts = (),
    max_memory_GB: MemoryGB = None,
    overwrite: Flag = False,
) -> None:
    """Make a scene from your own CT.

    Parameters
    ----------
    source
        DICOM folder, .nii.gz, .nrrd, .mha or .vti image.
    out
        Folder to write, with scene.toml in it.
    labels
        Label volume, or folder of masks, of the same CT.
    label_names
        totalsegmentator, dentalsegmentator, verse, or a TOML file that names the numbers; default
        the file's own names.
    region
        Label that is the bone or soft organ, such as scapula_left.
    crop
        X0,Y0,Z0,X1,Y1,Z1: box to keep, in mm.
    threshold
        Value above which a voxel is bone; default a suggestion from the histogram.
    series
        Number of the series in a folder that holds several.
    spacing_mm
        Distance between voxels of files that do not state it.
    density
        internal, a named law, or line:SLOPE,OFFSET; default internal where the image allows it.
    site
        glenoid, femoral-head, humeral-head, vertebra[:left], tooth[:lesion], X,Y,Z in mm, or
        .mrk.json; default by the region's name.
    normal
        X,Y,Z: outward direction at a site that is a point; default the surface normal.
    coordinates
        Frame of crop, site, normal and path.
    path
        Toolpath: CSV, .mrk.json curve or G-code, in mm.
    feed_mm_s
        Speed if the path states none; default 2.
    keep_clear
        Label that the tool must not touch; may be repeated.
    like
        Scene whose tool and motion are taken; default by the site.
    part
        NAME=KPA: label in a soft organ and its Young's modulus; may be repeated.
    max_memory_GB
        Memory that an image may take, in GB; default half of the free memory.
    overwrite
        Replace another import in the folder.
    """
    from tissue.ct.importing import import_ct

    box = None if crop is None else _numbers("crop", crop, 6, "X0,Y0,Z0,X1,Y1,Z1")
    with progress() as shown:
        made = import_ct(
            source,
            out,
            labels=labels,
            label_names=label_names,
            region=region,
            crop_mm=None if box is None else (_three(box[:3]), _three(box[3:])),
            threshold=threshold,
            series=series,
            spacing_mm=spacing_mm,
            density=density,
            site=_three(_numbers("site", site, 3, "X,Y,Z")) if site and "," in site else site,
            normal=None if normal is None else _three(_numbers("normal", normal, 3, "X,Y,Z")),
            coordinates=coordinates,
            path=path,
            feed_mm_s=feed_mm_s,
            keep_clear=keep_clear,
            like=like,
            parts=dict(map(_part, part)),
            max_memory_GB=max_memory_GB,
            overwrite=overwrite,
            progress=shown,
        )
    for sentence in made.sentences:
        console.print(sentence)
    console.print(f"files in {made.folder}")
    console.print(
        f"next: tissue {'run' if made.has_site else 'view'} "
        f"{made.scene if made.has_site else made.folder}"
    )


def _part(text: str) -> tuple[str, float]:
    """Parse name and modulus of a part."""
    name, _, modulus = text.rpartition("=")
    try:
        return name, float(modulus)
    except ValueError:
        raise InputError("part", "be NAME=KPA", text, "use for example tumour=40") from None


def _three(numbers: list[float]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z


def _numbers(name: str, text: str, count: int, form: str) -> list[float]:
    """Parse numbers separated by commas."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count:
        raise InputError(
            name, f"be {count} numbers, {form}", text, "write them with commas and no spaces"
        )
    return found
