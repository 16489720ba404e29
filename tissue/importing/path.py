"""A person's own toolpath on an imported bone: in the site's frame, with times and the depth that it will cut."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.paths.depth import PathDepth, depth_along
from meshes.paths.replay_table import ReplayTable, to_replay
from meshes.paths.toolpath import read_toolpath
from meshes.surfaces.surface import Surface
from tissue.figures.ct_pictures import draw_path_depth
from tissue.importing.placing import Placed
from tissue.importing.request import ImportRequest

__all__ = ["ImportedPath", "import_path"]

FEED_MM_S = 2.0
"""Where a path states none: between reaming (0.5) and milling (5) of the built-in scenes."""
CLEARANCE_MM = 5.0
"""How far outside its first point the tool begins."""


@dataclass(frozen=True, eq=False)
class ImportedPath:
    """A path on a bone.

    Attributes
    ----------
    table
        Its poses in the frame of the site.
    points_mm, depth_mm
        Points along it [mm, LPS], shape (n, 3), and their depth below the surface [mm], shape (n,).
    sentence
        What it does.
    """

    table: ReplayTable
    points_mm: NDArray[np.float64]
    depth_mm: NDArray[np.float64]
    sentence: str

    def draw(self, surface: Surface, at: Placed, file: Path) -> list[str]:
        """Draw it on the bone in the colours of its depth; returns why it could not be drawn, a sentence."""
        found = PathDepth(self.points_mm, self.depth_mm)
        problem = draw_path_depth(surface, found, file, normal=at.site.rotation[:, 2], title=surface.report.source)
        return [] if problem is None else [f"{file.name} was not drawn: {problem}"]


def import_path(request: ImportRequest, at: Placed | None, surface: Surface) -> ImportedPath:
    """Read the path of a request and bring it to its site.

    Raises
    ------
    InputError
        If it cannot be read, never enters the bone, or there is no site.
    """
    assert request.path is not None
    if at is None:
        raise InputError(
            f"site must be given with a path, got none for {request.path.name}: give a point near its start by --site"
        )
    path = read_toolpath(request.path, request.coordinates)
    stated = path.feeds_mm_s is not None
    if stated and request.feed_mm_s is not None:
        raise InputError(
            f"feed_mm_s must be left out for a path that states its own, got {request.feed_mm_s:g} for "
            f"{request.path.name}: leave it out"
        )
    depth = depth_along(path, surface)
    if depth.deepest_mm <= 0.0:
        raise InputError(
            f"path must enter the bone, got {request.path.name}, which stays {-depth.deepest_mm:.3g} mm outside: check "
            "its frame by --coordinates LPS or RAS"
        )
    feed = request.feed_mm_s or FEED_MM_S
    table = to_replay(path, at.site, feed_mm_s=feed, clearance_mm=CLEARANCE_MM)
    length = float(np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1).sum())
    sentence = (
        f"path: {len(path.points_mm)} points of {request.path.name}, {length:.4g} mm in {table.times_s[-1]:.3g} s, its "
        f"tip at most {depth.deepest_mm:.3g} mm under the surface and {depth.share_inside:.0%} of it in the bone"
    )
    return ImportedPath(table, depth.points_mm, depth.depth_mm, sentence)
