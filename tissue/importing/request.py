"""What is asked of an import: which image, which part of it, where to work, and which scene to make of it."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from meshes.base.errors import InputError, require_direction, require_range
from meshes.ct.labelled_bone import Box
from tissue.scene.named_parts import nearest

__all__ = ["NAMED_SITES", "Coordinates", "ImportRequest", "Point", "lps"]

Coordinates = Literal["LPS", "RAS"]
Point = tuple[float, float, float]

NAMED_SITES = ("glenoid", "femoral-head", "humeral-head", "vertebra", "tooth:lesion")
"""Sites that are searched for."""
MARKUPS = (".json", ".fcsv")


@dataclass(frozen=True)
class ImportRequest:
    """What to import.

    Attributes
    ----------
    source
        Image file, DICOM folder or pattern of slices.
    labels, label_names
        Label volume or folder of masks, and a known program or a TOML file that names its labels.
    region
        Label that is the bone or organ.
    crop_mm
        Box to keep, x, y, z of its lowest and of its highest corner [mm].
    threshold
        Value above which a voxel is bone, without labels.
    series
        Number of the series of a DICOM folder that holds several.
    density
        Law of the density: a name, ``line:...`` or ``internal``.
    site
        One of `NAMED_SITES`, ``X,Y,Z`` in mm, or a file of 3D Slicer markups.
    normal
        Outward direction at a site that is a point.
    coordinates
        Frame of the numbers that are given: LPS or RAS.
    path
        File of a toolpath.
    keep_clear
        Labels that the tool must not touch.
    like
        Scene whose tool and motion are taken.

    Raises
    ------
    InputError
        If something that is given has no effect beside the rest, or is not of its form.
    """

    source: Path
    labels: Path | None = None
    label_names: str | None = None
    region: str | None = None
    crop_mm: str | None = None
    threshold: float | None = None
    series: int | None = None
    density: str = "auto"
    site: str | None = None
    normal: str | None = None
    coordinates: Coordinates = "LPS"
    path: Path | None = None
    keep_clear: tuple[str, ...] = ()
    like: str | None = None

    def __post_init__(self) -> None:
        if self.labels is None:
            for name, value in (
                ("label_names", self.label_names),
                ("region", self.region),
                ("keep_clear", ", ".join(self.keep_clear)),
            ):
                if value:
                    raise InputError(f"{name} must be left out without labels, got {value}: give --labels FILE too")
        if self.region is not None and self.threshold is not None:
            raise InputError(
                f"threshold must be left out with a region, whose label is the bone, got {self.threshold:g}: leave one "
                "of them out"
            )
        if self.threshold is not None:
            require_range("threshold", self.threshold, -1e9, 1e9, "use about 226 for CT")
        if self.labels is not None and self.region is None:
            raise InputError(
                "region must be given with labels, got nothing: name the label that is the bone, such as --region "
                "scapula_left"
            )
        at = self.point_mm
        if self.normal is not None and at is None:
            raise InputError(
                f"normal must be left out unless site is a point, got {self.normal}: give --site X,Y,Z, or leave it out"
            )
        if self.site is not None and at is None and not self.is_markups and self.site not in NAMED_SITES:
            raise InputError(
                f"site must be one of {', '.join(NAMED_SITES)}, X,Y,Z in mm or a .mrk.json file, got "
                f"{self.site}{nearest(self.site, NAMED_SITES)}: choose one of these"
            )
        if self.site == "tooth:lesion" and self.region is not None and self.labels is None:
            raise InputError("labels must be given for a tooth, got nothing: give --labels FILE")

    @property
    def is_markups(self) -> bool:
        """Whether the site is a file of markups."""
        return self.site is not None and Path(self.site).suffix.lower() in MARKUPS

    @property
    def point_mm(self) -> Point | None:
        """The site where it is a point [mm, LPS]."""
        if self.site is None or "," not in self.site:
            return None
        return lps(_three("site", self.site), self.coordinates)

    @property
    def normal_lps(self) -> Point | None:
        """The outward direction where it is given, in LPS."""
        if self.normal is None:
            return None
        x, y, z = require_direction(
            "normal", _three("normal", self.normal), "give the outward direction, such as 0,0,1"
        ).tolist()
        return lps((x, y, z), self.coordinates)

    @property
    def box_mm(self) -> Box | None:
        """The box to keep [mm, LPS], its lowest corner first."""
        if self.crop_mm is None:
            return None
        numbers = _numbers("crop", self.crop_mm, 6, "X0,Y0,Z0,X1,Y1,Z1 in mm")
        one = lps((numbers[0], numbers[1], numbers[2]), self.coordinates)
        other = lps((numbers[3], numbers[4], numbers[5]), self.coordinates)
        if any(a >= b for a, b in zip(numbers[:3], numbers[3:], strict=True)):
            raise InputError(
                f"crop must have its lowest corner first, got {self.crop_mm}: use X0,Y0,Z0,X1,Y1,Z1 with X0 < X1, "
                "Y0 < Y1, Z0 < Z1"
            )
        low, high = (tuple(chosen(a, b) for a, b in zip(one, other, strict=True)) for chosen in (min, max))
        return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def lps(point: Point, coordinates: Coordinates) -> Point:
    """A point or direction in LPS."""
    x, y, z = point
    return (-x, -y, z) if coordinates == "RAS" else point


def _three(name: str, text: str) -> Point:
    x, y, z = _numbers(name, text, 3, "X,Y,Z")
    return x, y, z


def _numbers(name: str, text: str, count: int, form: str) -> list[float]:
    """Finite numbers between commas."""
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = []
    if len(found) != count or not all(map(math.isfinite, found)):
        raise InputError(f"{name} must be {count} numbers, {form}, got {text}: write them with commas and no spaces")
    return found
