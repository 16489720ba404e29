"""Procedural glenoid with a concave pear-shaped face, and anatomies of bones given by surfaces.

The glenoid has a subchondral plate, a cortical wall and a graded trabecular vault.

In the table, the first letter states the source: R was read, and M is from memory of the
literature. The second letter is the confidence: high (H), medium (M) or low (L). A single L is an
assumption with low confidence. Cartilage is not modelled. The face is the bony face that a reamer
cuts after the cartilage has been removed.

========================  ==================  =====================================================================
width x height            27.8 x 37.5 mm      M, M: Churchill 2001 (men; women 23.6 x 32.6)
upper to lower width      0.80                M, M: Iannotti 1992, width at the middle of the upper half / full width
radius of curvature       35 mm               M, M: McPherson 1997, 32.2 antero-posterior, 40.6 supero-inferior
plate thickness           1.9 (1.2-2.9) mm    R, H: serial sections of six glenoids (Frich)
plate pattern             ±25 %               L: thicker anterior and posterior (bicentric density, M Schulz 2002)
vault depth, taper        26 mm, 15 degrees   L: to the end of the cancellous vault; the neck is not modelled
cortical wall             1.5 mm              L
density cortical          1800 kg/m3          M, H
density plate             1300 kg/m3          L: between cortical and dense trabecular bone
density trabecular        450 to 300 kg/m3    L: decreases below the plate, decay length 5 mm (M Frich 1997)
========================  ==================  =====================================================================
"""  # noqa: E501 a table

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from meshes.base.arrays import Bytes, Floats
from meshes.base.errors import InputError, Ranged, ranged, require_ranges
from meshes.shapes.anatomy import CORTICAL_KG_M3, TRABECULAR_KG_M3, Anatomy, Classify
from meshes.shapes.sdf import Shape, half_space, intersection
from meshes.surfaces.site import Site
from meshes.surfaces.surface import Surface
from meshes.voxels.mesh_sampling import TriangleSampler, triangle_distance

Thickness = Callable[[Floats, Floats], Floats]

GLENOID_LAYERS = ("subchondral", "cortical", "trabecular")
_PLATE_RANGE_M = (1.2e-3, 2.9e-3)
"""Smallest and largest thickness [m] of the subchondral plate in six glenoids (Frich)."""
_VAULT_BASE_BLEND_M = 4e-3
"""Width [m] over which the walls and the base of the vault are blended into each other.

Tools do not reach this region.
"""


@dataclass(frozen=True)
class _Pear:
    """Pear-shaped outline in the x-y plane [m]: two circles and the common tangents of the circles.

    The origin is the centre of the bounding box of the outline.
    """

    lower_radius: float
    upper_radius: float
    lower_y: float
    upper_y: float

    @property
    def tangent_sine(self) -> float:
        """Sine of the angle between the tangent and the y axis."""
        return (self.lower_radius - self.upper_radius) / (self.upper_y - self.lower_y)

    def half_width(self, y: float) -> float:
        """Compute the half width [m] at the height y [m].

        The formula is valid for y above the widest point of the lower circle.
        """
        cosine = math.sqrt(1.0 - self.tangent_sine**2)
        # The common tangent of the two circles, up to the point where it touches the upper circle.
        if y <= self.upper_y + self.upper_radius * self.tangent_sine:
            return (self.lower_radius - (y - self.lower_y) * self.tangent_sine) / cosine
        return math.sqrt(max(self.upper_radius**2 - (y - self.upper_y) ** 2, 0.0))

    def distance(self, x: Floats, y: Floats) -> Floats:
        """Compute the exact signed distance [m] to the outline, negative inside.

        The outline is the convex hull of two circles.
        """
        sine = self.tangent_sine
        cosine = math.sqrt(1.0 - sine**2)
        across = np.abs(x)
        up = y - self.lower_y
        along = cosine * up - sine * across
        span = cosine * (self.upper_y - self.lower_y)
        tangent = across * cosine + up * sine - self.lower_radius
        below = np.sqrt(across**2 + up**2) - self.lower_radius
        above = np.sqrt(across**2 + (y - self.upper_y) ** 2) - self.upper_radius
        return np.where(along < 0.0, below, np.where(along > span, above, tangent))


def _pear(width: float, height: float, upper_width_ratio: float) -> _Pear:
    """Build a pear-shaped outline of the given width and height [m].

    At the middle of the upper half, the width is `upper_width_ratio` times the full width.

    The width at the middle of the upper half increases with the radius of the upper circle. The
    radius is therefore found by bisection.
    """
    lower = 0.5 * width

    def outline(upper: float) -> _Pear:
        return _Pear(lower, upper, lower - 0.5 * height, 0.5 * height - upper)

    # Lower bound of the radius. It gives a ratio of 0.56 for the usual face, less than the allowed
    # range. 50 halvings reduce the interval to rounding errors.
    narrow = 0.3 * lower
    wide = lower
    for _ in range(50):
        middle = 0.5 * (narrow + wide)
        if outline(middle).half_width(0.25 * height) < upper_width_ratio * lower:
            narrow = middle
        else:
            wide = middle
    return outline(wide)


def _plate_thickness(
    mean: float, variation: float, half_width: float, half_height: float, x: Floats, y: Floats
) -> Floats:
    """Compute the thickness of the subchondral plate [m], limited to 1.2 to 2.9 mm.

    The plate is thicker at the anterior and posterior sides, and thinner at the superior and
    inferior sides.
    """
    pattern = np.clip((x / half_width) ** 2 - (y / half_height) ** 2, -1.0, 1.0)
    return np.clip(mean * (1.0 + variation * pattern), *_PLATE_RANGE_M)


@dataclass(frozen=True)
class GlenoidSizes(Ranged):
    """Sizes and densities of a glenoid.

    Attributes
    ----------
    width_mm, height_mm
        Antero-posterior and supero-inferior size [mm] of the articular face, from rim to rim.
    upper_width_ratio
        Width at the middle of the face's upper half, relative to the full width.
    curvature_radius_mm
        Radius of the spherical concavity [mm], larger than half the height.
    subchondral_thickness_mm, subchondral_variation
        Mean thickness of the subchondral plate [mm], and relative amplitude of the variation of
        this thickness. The thickness is limited to 1.2 to 2.9 mm.
    vault_depth_mm, vault_taper_deg
        Depth of the vault below the face's centre [mm], and taper angle of the vault's walls
        [degrees]. The vault narrows with depth.
    cortical_wall_mm
        Thickness of the cortical wall around the vault [mm].
    rim_blend_mm
        Width [mm] of the rounded rim between the face and the wall.
    cortical_density_kg_m3, subchondral_density_kg_m3
        Apparent densities [kg/m3].
    trabecular_density_kg_m3, trabecular_density_below_plate_kg_m3
        Apparent densities deep in the vault and directly below the plate [kg/m3]. The density
        decreases exponentially with depth below the plate. The decay length is 5 mm.
    """

    width_mm: float = ranged(27.8, 20.0, 34.0, "use 27.8 (men) or 23.6 (women)")
    height_mm: float = ranged(37.5, 28.0, 45.0, "use 37.5 (men) or 32.6 (women)")
    upper_width_ratio: float = ranged(0.8, 0.65, 0.95)
    curvature_radius_mm: float = ranged(35.0, 22.0, 80.0)
    subchondral_thickness_mm: float = ranged(1.9, 1.2, 2.9)
    subchondral_variation: float = ranged(0.25, 0.0, 0.5)
    vault_depth_mm: float = ranged(26.0, 8.0, 40.0)
    vault_taper_deg: float = ranged(15.0, 0.0, 25.0)
    cortical_wall_mm: float = ranged(1.5, 0.5, 4.0)
    rim_blend_mm: float = ranged(1.5, 0.0, 4.0)
    cortical_density_kg_m3: float = ranged(CORTICAL_KG_M3, 200.0, 2200.0)
    subchondral_density_kg_m3: float = ranged(1300.0, 200.0, 2200.0)
    trabecular_density_kg_m3: float = ranged(300.0, 50.0, 1200.0)
    trabecular_density_below_plate_kg_m3: float = ranged(450.0, 50.0, 1200.0)


def glenoid(**sizes: float) -> Anatomy:
    """Build a glenoid in the site frame.

    The origin is the centre of the articular face, on the surface of the bone. x is anterior, y
    superior, and z outward (lateral).

    Parameters
    ----------
    **sizes
        Sizes and densities, see `GlenoidSizes`.

    Raises
    ------
    InputError
        If a size is not finite or out of range, or if the vault or the face cannot have these
        sizes.
    """
    given = GlenoidSizes(**sizes)
    width = 1e-3 * given.width_mm
    height = 1e-3 * given.height_mm
    radius = 1e-3 * given.curvature_radius_mm
    depth = 1e-3 * given.vault_depth_mm
    taper = math.radians(given.vault_taper_deg)
    _require_fit(width, height, depth, taper, radius)
    pear = _pear(width, height, given.upper_width_ratio)
    mean = 1e-3 * given.subchondral_thickness_mm
    plate = partial(_plate_thickness, mean, given.subchondral_variation, 0.5 * width, 0.5 * height)
    notes = {
        "face": f"{given.width_mm:g} x {given.height_mm:g} mm, concave, radius "
        f"{given.curvature_radius_mm:g} mm",
        "subchondral plate": f"{given.subchondral_thickness_mm:g} mm on average, with a "
        f"variation of {100 * given.subchondral_variation:g} %",
        "vault": (
            f"{given.vault_depth_mm:g} mm deep, then cut off: the neck and the blade of the "
            "scapula are not modelled"
        ),
        "cartilage": "not modelled",
        "trabecular density": f"{given.trabecular_density_below_plate_kg_m3:g} to "
        f"{given.trabecular_density_kg_m3:g} kg/m3, a prior of low confidence",
    }
    return Anatomy(
        "procedural glenoid",
        _bone(pear, radius, depth, taper, 1e-3 * given.rim_blend_mm),
        GLENOID_LAYERS,
        _layers(plate, radius, given),
        notes,
    )


def _require_fit(width: float, height: float, depth: float, taper: float, radius: float) -> None:
    """Raise an error if a combination of sizes would close the vault or cut off the face."""
    if radius <= 0.5 * height:
        raise InputError(
            "curvature_radius_mm",
            f"exceed half of height_mm ({500 * height:g})",
            f"{1e3 * radius:g}",
            "use a value such as 35",
        )
    # If the face is closer to a circle, the half width does not increase with the upper radius, and
    # the bisection of `_pear` fails. For a ratio of height to width of 1.02, the bisection ends at
    # its lower bound for any width ratio.
    if height < 1.1 * width:
        raise InputError(
            "height_mm",
            f"be at least 1.1 times width_mm ({1e3 * width:g})",
            f"{1e3 * height:g}",
            "use 37.5 with width_mm = 27.8",
        )
    # At 0.5, the walls would meet. At least a tenth of the width must stay open.
    if depth * math.tan(taper) > 0.45 * width:
        raise InputError(
            "vault_taper_deg",
            "leave the vault open at its base",
            f"{math.degrees(taper):g} over a depth of {1e3 * depth:g} mm",
            f"use at most {math.degrees(math.atan(0.45 * width / depth)):.1f}",
        )


def _bone(pear: _Pear, radius: float, depth: float, taper: float, blend: float) -> Shape:
    """Build the outer surface of a glenoid.

    The pear-shaped outline is extruded along z. Below z = 0, the wall is inclined inward. A ball is
    subtracted to make the top concave, and a plane cuts off the base.
    """
    sine = math.sin(taper)
    cosine = math.cos(taper)
    half_width = pear.lower_radius
    half_height = pear.lower_radius - pear.lower_y
    rim = radius - math.sqrt(radius**2 - half_height**2)

    def wall_distance(p: Floats) -> Floats:
        outline = pear.distance(p[:, 0], p[:, 1])
        return np.maximum(outline, outline * cosine - p[:, 2] * sine)

    def dish_distance(p: Floats) -> Floats:
        return radius - np.sqrt(p[:, 0] ** 2 + p[:, 1] ** 2 + (p[:, 2] - radius) ** 2)

    walls = Shape(
        wall_distance, (-half_width, -half_height, -depth), (half_width, half_height, rim)
    )
    lid = half_space((0.0, 0.0, 1.0), (0.0, 0.0, rim))
    dished = intersection(walls & lid, Shape(dish_distance), blend_m=blend)
    return intersection(
        dished, half_space((0.0, 0.0, -1.0), (0.0, 0.0, -depth)), blend_m=_VAULT_BASE_BLEND_M
    )


def _layers(plate: Thickness, radius: float, sizes: GlenoidSizes) -> Classify:
    """Return a function that computes the layer and density of points from their depths.

    The layer depends on the depth below the concave face and on the depth below the outer surface.
    """
    wall = 1e-3 * sizes.cortical_wall_mm
    deep = sizes.trabecular_density_kg_m3
    below_plate = sizes.trabecular_density_below_plate_kg_m3
    dense = sizes.subchondral_density_kg_m3
    cortical = sizes.cortical_density_kg_m3
    decay = 5e-3  # decay length of the density below the plate [m], see above

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        """Return layer and density [kg/m3], shape (n,), of points [m], shape (n, 3).

        The depths below the surface have the unit m.
        """
        x = points[:, 0]
        y = points[:, 1]
        z = points[:, 2]
        below = np.sqrt(x**2 + y**2 + (z - radius) ** 2) - radius - plate(x, y)
        layer = np.where(below < 0.0, 0, np.where(depth < wall, 1, 2)).astype(np.uint8)
        graded = deep + (below_plate - deep) * np.exp(-np.maximum(below, 0.0) / decay)
        density = np.where(layer == 0, dense, np.where(layer == 1, cortical, graded)).astype(
            points.dtype
        )
        return layer, density

    return classify


SURFACE_LAYERS = ("cortical", "trabecular")


def surface_anatomy(
    surface: Surface,
    site: Site,
    *,
    cortical_thickness_mm: float = 1.9,
    cortical_density_kg_m3: float = CORTICAL_KG_M3,
    trabecular_density_kg_m3: float = TRABECULAR_KG_M3,
) -> Anatomy:
    """Build the anatomy of a bone surface in the site frame.

    The bone consists of a cortical shell with constant thickness, and trabecular bone inside. A
    surface contains no information about the interior, so thickness and densities are assumptions.
    The assumptions are recorded in the notes. The default thickness is the mean thickness of the
    subchondral plate in six glenoids (1.2-2.9 mm, Frich). For the default densities, see
    `CORTICAL_KG_M3` and `TRABECULAR_KG_M3`.

    Parameters
    ----------
    cortical_thickness_mm
        Thickness of the shell [mm], 0 (no shell) to 10.
    cortical_density_kg_m3, trabecular_density_kg_m3
        Apparent densities [kg/m3], 50 to 2500.

    Raises
    ------
    InputError
        If a parameter is not finite or out of range.
    """
    thickness, dense, sparse = require_ranges(
        # The ranges are wide. They exclude values in metres and in g/cm3.
        ("cortical_thickness_mm", cortical_thickness_mm, 0.0, 10.0, "use a value such as 1.9"),
        (
            "cortical_density_kg_m3",
            cortical_density_kg_m3,
            50.0,
            2500.0,
            "use a value such as 1800",
        ),
        (
            "trabecular_density_kg_m3",
            trabecular_density_kg_m3,
            50.0,
            2500.0,
            "use a value such as 350",
        ),
    )
    shell = 1e-3 * thickness

    def classify(points: Floats, depth: Floats) -> tuple[Bytes, Floats]:
        layer = (depth >= shell).astype(np.uint8)
        return layer, np.where(layer == 0, np.float32(dense), np.float32(sparse))

    notes = {
        "cortical shell": f"{cortical_thickness_mm:g} mm of {dense:g} kg/m3 over {sparse:g} "
        "kg/m3, assumed: the file holds a surface only",
    }
    sampler = TriangleSampler(site.to_site(surface.vertices_m), surface.faces, shell)
    return sampled_anatomy(surface, site, sampler, SURFACE_LAYERS, classify, notes)


def sampled_anatomy(
    surface: Surface,
    site: Site,
    sampler: TriangleSampler,
    layer_names: tuple[str, ...],
    classify: Classify,
    notes: Mapping[str, str],
) -> Anatomy:
    """Build an anatomy from a surface and a sampler of the surface's triangles.

    The anatomy is in the frame of `site`. The notes of the anatomy describe the surface, its unit,
    its repairs and the site. The argument `notes` replaces or extends these notes.
    """
    vertices = sampler.vertices_m
    report = surface.report
    notes = {
        "surface": report.source,
        "unit": report.unit_guess,
        "site": site.confidence,
        "repairs": " ".join(report.repairs) or "none",
        **notes,
    }

    def distance(points: Floats) -> Floats:
        return triangle_distance(vertices, sampler.faces, points).astype(points.dtype)

    return Anatomy(
        report.source,
        Shape(distance, tuple(vertices.min(axis=0).tolist()), tuple(vertices.max(axis=0).tolist())),
        layer_names,
        classify,
        notes,
        sampler,
        site.placement(report.scale_mm),
        tuple(site.to_site(points) for points in surface.caps_m),
    )
