"""Finding the ball of a joint on a bone: the spherical cap of 18 to 32 mm radius that covers most of its sphere.

Every sample of the surface votes for the centres that lie inward of it along its normal, one for each radius. The cells
of space with the most votes start a fit of a sphere to the samples that lie on it and face away from its centre. A cap
is as good as the share of its sphere that the bone covers, and as its samples lie close to it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, in_brackets
from meshes.surfaces.glenoid_search import SurfaceSamples, sample_surface
from meshes.surfaces.site import FoundSite, site_along
from meshes.surfaces.surface import Surface

__all__ = ["HEADS", "Head", "SphericalCap", "find_head", "spherical_caps"]

_SAMPLES = 12000
_SMOOTH_M = 3e-3
_RADII_M = np.arange(18e-3, 32.5e-3, 1e-3)
"""Femoral heads are 36 to 58 mm across (Unnanuntana 2010), humeral heads 37 to 57 mm (Hertel 2002), with 2 mm added."""
_CELL_M = 4e-3
_STARTS, _REFINEMENTS = 40, 15
_OFF = 0.03
"""Greatest distance from the sphere of a sample that lies on it, in radii: 0.7 mm at 24 mm."""
_FACING = 0.93
_DIRECTIONS = 600
_LEAST_SCORE = 0.2
_ALIKE = 0.85
"""Share of the best score from which the second best place is as good."""
_APART_RADII = 1.0
_NECK = (1.1, 1.5)
_NECK_WIDE = 1.15


@dataclass(frozen=True)
class Head:
    """What a joint's ball looks like.

    Attributes
    ----------
    name
        Of the bone's part, in words.
    coverage
        Shares of the sphere between which the score rises from 0 to 1.
    most
        Greatest share of the sphere.
    neck
        Whether its axis is that of the neck below it; without, that of the cap itself.
    """

    name: str
    coverage: tuple[float, float]
    most: float
    neck: bool


HEADS = {
    "femoral-head": Head("femoral head", (0.60, 0.75), 0.96, neck=True),
    "humeral-head": Head("humeral head", (0.34, 0.42), 0.66, neck=False),
}
"""Shares of the sphere. Measured: heads of two femurs 0.76 and 0.77, of four humeri 0.46 to 0.56 (the articular cap
alone is 0.35 to 0.4, Hertel 2002), condyles, trochanters, vertebrae and bones of the foot at most 0.32."""


@dataclass(frozen=True, eq=False)
class SphericalCap:
    """A part of a surface that lies on a sphere.

    Attributes
    ----------
    centre_m, radius_m
        Of the sphere [m].
    axis
        Unit vector from the centre to the middle of the cap, shape (3,).
    coverage
        Share of the sphere that the cap covers.
    misfit_m
        Root mean square of its distance from the sphere [m].
    compactness
        How much it is one round cap instead of patches, at most 1.
    """

    centre_m: NDArray[np.float64]
    radius_m: float
    axis: NDArray[np.float64]
    coverage: float
    misfit_m: float
    compactness: float

    def score(self, kind: Head) -> float:
        """Likeness to a head, 0 to 1."""
        none, certain = kind.coverage
        covered = float(np.clip((self.coverage - none) / (certain - none), 0.0, 1.0))
        return covered * self.compactness**2 * (1.0 - self.misfit_m / (2.0 * _OFF * self.radius_m))


def find_head(surface: Surface, kind: Head) -> FoundSite:
    """Find a joint's ball: the site lies where its axis leaves it, z along that axis.

    Raises
    ------
    InputError
        If no part of the surface is such a cap, as on a shaft, or a whole ball is.
    """
    samples = sample_surface(*surface.scanned, _SAMPLES)
    caps = sorted(spherical_caps(samples), key=lambda cap: -cap.score(kind))
    if not caps or caps[0].score(kind) < _LEAST_SCORE or max(cap.coverage for cap in caps) > kind.most:
        widest = max(caps, key=lambda cap: cap.coverage, default=None)
        got = "none"
        if widest is not None:
            got = f"{widest.coverage:.0%} at {1e3 * widest.radius_m:.1f} mm (score {caps[0].score(kind):.2f}) at best"
        raise InputError(
            f"file must show a {kind.name}, one round cap of 18 to 32 mm radius over {kind.coverage[0]:.0%} to "
            f"{kind.most:.0%} of its sphere, got {got} in {surface.report.source}: check anatomy.scale_mm, or give "
            "anatomy.centre_mm and anatomy.normal"
        )
    best, score = caps[0], caps[0].score(kind)
    apart = [cap for cap in caps if np.linalg.norm(cap.centre_m - best.centre_m) > _APART_RADII * best.radius_m]
    second = apart[0] if apart and apart[0].score(kind) > 0.0 else None
    if second is not None and second.score(kind) > _ALIKE * score:
        places = (in_brackets(1e3 * cap.centre_m, ".4g") for cap in (best, second))
        raise InputError(
            f"file must show one {kind.name}, got two places alike in {surface.report.source}, with scores of "
            f"{score:.2f} and {second.score(kind):.2f} about {' and '.join(places)} mm: give anatomy.centre_mm and "
            "anatomy.normal"
        )
    axis = _neck_axis(samples, best) if kind.neck else best.axis
    note = (
        f"found by search: {kind.name} of radius {1e3 * best.radius_m:.1f} mm over {best.coverage:.0%} of its sphere, "
        f"{1e3 * best.misfit_m:.2f} mm off it, score {score:.2f} of 1; check it in the picture"
    )
    site = site_along(surface, best.centre_m + best.radius_m * axis, axis, note)
    if second is None:
        return FoundSite(site, score, 0.0, None)
    return FoundSite(site, score, second.score(kind), 1e3 * (second.centre_m + second.radius_m * second.axis))


def spherical_caps(samples: SurfaceSamples) -> list[SphericalCap]:
    """Spherical caps of 18 to 32 mm radius on a surface, from the best supported starts, some perhaps the same."""
    points, normals = samples.points, _smoothed(samples)
    votes = (points[:, None] - _RADII_M[:, None] * normals[:, None]).reshape(-1, 3)
    radius = np.tile(_RADII_M, len(points))
    first = votes.min(axis=0)
    place = np.floor((votes - first) / _CELL_M).astype(np.int64)
    shape = place.max(axis=0) + 1
    level = np.tile(np.arange(len(_RADII_M)) // 2, len(points))
    cell = np.ravel_multi_index((*place.T, level), (*shape.tolist(), int(level.max()) + 1))
    _, inverse, counts = np.unique(cell, return_inverse=True, return_counts=True)
    caps = []
    for each in np.argsort(-counts, kind="stable")[: 10 * _STARTS : 10].tolist():
        chosen = inverse == each
        cap = _fitted(points, normals, votes[chosen].mean(axis=0), float(radius[chosen].mean()))
        if cap is not None:
            caps.append(cap)
    return caps


def _smoothed(samples: SurfaceSamples) -> NDArray[np.float64]:
    """Mean normals around each sample: those of voxels and of few large triangles are steps."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(samples.points).query_pairs(_SMOOTH_M, output_type="ndarray")
    facing = np.einsum("ij,ij->i", samples.normals[pairs[:, 0]], samples.normals[pairs[:, 1]]) > 0.0
    one, other = pairs[facing].T
    total = samples.normals.copy()
    for axis in range(3):
        for here, there in ((one, other), (other, one)):
            total[:, axis] += np.bincount(here, samples.normals[there, axis], minlength=len(total))
    length = np.linalg.norm(total, axis=1)
    return np.asarray(total / np.maximum(length, 1e-12)[:, None])


def _fitted(
    points: NDArray[np.float64], normals: NDArray[np.float64], centre: NDArray[np.float64], radius: float
) -> SphericalCap | None:
    """Sphere through the samples that lie on it and face outward, refined from a start; None if it leaves the range."""
    on = np.zeros(len(points), dtype=bool)
    for turn in range(_REFINEMENTS):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=1)
        facing = np.einsum("ij,ij->i", normals, offset) > _FACING * distance
        near = max(_OFF, 0.12 - 0.02 * turn)
        on = (np.abs(distance - radius) < near * radius) & facing
        if on.sum() < 30:
            return None
        terms = np.column_stack([2.0 * points[on], np.ones(int(on.sum()))])
        square = np.einsum("ij,ij->i", points[on], points[on])
        solved = np.linalg.lstsq(terms, square, rcond=None)[0]
        centre, radius = solved[:3], float(np.sqrt(max(solved[3] + solved[:3] @ solved[:3], 0.0)))
        if not _RADII_M[0] - 1e-3 < radius < _RADII_M[-1] + 1e-3:
            return None
    if not _RADII_M[0] <= radius <= _RADII_M[-1]:
        return None
    offset = points[on] - centre
    distance = np.linalg.norm(offset, axis=1)
    covered = _covered(offset / distance[:, None])
    total = covered.sum(axis=0)
    length = float(np.linalg.norm(total))
    axis = total / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    misfit = float(np.sqrt(np.mean((distance - radius) ** 2)))
    share = len(covered) / _DIRECTIONS
    compactness = length / max(len(covered) * (1.0 - share), 1.0)  # of a round cap the mean direction is 1 - share long
    return SphericalCap(centre, radius, axis, share, misfit, min(compactness, 1.0))


def _covered(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Those of evenly spread directions (a Fibonacci sphere) that have one of the given within 8 degrees."""
    from scipy.spatial import cKDTree

    number = np.arange(_DIRECTIONS) + 0.5
    height = 1.0 - 2.0 * number / _DIRECTIONS
    angle = np.pi * (1.0 + np.sqrt(5.0)) * number
    across = np.sqrt(1.0 - height**2)
    even = np.column_stack([across * np.cos(angle), across * np.sin(angle), height])
    distance, _ = cKDTree(directions).query(even)
    return np.asarray(even[distance < 0.14])


def _neck_axis(samples: SurfaceSamples, cap: SphericalCap) -> NDArray[np.float64]:
    """Direction from the middle of the neck's sections to the centre of the head, or the cap's where there is no neck.

    Sections lie across the axis 1.1 to 1.5 radii below the head's centre.
    """
    axis = cap.axis
    for _ in range(5):
        offset = (samples.points - cap.centre_m) / cap.radius_m
        below = -(offset @ axis)
        across = offset + below[:, None] * axis
        neck = (below > _NECK[0]) & (below < _NECK[1]) & (np.linalg.norm(across, axis=1) < _NECK_WIDE)
        if neck.sum() < 30:
            return cap.axis
        u = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        u /= np.linalg.norm(u)
        v = np.cross(axis, u)
        around = np.arctan2(across[neck] @ v, across[neck] @ u)
        sector = np.floor((around / (2.0 * np.pi) + 0.5) * 12.0).astype(int) % 12
        ring = [offset[neck][sector == each].mean(axis=0) for each in range(12) if (sector == each).any()]
        if len(ring) < 10:
            return cap.axis
        middle = np.mean(ring, axis=0)
        axis = -middle / np.linalg.norm(middle)
    return np.asarray(axis if axis @ cap.axis > 0.8 else cap.axis)
