"""Searching a bone's surface for the place where people work on it, with how far the second best place was behind."""

from meshes.base.errors import InputError
from meshes.surfaces.pedicles import VERTEBRA, find_pedicle
from meshes.surfaces.site import FoundSite, search_glenoid
from meshes.surfaces.spherical_head import HEADS, find_head
from meshes.surfaces.surface import Surface

__all__ = ["SITE_KINDS", "FoundSite", "find_site"]

SITE_KINDS = ("glenoid", *HEADS, *VERTEBRA)
"""What `find_site` can search for."""


def find_site(kind: str, surface: Surface) -> FoundSite:
    """Search a bone for a site; nothing depends on where the bone lies and how it is turned.

    Parameters
    ----------
    kind
        ``glenoid``: the middle of a scapula's socket, z out of it, y superior. ``femoral-head`` and ``humeral-head``:
        where the axis of the neck, or of the articular cap, comes out of the head. ``vertebra:left`` and
        ``vertebra:right``: where the axis of that pedicle comes out of the arch behind, z out along it, y up;
        ``vertebra``: of the wider one.
    surface
        One bone alone.

    Raises
    ------
    InputError
        If there is no such kind, nothing on the surface looks like one, or two places do alike.
    """
    if kind == "glenoid":
        return search_glenoid(surface)
    if kind in VERTEBRA:
        return find_pedicle(surface, kind)
    if kind in HEADS:
        return find_head(surface, HEADS[kind])
    raise InputError(f"site must be one of {', '.join(SITE_KINDS)}, got {kind}: use one of them, or give a point")
