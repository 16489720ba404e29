"""Points of a tool's whole body, its edges and its inside among them: what must not come near to something."""

from math import ceil, pi

import numpy as np
from numpy.typing import NDArray

from tissue.cutters.cutter import spiral
from tissue.cutters.profile import Profile

__all__ = ["body_points"]

ON_SURFACE, INSIDE = 3000, 1000
"""About as many points on the surface and in the inside at most."""


def body_points(profile: Profile, *, spacing_m: float) -> NDArray[np.float64]:
    """Points of a body of revolution [m], shape (n, 3), origin at the tip.

    They cover what cuts and what does not, up to the profile's top, every ring at which the outline bends, and the
    inside on a lattice, so that a thin structure does not vanish in the body. They lie `spacing_m` [m] apart on the
    surface, or farther where there would be too many: two points a distance s apart on a ball of radius r miss a plane
    by s²/(4r) at most.
    """
    spacing = max(spacing_m, (sum(piece.area_m2 for piece in profile.pieces) / ON_SURFACE) ** 0.5)
    parts = [spiral(piece, spacing_m=spacing)[0] for piece in profile.pieces]
    for radius, height in [*profile.edges.tolist(), *((0.0, height) for height in profile.height_range_m)]:
        count = max(ceil(2.0 * pi * radius / spacing), 1)
        turn = np.arange(count) * (2.0 * pi / count)
        ring = radius * np.column_stack([np.cos(turn), np.sin(turn)])
        parts.append(np.column_stack([ring, np.full(count, height)]))
    return np.concatenate([*parts, _inside(profile, spacing)])


def _inside(profile: Profile, spacing: float) -> NDArray[np.float64]:
    """Points of a cubic lattice inside a profile, deeper than half their distance."""
    reach, (low, high) = profile.radius_m, profile.height_range_m
    pitch = max(2.0 * spacing, (pi * reach**2 * (high - low) / INSIDE) ** (1.0 / 3.0))
    across = pitch * np.arange(-ceil(reach / pitch), ceil(reach / pitch) + 1)
    grid = np.stack(np.meshgrid(across, across, np.arange(low, high, pitch), indexing="ij"), axis=-1).reshape(-1, 3)
    half = np.column_stack([np.hypot(grid[:, 0], grid[:, 1]), grid[:, 2]])
    return np.asarray(grid[profile.distance(half)[0] < -0.5 * pitch])
