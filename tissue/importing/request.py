"""What is asked of an import: which image, which part of it, where to work, and which scene to make of it."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from meshes.base.errors import InputError, as_vector, by, in_brackets, require_positive, require_range
from meshes.ct.labelled_bone import Box
from meshes.surfaces.markups import TO_LPS
from tissue.scene.named_parts import nearest

__all__ = ["NAMED_SITES", "Coordinates", "ImportRequest", "Point", "lps"]

Coordinates = Literal["LPS", "RAS"]
Point = tuple[float, float, float]

TEETH = ("tooth", "tooth:lesion")
NAMED_SITES = (
    "glenoid", "femoral-head", "humeral-head", "vertebra", "vertebra:left", "vertebra:right", *TEETH,
)  # fmt: skip
"""Sites that are searched for."""
MARKUPS = (".json", ".fcsv")
SOFT = "liver|kidney|spleen|pancreas|prostate|bladder|brain|stomach|heart|lung|thyroid|muscle|gluteus|iliopsoas"
"""Words in the name of a label that is a soft organ."""


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
        Box to keep, its lowest and its highest corner [mm].
    threshold
        Value above which a voxel is bone, without labels.
    series
        Number of the series of a DICOM folder that holds several.
    spacing_mm
        Distance between neighbours [mm] of files that do not state it.
    density
        Law of the density: a name, ``line:...`` or ``internal``.
    site
        One of `NAMED_SITES`, a point [mm], or a file of 3D Slicer markups.
    normal
        Outward direction at a site that is a point.
    coordinates
        Frame of the numbers that are given: LPS or RAS.
    path, feed_mm_s
        File of a toolpath, and the speed where it states none [mm/s].
    keep_clear
        Labels that the tool must not touch.
    like
        Scene whose tool and motion are taken.
    parts
        Young's moduli of labels in a soft organ [kPa].

    Raises
    ------
    InputError
        If something that is given has no effect beside the rest, or is not of its form.
    """

    source: Path
    labels: Path | None = None
    label_names: str | None = None
    region: str | None = None
    crop_mm: Box | None = None
    threshold: float | None = None
    series: int | None = None
    spacing_mm: float | None = None
    density: str = "auto"
    site: str | Point | None = None
    normal: Point | None = None
    coordinates: Coordinates = "LPS"
    path: Path | None = None
    feed_mm_s: float | None = None
    keep_clear: tuple[str, ...] = ()
    like: str | None = None
    parts: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.labels is None:
            for name, value in (
                ("label_names", self.label_names),
                ("region", self.region),
                ("keep_clear", ", ".join(self.keep_clear)),
                ("part", ", ".join(self.parts)),
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
        if self.is_tooth:
            self._require_tooth()
        elif self.labels is not None and self.region is None:
            raise InputError(
                "region must be given with labels, got nothing: name the label that is the bone, such as --region "
                "scapula_left"
            )
        for name, points in (("site", [self.site]), ("normal", [self.normal]), ("crop", self.crop_mm or ())):
            if any(as_vector(each) is None for each in points if each is not None and not isinstance(each, str)):
                raise InputError(
                    f"{name} must be of three finite numbers, got {getattr(self, name, points)}: give x, y, z"
                )
        if self.normal is not None and (self.site is None or isinstance(self.site, str)):
            raise InputError(
                f"normal must be left out unless site is a point, got {by(self.normal)}: give the point too, or leave "
                "it out"
            )
        if isinstance(self.site, str) and not self.is_markups and self.site not in NAMED_SITES:
            raise InputError(
                f"site must be one of {', '.join(NAMED_SITES)}, a point in mm or a .mrk.json file, got {self.site}"
                f"{nearest(self.site, NAMED_SITES)}: choose one of these"
            )
        self._require_frame()
        if self.feed_mm_s is not None:
            require_positive("feed_mm_s", self.feed_mm_s, "use about 2")
            if self.path is None:
                raise InputError(f"feed_mm_s must be left out without a path, got {self.feed_mm_s:g}: give --path FILE")
        if self.path is not None and self.like is not None:
            raise InputError(
                f"like must be left out with a path, which is the motion, got {self.like}: leave one of them out"
            )
        if self.is_soft:
            self._require_soft()
        if self.crop_mm is not None and any(a >= b for a, b in zip(*self.crop_mm, strict=True)):
            raise InputError(
                f"crop must have its lowest corner first, got {in_brackets(self.crop_mm[0])} and "
                f"{in_brackets(self.crop_mm[1])}: exchange them along the axes where it has not"
            )

    def _require_frame(self) -> None:
        """Refuse a frame that is unknown, or of no numbers."""
        if self.coordinates not in TO_LPS:
            raise InputError(f"coordinates must be LPS or RAS, got {self.coordinates}: give the frame of the numbers")
        in_numbers = self.path is not None and self.path.suffix.lower() not in MARKUPS
        points = self.crop_mm is not None or self.point_mm is not None
        if self.coordinates == "RAS" and not (points or in_numbers):
            raise InputError(
                "coordinates must be left out unless crop, a site or a path is given in numbers, got RAS: files of "
                "markups state their own frame; leave it out"
            )

    def _require_soft(self) -> None:
        """Refuse what has no effect on a soft organ."""
        for name, value, without in (
            ("density", self.density, "auto"), ("threshold", self.threshold, None), ("path", self.path, None),
            ("keep_clear", self.keep_clear, ()), ("like", self.like, None), ("crop", self.crop_mm, None),
        ):  # fmt: skip
            if value != without:
                raise InputError(f"{name} must be left out for a soft organ, got {value}: leave it out")
        if isinstance(self.site, str):
            raise InputError(f"site must be a point for a soft organ, got {self.site}: give X,Y,Z in mm")

    def _require_tooth(self) -> None:
        """Refuse what has no effect on a tooth, and a tooth without labels."""
        if self.labels is None:
            raise InputError(f"labels must be given for site {self.site}, got nothing: give --labels FILE")
        for name, value, without in (
            ("region", self.region, None), ("density", self.density, "auto"), ("threshold", self.threshold, None),
            ("path", self.path, None), ("keep_clear", self.keep_clear, ()), ("part", dict(self.parts), {}),
            ("crop", self.crop_mm, None),
        ):  # fmt: skip
            if value != without:
                raise InputError(f"{name} must be left out for a tooth, got {value}: leave it out")

    @property
    def is_tooth(self) -> bool:
        """Whether the site is that of a tooth."""
        return self.site in TEETH

    @property
    def is_soft(self) -> bool:
        """Whether the region is a soft organ, by its name or because parts of it have moduli."""
        return bool(self.parts) or (self.region is not None and re.search(SOFT, self.region.lower()) is not None)

    @property
    def is_markups(self) -> bool:
        """Whether the site is a file of markups."""
        return isinstance(self.site, str) and Path(self.site).suffix.lower() in MARKUPS

    @property
    def point_mm(self) -> Point | None:
        """The site where it is a point [mm, LPS]."""
        return None if self.site is None or isinstance(self.site, str) else lps(self.site, self.coordinates)

    @property
    def normal_lps(self) -> Point | None:
        """The outward direction where it is given, in LPS."""
        return None if self.normal is None else lps(self.normal, self.coordinates)

    @property
    def box_mm(self) -> Box | None:
        """The box to keep [mm, LPS], its lowest corner first."""
        if self.crop_mm is None:
            return None
        (a, b, c), (d, e, f) = (lps(corner, self.coordinates) for corner in self.crop_mm)
        return (min(a, d), min(b, e), c), (max(a, d), max(b, e), f)


def lps(point: Point, coordinates: Coordinates) -> Point:
    """A point or direction in LPS."""
    x, y, z = point
    return (-x, -y, z) if coordinates == "RAS" else (x, y, z)
