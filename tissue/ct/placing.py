"""Placement of work on an imported bone: its site, the structures to keep clear of, and the
toolpath.
"""

import re
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError, names_of_caller
from meshes.base.progress import Progress
from meshes.ct.extraction import kept_label
from meshes.ct.labels import Labels
from meshes.paths.toolpath import PathDepth, ReplayTable, depth_along, read_toolpath, to_replay
from meshes.surfaces.landmarks import find_site
from meshes.surfaces.markups import read_site
from meshes.surfaces.site import Site, place_site
from meshes.surfaces.surface import Surface, surface_from_triangles
from tissue.ct.request import ImportRequest

__all__ = ["ImportedPath", "Placed", "import_path", "kept_clear", "placed", "plain_names"]

USUAL = (
    (r"scapula", "glenoid"),
    (r"femur", "femoral-head"),
    (r"humerus", "humeral-head"),
    (r"vertebra", "vertebra"),
)
"""Site that is searched for by default, by a word in the name of the bone's label."""
JOINTS_MM = {"glenoid": 18.0, "femoral-head": 20.0, "humeral-head": 18.0}
"""Distance from the site across its normal within which the surface belongs to a joint [mm].

It is half of the glenoid's height of 37 mm, and a cap of the heads, whose radii are 21 to 27 mm
(`meshes.surfaces.glenoid`, `meshes.surfaces.landmarks`).
"""
KEYS = {
    "anatomy.centre_mm": "site",
    "anatomy.normal": "normal",
    "anatomy.scale_mm": "spacing in the header",
    "file": "source",
}
"""Options of an import by the keys of a scene."""
FEED_MM_S = 2.0
"""Feed of a path without a feed, between reaming (0.5) and milling (5) of the built-in scenes."""
CLEARANCE_MM = 5.0
"""Distance outside the first point of a path at which the tool begins."""
LONGEST = 60
"""Letters of a structure's name, which is part of a file's name."""


@dataclass(frozen=True)
class Placed:
    """Site on a bone.

    Attributes
    ----------
    site
        Centre and axes in the frame of the image.
    kind
        Name of the searched site. None for a point.
    articular_radius_mm
        Distance from the site within which the surface belongs to a joint. 0 without a joint.
    """

    site: Site
    kind: str | None = None
    articular_radius_mm: float = 0.0


def placed(request: ImportRequest, surface: Surface) -> tuple[Placed | None, str]:
    """Return the site of a request and a sentence on it.

    The result is None if the request names no site and the usual site is not found.

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
            point = _three(centre_mm)
            normal = None if outward is None else _three(outward)
        if point is not None:
            site = place_site(surface, centre_mm=point, normal=normal)
            return Placed(site), f"site: {site.confidence}"
    if isinstance(request.site, str):
        return _searched(request.site, surface)
    usual = next((kind for word, kind in USUAL if re.search(word, request.region or "")), None)
    pick = "pick one by `tissue view`, or give --site"
    if usual is None:
        return None, f"site: none was asked for; {pick}"
    try:
        return _searched(usual, surface)
    except InputError as error:
        return None, f"site: no {usual} was found ({error}); {pick}"


def _three(numbers: Sequence[float] | np.ndarray) -> tuple[float, float, float]:
    x, y, z = map(float, numbers)
    return x, y, z


def _searched(kind: str, surface: Surface) -> tuple[Placed, str]:
    """Search for a site; report its score and the score of the second best."""
    with names_of_caller(KEYS):
        found = find_site(kind, surface)
    second = found.second_centre_mm is not None
    other = (
        f"the next best place scores {found.second_score:.2f}"
        if second
        else "no other place came near"
    )
    site = Placed(found.site, kind, JOINTS_MM.get(kind, 0.0))
    return site, f"site: {kind} {found.site.confidence}; {other}"


def kept_clear(
    request: ImportRequest, labels: Labels | None, report: Progress
) -> tuple[dict[str, Surface], list[str]]:
    """Return the surfaces of the labels that the tool must not touch, by plain name, and sentences.

    Raises
    ------
    InputError
        If there is no such label, it is named twice, or the image contains no voxel of it.
    """
    if labels is None or not request.keep_clear:
        return {}, []
    with names_of_caller({"label": "keep_clear"}):
        wanted = [labels.names[labels.number(name)] for name in request.keep_clear]
    if len(set(wanted)) < len(wanted):
        raise InputError(
            "keep_clear", "name each label once", ", ".join(request.keep_clear), "leave one out"
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
    """Convert names of labels to names that a scene accepts.

    They consist of plain letters, digits and underscores, and each name is used once.
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
    """A path on a bone: its poses in the frame of the site, its depth under the surface, and a
    sentence on it.
    """

    table: ReplayTable
    depth: PathDepth
    sentence: str


def import_path(request: ImportRequest, at: Placed | None, surface: Surface) -> ImportedPath | None:
    """Read the path of a request and move it to its site.

    The result is None if the request has no path.

    Raises
    ------
    InputError
        If it cannot be read, never enters the bone, or there is no site.
    """
    if request.path is None:
        return None
    name = request.path.name
    if at is None:
        raise InputError(
            "site",
            "be given with a path",
            f"none for {name}",
            "give a point near its start by --site",
        )
    path = read_toolpath(request.path, request.coordinates)
    if path.feeds_mm_s is not None and request.feed_mm_s is not None:
        raise InputError(
            "feed_mm_s",
            "be left out for a path that states its own",
            f"{request.feed_mm_s:g} for {name}",
            "leave it out",
        )
    depth = depth_along(path, surface)
    if depth.deepest_mm <= 0.0:
        raise InputError(
            "path",
            "enter the bone",
            f"{name}, which stays {-depth.deepest_mm:.3g} mm outside",
            "check its frame by --coordinates LPS or RAS",
        )
    table = to_replay(
        path, at.site, feed_mm_s=request.feed_mm_s or FEED_MM_S, clearance_mm=CLEARANCE_MM
    )
    length = float(np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1).sum())
    sentence = (
        f"path: {len(path.points_mm)} points of {name}, {length:.4g} mm in "
        f"{table.times_s[-1]:.3g} s, its tip at most "
        f"{depth.deepest_mm:.3g} mm under the surface and {depth.share_inside:.0%} of it in "
        "the bone"
    )
    return ImportedPath(table, depth, sentence)
