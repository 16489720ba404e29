"""Options of an import: which image, which part of it, where to work, and which scene to make of
it.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

from meshes.base.errors import (
    InputError,
    as_vector,
    in_brackets,
    names_of_caller,
    require_positive,
    require_range,
)
from meshes.ct.extraction import Box
from meshes.ct.labels import Labels, on_grid_of, read_labels
from meshes.images.frame import Image
from meshes.images.reading import read_image
from meshes.surfaces.markups import TO_LPS
from tissue.scene.named_parts import nearest

__all__ = ["NAMED_SITES", "Coordinates", "ImportRequest", "Point"]

Coordinates = Literal["LPS", "RAS"]
Point = tuple[float, float, float]

TEETH = ("tooth", "tooth:lesion")
NAMED_SITES = (
    "glenoid",
    "femoral-head",
    "humeral-head",
    "vertebra",
    "vertebra:left",
    "vertebra:right",
    *TEETH,
)
"""Sites that are searched for."""
MARKUPS = (".json", ".fcsv")
SOFT = (
    "liver|kidney|spleen|pancreas|prostate|bladder|brain|stomach|heart|lung|thyroid|muscle"
    "|gluteus|iliopsoas"
)
"""Words in the name of a label that is a soft organ."""


@dataclass(frozen=True)
class ImportRequest:
    """Options of an import, see `tissue.import_ct`.

    Raises
    ------
    InputError
        If an option has no effect with the others, or is not of its form.
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
            self._leave_out("without labels", "label_names", "region", "keep_clear", "parts")
        if self.region is not None:
            self._leave_out("with a region, whose label is the bone", "threshold")
        if self.threshold is not None:
            require_range("threshold", self.threshold, -1e9, 1e9, "use about 226 for CT")
        of_bone = ("density", "threshold", "path", "keep_clear", "crop_mm")
        if self.is_tooth:
            self._leave_out("for a tooth", "region", "parts", *of_bone)
            if self.labels is None:
                raise InputError(
                    "labels", f"be given for site {self.site}", "nothing", "give --labels FILE"
                )
        elif self.labels is not None and self.region is None:
            raise InputError(
                "region",
                "be given with labels",
                "nothing",
                "name the label that is the bone, such as --region scapula_left",
            )
        self._require_points()
        if self.point_mm is None:
            self._leave_out("unless site is a point", "normal")
        if isinstance(self.site, str) and not self.is_markups and self.site not in NAMED_SITES:
            raise InputError(
                "site",
                f"be one of {', '.join(NAMED_SITES)}, a point in mm or a .mrk.json file",
                f"{self.site}{nearest(self.site, NAMED_SITES)}",
                "choose one of these",
            )
        if self.feed_mm_s is not None:
            require_positive("feed_mm_s", self.feed_mm_s, "use about 2")
        if self.path is None:
            self._leave_out("without a path", "feed_mm_s")
        else:
            self._leave_out("with a path, which is the motion", "like")
        if self.is_soft:
            self._leave_out("for a soft organ", "like", *of_bone)
            if isinstance(self.site, str):
                raise InputError(
                    "site", "be a point for a soft organ", self.site, "give X,Y,Z in mm"
                )

    def _leave_out(self, when: str, *names: str) -> None:
        """Raise for an option that is given where it has no effect."""
        unset = {each.name: each.default for each in fields(self)} | {"parts": {}}
        for name in names:
            value = getattr(self, name)
            if value != unset[name]:
                shown = ", ".join(value) if name in ("keep_clear", "parts") else value
                raise InputError(name, f"be left out {when}", shown, "leave it out")

    def _require_points(self) -> None:
        """Refuse coordinates that are not finite, without a known frame, or in a wrong order.

        A frame without coordinates in numbers is refused too.
        """
        points: dict[str, Sequence[object]] = {
            "site": [self.site],
            "normal": [self.normal],
            "crop": self.crop_mm or (),
        }
        for name, given in points.items():
            for each in given:
                if each is not None and not isinstance(each, str) and as_vector(each) is None:
                    raise InputError(name, "be of three finite numbers", each, "give x, y, z")
        if self.coordinates not in TO_LPS:
            raise InputError(
                "coordinates", "be LPS or RAS", self.coordinates, "give the frame of the numbers"
            )
        path_in_numbers = self.path is not None and self.path.suffix.lower() not in MARKUPS
        in_numbers = path_in_numbers or self.crop_mm is not None or self.point_mm is not None
        if self.coordinates == "RAS" and not in_numbers:
            raise InputError(
                "coordinates",
                "be left out unless crop, a site or a path is given in numbers",
                "RAS",
                "files of markups state their own frame; leave it out",
            )
        if self.crop_mm is not None:
            low, high = self.crop_mm
            if any(a >= b for a, b in zip(low, high, strict=True)):
                found = f"{in_brackets(low)} and {in_brackets(high)}"
                raise InputError("crop", "have its lowest corner first", found, "exchange them")

    @property
    def is_tooth(self) -> bool:
        """True if the site is the site of a tooth."""
        return self.site in TEETH

    @property
    def is_soft(self) -> bool:
        """True if the region is a soft organ, by its name or because parts of it have moduli."""
        return bool(self.parts) or (
            self.region is not None and re.search(SOFT, self.region.lower()) is not None
        )

    @property
    def is_markups(self) -> bool:
        """True if the site is a file of markups."""
        return isinstance(self.site, str) and Path(self.site).suffix.lower() in MARKUPS

    @property
    def point_mm(self) -> Point | None:
        """The site where it is a point [mm, LPS]."""
        return None if self.site is None or isinstance(self.site, str) else self._lps(self.site)

    @property
    def normal_lps(self) -> Point | None:
        """The outward direction where it is given, in LPS."""
        return None if self.normal is None else self._lps(self.normal)

    @property
    def box_mm(self) -> Box | None:
        """The box to keep [mm, LPS], its lowest corner first."""
        if self.crop_mm is None:
            return None
        (a, b, c), (d, e, f) = map(self._lps, self.crop_mm)
        return (min(a, d), min(b, e), c), (max(a, d), max(b, e), f)

    def _lps(self, point: Point) -> Point:
        """Convert a point or direction to LPS."""
        x, y, z = point
        return (-x, -y, z) if self.coordinates == "RAS" else (x, y, z)

    def read_image(self) -> Image:
        """Read the image."""
        with names_of_caller({"file": "source", "anatomy.spacing_mm": "spacing_mm"}):
            return read_image(self.source, spacing_mm=self.spacing_mm, series=self.series)

    def read_labels(self, image: Image | None = None) -> Labels:
        """Read the labels, on the voxels of an image where it is given."""
        assert self.labels is not None
        with names_of_caller({"file": "labels", "names": "label_names"}):
            labels = read_labels(self.labels, names=self.label_names, spacing_mm=self.spacing_mm)
            return labels if image is None else on_grid_of(labels, image)
