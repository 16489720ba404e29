"""Where to work on an imported bone: as given, from markups, or searched for, and what of it is a joint."""

import re
from dataclasses import dataclass
from pathlib import Path

from meshes.base.errors import InputError, names_of_caller
from meshes.surfaces.site import Site, place_site
from meshes.surfaces.surface import Surface
from tissue.importing.request import ImportRequest

__all__ = ["Placed", "placed"]

USUAL = (
    (r"scapula", "glenoid"),
    (r"femur", "femoral-head"),
    (r"humerus", "humeral-head"),
    (r"vertebra", "vertebra"),
)
"""Site that is searched for on a bone where none is asked for, by a word in the name of its label."""
JOINTS_MM = {"glenoid": 18.0, "femoral-head": 20.0, "humeral-head": 18.0}
"""Distance from the site across its normal within which the surface is a joint's [mm]: half of the glenoid's height of
37 mm, and a cap of the heads, whose radii are 21 to 27 (`meshes.surfaces.glenoid`, `meshes.surfaces.landmarks`)."""
KEYS = {
    "anatomy.centre_mm": "site",
    "anatomy.normal": "normal",
    "anatomy.scale_mm": "spacing in the header",
    "file": "source",
}
"""What an import calls the keys of a scene."""


@dataclass(frozen=True)
class Placed:
    """A site on a bone.

    Attributes
    ----------
    site
        Centre and axes in the frame of the image.
    kind
        Name of what was searched for; None for a point.
    articular_radius_mm
        Distance from the site within which the surface is a joint's; 0 for none.
    sentence
        How it was found.
    """

    site: Site
    kind: str | None
    articular_radius_mm: float
    sentence: str


def placed(request: ImportRequest, surface: Surface) -> tuple[Placed | None, str]:
    """The site of a request, and a sentence on it; none where nothing was asked for and nothing usual is found.

    Raises
    ------
    InputError
        If the site that was asked for cannot be had.
    """
    with names_of_caller(KEYS):
        if request.point_mm is not None:
            site = place_site(surface, centre_mm=request.point_mm, normal=request.normal_lps)
            return _pointed(site)
        if isinstance(request.site, str) and request.is_markups:
            from meshes.surfaces.markups import read_site

            found = read_site(Path(request.site))
            normal = None if found.normal is None else found.normal.tolist()
            site = place_site(surface, centre_mm=found.centre_mm.tolist(), normal=normal)
            return _pointed(site)
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


def _pointed(site: Site) -> tuple[Placed, str]:
    sentence = f"site: {site.confidence}"
    return Placed(site, None, 0.0, sentence), sentence


def _searched(kind: str, surface: Surface) -> tuple[Placed, str]:
    """The site of a kind with its score and that of the second best."""
    from meshes.surfaces.landmarks import find_site

    with names_of_caller(KEYS):
        found = find_site(kind, surface)
    second = found.second_centre_mm is not None
    other = f"the next best place scores {found.second_score:.2f}" if second else "no other place came near"
    sentence = f"site: {kind} {found.site.confidence}; {other}"
    return Placed(found.site, kind, JOINTS_MM.get(kind, 0.0), sentence), sentence
