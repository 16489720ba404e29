"""Options of an import, and the inputs that follow from them.

These inputs are the site (the place where the tool works), the structures to keep clear of, and the
toolpath.
"""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import (
    PRESENT,
    InputError,
    as_vector,
    in_brackets,
    names_of_caller,
    require_positive,
    require_range,
)
from meshes.base.hints import nearest
from meshes.base.progress import Progress
from meshes.ct.extraction import Box, kept_label
from meshes.ct.labels import Labels, on_grid_of, read_labels
from meshes.images.frame import Image
from meshes.images.reading import Spacing, read_image
from meshes.paths.toolpath import PathDepth, ReplayTable, depth_along, read_toolpath, to_replay
from meshes.surfaces.landmarks import find_site
from meshes.surfaces.markups import TO_LPS, read_site
from meshes.surfaces.site import FARTHEST_M, Site, corner_near, place_site
from meshes.surfaces.surface import Surface, surface_from_triangles
from meshes.surfaces.triangle_files import SURFACE_SUFFIXES

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
"""Names of the sites for which a search exists."""
MARKUPS = (".json", ".fcsv")
SOFT = (
    "liver|kidney|spleen|pancreas|prostate|bladder|brain|stomach|heart|lung|thyroid|muscle"
    "|gluteus|iliopsoas"
)
"""Words in the name of a label that indicate a soft organ."""


@dataclass(frozen=True)
class ImportRequest:
    """Options of an import, see `tissue.import_ct`.

    Raises
    ------
    InputError
        If an option has no effect in combination with the other options, or has an invalid form.
    """

    source: Path
    labels: Path | None = None
    label_names: str | None = None
    region: str | None = None
    crop_mm: Box | None = None
    threshold: float | None = None
    series: int | None = None
    spacing_mm: Spacing | None = None
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
        of_bone = ("density", "threshold", "path", "keep_clear", "crop_mm")
        self._require_points()
        give_labels = "give the labels by --labels FILE, or remove this option"
        give_point = "give a point as site, or remove normal"
        leave_out = "remove it"
        for is_case, case, names, remedy in (
            (
                self.labels is None,
                "if no labels are given",
                ("label_names", "region", "keep_clear", "parts"),
                give_labels,
            ),
            (
                self.region is not None,
                "with a region, whose label is the bone",
                ("threshold",),
                leave_out,
            ),
            (self.is_tooth, "for a tooth", ("region", "parts", *of_bone), leave_out),
            (self.point_mm is None, "unless site is a point", ("normal",), give_point),
            (self.path is None, "if no path is given", ("feed_mm_s",), "give --path FILE"),
            (self.path is not None, "with a path, which is the motion", ("like",), leave_out),
            (self.is_soft, "for a soft organ", ("like", *of_bone), leave_out),
        ):
            if is_case:
                self._require_unset(case, names, remedy)
        if self.threshold is not None:
            require_range("threshold", self.threshold, -1e9, 1e9, "use about 226 for CT")
        if self.is_tooth and self.labels is None:
            raise InputError(
                "labels", f"be given for site {self.site}", "nothing", "give --labels FILE"
            )
        if not self.is_tooth and self.labels is not None and self.region is None:
            raise InputError(
                "region",
                "be given with labels",
                "nothing",
                "name the label that is the bone, such as --region scapula_left",
            )
        if isinstance(self.site, str) and not self.is_markups and self.site not in NAMED_SITES:
            raise InputError(
                "site",
                f"be one of {', '.join(NAMED_SITES)}, a point in mm or a .mrk.json file",
                f"{self.site}{nearest(self.site, NAMED_SITES)}",
                "choose one of these",
            )
        if self.is_soft and isinstance(self.site, str):
            raise InputError("site", "be a point for a soft organ", self.site, "give X,Y,Z in mm")
        if self.feed_mm_s is not None:
            require_positive("feed_mm_s", self.feed_mm_s, "use about 2")

    def _require_unset(self, case: str, names: Sequence[str], remedy: str) -> None:
        """Raise an error if an option is given in a case in which it has no effect."""
        unset = {each.name: each.default for each in fields(self)} | {"parts": {}}
        for name in names:
            if getattr(self, name) != unset[name]:
                raise InputError(name, f"be left out {case}", PRESENT, remedy)

    def _require_points(self) -> None:
        """Check the points of the request and their coordinate system.

        The coordinate system RAS is an error if no coordinates are given as numbers.
        """
        points: dict[str, Sequence[object]] = {
            "site": [self.site],
            "normal": [self.normal],
            "crop_mm": self.crop_mm or (),
        }
        for name, given in points.items():
            for each in given:
                if each is not None and not isinstance(each, str) and as_vector(each) is None:
                    raise InputError(
                        name, "consist of three finite numbers", each, "give x, y and z"
                    )
        if self.coordinates not in TO_LPS:
            raise InputError(
                "coordinates",
                "be LPS or RAS",
                self.coordinates,
                "use one of these two, in capital letters",
            )
        # markups files contain their own frame
        path_in_numbers = self.path is not None and self.path.suffix.lower() not in MARKUPS
        in_numbers = path_in_numbers or self.crop_mm is not None or self.point_mm is not None
        if self.coordinates == "RAS" and not in_numbers:
            raise InputError(
                "coordinates",
                "be left out unless a box, a site or a path is given in numbers",
                "RAS",
                "remove it, because files of markups contain their own frame",
            )
        if self.crop_mm is not None and not np.less(*self.crop_mm).all():
            raise InputError(
                "crop_mm",
                "have a first corner below the second corner along each axis",
                " and ".join(map(in_brackets, self.crop_mm)),
                "exchange the two numbers of each wrong axis",
            )

    @property
    def is_tooth(self) -> bool:
        """True if the requested site is on a tooth."""
        return self.site in TEETH

    @property
    def is_soft(self) -> bool:
        """True if a soft organ is imported.

        This is the case if moduli are given for parts of the region, or if the name of the region
        contains a word for a soft organ.
        """
        return bool(self.parts) or (
            self.region is not None and re.search(SOFT, self.region.lower()) is not None
        )

    @property
    def is_markups(self) -> bool:
        """True if the site of the operation is given by a 3D Slicer markups file."""
        return isinstance(self.site, str) and Path(self.site).suffix.lower() in MARKUPS

    @property
    def point_mm(self) -> list[float] | None:
        """Site [mm, LPS] if it is given as a point; otherwise None."""
        return None if self.site is None or isinstance(self.site, str) else self._lps(self.site)

    @property
    def normal_lps(self) -> list[float] | None:
        """Outward direction in LPS; None if the request gives no direction."""
        return None if self.normal is None else self._lps(self.normal)

    @property
    def box_mm(self) -> Box | None:
        """Box of the image to keep [mm, LPS], lowest corner first; None for the whole image."""
        if self.crop_mm is None:
            return None
        # RAS has the opposite signs of x and y, so the lower and upper ends are exchanged
        low, high = np.sort([self._lps(each) for each in self.crop_mm], axis=0).tolist()
        return tuple(low), tuple(high)

    def shown(self, point_m: Array) -> str:
        """Convert a point [m, LPS] to text in mm, in the coordinate system of the request."""
        point = self._lps(1e3 * point_m)  # LPS and RAS differ by the same two signs
        # adding zero removes the sign of a negative zero
        return f"{in_brackets((each + 0.0 for each in point), '.4g')} {self.coordinates}"

    def _lps(self, point: Point | Array) -> list[float]:
        """Convert a point or direction to LPS."""
        converted: list[float] = (TO_LPS[self.coordinates] * np.asarray(point)).tolist()
        return converted

    def read_image(self) -> Image:
        """Read the image."""
        if self.source.suffix.lower() in SURFACE_SUFFIXES:
            raise InputError(
                "source",
                "be an image",
                self.source.name,
                "to use a surface, set anatomy.file to it in a scene. No import is needed",
            )
        with names_of_caller({"file": "source", "anatomy.spacing_mm": "spacing_mm"}):
            return read_image(self.source, spacing_mm=self.spacing_mm, series=self.series)

    def read_labels(self, image: Image | None = None) -> Labels:
        """Read the labels; if an image is given, resample the labels to the voxels of the image."""
        assert self.labels is not None
        with names_of_caller({"file": "labels", "names": "label_names"}):
            labels = read_labels(
                self.labels, names=self.label_names, spacing_mm=self.spacing_mm, image=image
            )
            return labels if image is None else on_grid_of(labels, image)


USUAL = (
    (r"scapula", "glenoid"),
    (r"femur", "femoral-head"),
    (r"humerus", "humeral-head"),
    (r"vertebra", "vertebra"),
)
"""Pairs of a word in the name of the bone's label and the site that is searched by default."""
JOINTS_MM = {"glenoid": 18.0, "femoral-head": 20.0, "humeral-head": 18.0}
"""Distance from the site, perpendicular to its normal, up to which a surface is articular [mm].

For the glenoid, the distance is half of the glenoid's height of 37 mm. For the heads, whose radii
are 21 to 27 mm, the distance selects a spherical cap (`meshes.surfaces.glenoid`,
`meshes.surfaces.landmarks`).
"""
KEYS = {
    "anatomy.centre_mm": "site",
    "anatomy.normal": "normal",
    "anatomy.scale_mm": "spacing in the header",
    "file": "source",
}
"""Options of an import that correspond to scene keys, keyed by scene key."""
FEED_MM_S = 2.0
"""Feed [mm/s] of a path without a feed.

The value lies between the feeds of reaming (0.5 mm/s) and milling (5 mm/s) in the built-in scenes.
"""
CLEARANCE_MM = 5.0
"""Distance along the tool's axis from the tool's start to the first point of a path [mm].

A tool that begins inside bone would remove the covered bone without a force.
"""
LONGEST = 60
"""Largest number of letters of a structure's name, which is a part of a file name.

File names have at most 255 bytes on common file systems.
"""


@dataclass(frozen=True)
class Placed:
    """Site on a bone.

    Attributes
    ----------
    site
        Centre and axes in the frame of the image.
    kind
        Name of the site that was searched for; None if the site was given as a point.
    articular_radius_mm
        Radius around the site in which the surface belongs to a joint; 0 without a joint.
    """

    site: Site
    kind: str | None = None
    articular_radius_mm: float = 0.0


def placed(request: ImportRequest, surface: Surface) -> tuple[Placed | None, str]:
    """Return the site that a request selects on a surface, and a sentence that describes the site.

    The site is None if the request names no site and the usual site is not found.

    Raises
    ------
    InputError
        If the requested site cannot be used or is not found.
    """
    point = request.point_mm
    normal = request.normal_lps
    with names_of_caller(KEYS):
        if isinstance(request.site, str) and request.is_markups:
            centre_mm, outward = read_site(Path(request.site))
            point = centre_mm.tolist()
            normal = None if outward is None else outward.tolist()
        if point is not None:
            return _at_point(request, surface, point, normal)
    if isinstance(request.site, str):
        return _searched(request.site, surface)
    # the label's name suggests a joint, such as the glenoid for a scapula
    usual = next((kind for word, kind in USUAL if re.search(word, request.region or "")), None)
    pick = "pick one by `tissue view`, or give --site"
    if usual is None:
        return None, f"site: none was given; {pick}"
    try:
        return _searched(usual, surface)
    except InputError as error:
        return None, f"site: no {usual} was found ({error}); {pick}"


def _at_point(
    request: ImportRequest, surface: Surface, point: list[float], normal: list[float] | None
) -> tuple[Placed, str]:
    """Place a site at a point [mm, LPS], and report the distance to the surface.

    Raises
    ------
    InputError
        If the point is not on the surface. The message gives the point in the coordinate system of
        the request.
    """
    centre = 1e-3 * np.array(point)
    try:
        site = place_site(surface, centre_mm=point, normal=normal)
    except InputError as error:
        if error.argument != "anatomy.centre_mm":
            raise
        remedy = (
            "give a point on the face, in mm; the nearest corner is "
            f"{request.shown(corner_near(surface, centre))}"
        )
        # RAS and LPS have opposite signs of x and y.
        flipped = centre * [-1.0, -1.0, 1.0]
        if np.linalg.norm(corner_near(surface, flipped) - flipped) < FARTHEST_M:
            other = "RAS" if request.coordinates == "LPS" else "LPS"
            remedy = f"give --coordinates {other} if the point is in {other}, or {remedy}"
        given = f"{request.shown(centre)} in {request.source.name}"
        raise InputError("site", error.requirement, given, remedy) from None
    sentence = f"site: {site.confidence}"
    moved = f"{1e3 * np.linalg.norm(site.centre_m - centre):.1f}"
    if moved != "0.0":
        sentence += f", moved {moved} mm to the surface, now at {request.shown(site.centre_m)}"
    return Placed(site), sentence


def _searched(kind: str, surface: Surface) -> tuple[Placed, str]:
    """Search for a site, and report its score and the score of the second-best site."""
    with names_of_caller(KEYS):
        found = find_site(kind, surface)
    other = "no other place has a similar score"
    if found.second_centre_mm is not None:
        other = f"the next best place scores {found.second_score:.2f}"
    site = Placed(found.site, kind, JOINTS_MM.get(kind, 0.0))
    return site, f"site: {kind} {found.site.confidence}; {other}"


def kept_clear(
    request: ImportRequest, labels: Labels | None, report: Progress
) -> tuple[dict[str, Surface], list[str]]:
    """Return the surfaces of structures that the tool must not touch, and messages for the user.

    The messages describe these structures.

    The surfaces are keyed by the names that `plain_names` returns.

    Raises
    ------
    InputError
        If a label does not exist, is given twice, or has no voxel in the image.
    """
    if labels is None or not request.keep_clear:
        return {}, []
    with names_of_caller({"label": "keep_clear"}):
        wanted = [labels.names[labels.number(name)] for name in request.keep_clear]
    if len(set(wanted)) < len(wanted):
        raise InputError(
            "keep_clear",
            "name each label once",
            ", ".join(request.keep_clear),
            "remove the repeated label",
        )
    found = {}
    sentences = []
    for name, plain in zip(wanted, plain_names(wanted), strict=True):
        report(f"finding {name}", 0.0)
        triangles, notes = kept_label(labels.image, labels.mask(name), name)
        with names_of_caller({"anatomy.scale_mm": f"keep_clear {name}"}):
            found[plain] = surface_from_triangles(
                *triangles, source=name, scale_mm=1.0, cut_off=True, every_piece=True
            )
        called = "" if plain == name else f", called {plain} in the scene"
        sentences += [f"keep clear: {name}{called}", *notes]
    return found, sentences


def plain_names(names: Sequence[str]) -> list[str]:
    """Convert the names of labels to names that a scene allows.

    The converted names consist of ASCII letters, digits and underscores, and are unique.
    """
    taken: list[str] = []
    for name in names:
        letters = (
            unicodedata.normalize("NFKD", name.casefold())
            .encode("ascii", "ignore")
            .decode()
            .lower()
        )
        first = re.sub("[^a-z0-9]+", "_", letters).strip("_")[:LONGEST] or "structure"
        plain = first
        number = 1
        while plain in taken:
            number += 1
            plain = f"{first}_{number}"
        taken.append(plain)
    return taken


@dataclass(frozen=True, eq=False)
class ImportedPath:
    """Path on a bone.

    The object contains the poses in the frame of the site, the depth below the surface, and a
    sentence that describes the path.
    """

    table: ReplayTable
    depth: PathDepth
    sentence: str


def import_path(request: ImportRequest, at: Placed | None, surface: Surface) -> ImportedPath | None:
    """Read the path of a request and convert it to the frame of the site.

    The result is None if the request has no path.

    Raises
    ------
    InputError
        If the path cannot be read or never enters the bone, or if there is no site.
    """
    if request.path is None:
        return None
    name = request.path.name
    if at is None:
        raise InputError(
            "site",
            f"be given for the path {name}",
            "nothing",
            "give a point near the start of the path by --site",
        )
    path = read_toolpath(request.path, request.coordinates)
    if path.feeds_mm_s is not None and request.feed_mm_s is not None:
        raise InputError(
            "feed_mm_s",
            f"be left out, because the path {name} contains its own feeds",
            f"{request.feed_mm_s:g}",
            "remove it",
        )
    depth = depth_along(path, surface)
    if depth.deepest_mm <= 0.0:
        raise InputError(
            "path",
            "enter the bone",
            f"{name}, which stays {-depth.deepest_mm:.3g} mm outside the bone",
            "check the unit of the path, and give its frame by --coordinates LPS or RAS",
        )
    table = to_replay(
        path, at.site, feed_mm_s=request.feed_mm_s or FEED_MM_S, clearance_mm=CLEARANCE_MM
    )
    length = float(np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1).sum())
    sentence = (
        f"path: {len(path.points_mm)} points of {name}, {length:.4g} mm in "
        f"{table.times_s[-1]:.3g} s. The tip is at most {depth.deepest_mm:.3g} mm under "
        f"the surface, and {depth.share_inside:.0%} of the path lies in the bone"
    )
    sentence = "; ".join([sentence, *path.notes])
    return ImportedPath(table, depth, sentence)
