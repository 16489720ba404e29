"""``tissue import``."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from tissue.cli.terminal import console, progress, whole

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
    series: Annotated[int | None, Parameter(converter=whole)] = None,
    density: str = "auto",
    site: str | None = None,
    normal: str | None = None,
    coordinates: Literal["LPS", "RAS"] = "LPS",
    path: Path | None = None,
    keep_clear: Annotated[tuple[str, ...], Parameter(negative="")] = (),
    like: str | None = None,
    overwrite: Annotated[bool, Parameter(negative="")] = False,
) -> None:
    """Make a scene of a person's own CT.

    Parameters
    ----------
    source
        DICOM folder, .nii.gz, .nrrd, .mha or .vti image.
    out
        Folder to write, with scene.toml in it.
    labels
        Label volume, or folder of masks, of the same CT.
    label_names
        totalsegmentator, dentalsegmentator, verse, or a TOML file that names the numbers; default the file's own names.
    region
        Label that is the bone, such as scapula_left.
    crop
        X0,Y0,Z0,X1,Y1,Z1: box to keep, in mm.
    threshold
        Value above which a voxel is bone; default suggested from the histogram.
    series
        Number of the series, of a folder that holds several.
    density
        internal, a named law, or line:SLOPE,OFFSET; default internal where the image allows it.
    site
        glenoid, femoral-head, humeral-head, vertebra, X,Y,Z in mm, or a .mrk.json file; default by the region's name.
    normal
        X,Y,Z: outward direction at a site that is a point; default that of the surface.
    coordinates
        Frame of crop, site, normal and path.
    path
        Toolpath: CSV, .mrk.json curve or G-code, in mm.
    keep_clear
        Label that the tool must not touch; may be repeated.
    like
        Scene whose tool and motion are taken; default by the site.
    overwrite
        Replace another import in the folder.
    """
    from tissue.importing.importing import import_bone
    from tissue.importing.request import ImportRequest

    request = ImportRequest(
        source=source, labels=labels, label_names=label_names, region=region, crop_mm=crop, threshold=threshold,
        series=series, density=density, site=site, normal=normal, coordinates=coordinates, path=path,
        keep_clear=keep_clear, like=like,
    )  # fmt: skip
    with progress() as shown:
        made = import_bone(request, out, overwrite=overwrite, progress=shown)
    for sentence in made.sentences:
        console.print(sentence)
    console.print(f"files in {made.folder}")
    console.print(f"next: tissue {'run' if made.has_site else 'view'} {made.scene if made.has_site else made.folder}")
