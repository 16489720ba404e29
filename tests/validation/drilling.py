"""Closed form of a drill that advances along its axis, for many samples of the constants at once.

Every ring of the point at a radius r with the width dr cuts N dr / sin(k) of edge, with k the angle
between the axis and the outline (90 degrees on the chisel edge). With f the feed per turn::

    h = f / N sin(k)
    thrust = integral N (K_rc c + K_re e) F_r dr
    torque = integral N (K_tc c + K_te e) F_t r / sin(k) dr

c is the effective chip thickness and e the share of the edge force, functions of h. F_t and F_r are
the factors of `tissue.cutters.drill_point`. All coefficients scale with the density. Axial
coefficients are cited as 0 without a range and left out. Lengths in mm, forces in N.
"""

from dataclasses import dataclass, replace

import numpy as np

from meshes.base.arrays import Array
from tissue.cutters.drill_point import DrillPoint
from tissue.fitting.bands.sample import normals
from tissue.materials.constants import Prior, constants, effective_chip

__all__ = [
    "DEFAULT",
    "GEOMETRY",
    "OLD",
    "SAMPLES",
    "VARIANTS",
    "Law",
    "Loads",
    "Point",
    "drill_loads",
    "nominal_law",
    "nominal_point",
    "sampled_law",
    "sampled_points",
    "standard",
]

SAMPLES = 2048
SEED = 40
FLUTES = 2
RINGS = 48
"""Rings on the lips. The thrust changes by less than 0.1 % with twice as many."""
UNUSED = ("axial_chip_N_mm2", "axial_edge_N_mm", "reference_chip_um")
"""Constants of bone without a range. The axial ones are 0."""
NAMES = tuple(name for name in constants("cutting", "bone") if name not in UNUSED)
GEOMETRY = {
    "web_share": Prior(0.18, 0.12, 0.23),
    "helix_deg": Prior(30.0, 20.0, 40.0),
    "point_angle_deg": Prior(118.0, 90.0, 130.0),
}
"""Geometry of a drill that no source states: defaults and ranges of `tissue.cutters.profile`.

The range of the point angle is an assumption.
"""
COLUMNS = (*NAMES, *GEOMETRY)
OLD = {
    "tangential_chip_N_mm2": 150.0,
    "radial_chip_N_mm2": 60.0,
    "tangential_edge_N_mm": 5.0,
    "radial_edge_N_mm": 4.0,
}
"""Coefficients of bone before they were taken from the sawing data."""


def standard(width: int) -> Array:
    """Return standard normal numbers of all samples, shape (SAMPLES, columns + width).

    The first columns are those of `COLUMNS`, the others belong to a data set.
    """
    return normals(SAMPLES, len(COLUMNS) + width, seed=SEED)


@dataclass(frozen=True)
class Law:
    """Constants of the cutting law, each of shape (n,), in the units of ``cutting.toml``."""

    values: dict[str, Array]

    def __getitem__(self, name: str) -> Array:
        return self.values[name]

    def changed(self, **changes: float) -> "Law":
        """Return the law with some constants set in every sample."""
        size = len(self["radial_chip_N_mm2"])
        return Law(self.values | {name: np.full(size, value) for name, value in changes.items()})

    def strength(self, density_kg_m3: Array) -> Array:
        """Return the factor of all coefficients at a density, shape (n,)."""
        return (density_kg_m3 / self["reference_density_kg_m3"]) ** self["density_exponent"]

    def chip_and_edge(self, thickness_mm: Array) -> tuple[Array, Array]:
        """Return the effective chip thickness [mm] and the share of the edge force.

        The thickness [mm] has shape (n, ...).
        """
        wide = (slice(None),) + (None,) * (thickness_mm.ndim - 1)
        return effective_chip(
            thickness_mm,
            self["size_exponent"][wide],
            1e-3 * self["minimum_chip_um"][wide],
            np.array(0.1),
        )


@dataclass(frozen=True)
class Point:
    """Rings of the points of drills, shape (n, rings), with radii relative to the drill's radius.

    ``share`` is the width of each ring relative to the drill's radius. ``sine`` is the sine of the
    angle between axis and outline. The first ring is the chisel edge.
    """

    radius: Array
    share: Array
    sine: Array
    factors: Array


def point_of(web_share: float, helix_deg: float, point_angle_deg: float) -> Point:
    """Return the rings of one drill, shape (1, rings); a web of 0 is the simple drill."""
    half = np.radians(0.5 * point_angle_deg)
    if web_share == 0.0:
        chisel = 0.0
        middle = (np.arange(RINGS) + 0.5) / RINGS
        factors = np.ones((RINGS, 2))
    else:
        drill = DrillPoint(1.0, 2.0 * web_share, np.radians(helix_deg), 2.0 * half)
        chisel = drill.chisel_radius_m
        middle = chisel + (1.0 - chisel) * (np.arange(RINGS) + 0.5) / RINGS
        factors = drill.load_factors(middle)
    lip_share = np.full(RINGS, (1.0 - chisel) / RINGS)
    lip_sine = np.full(RINGS, np.sin(half))
    if chisel > 0.0:
        at = np.array([0.5 * chisel])
        middle = np.concatenate([at, middle])
        factors = np.vstack([drill.load_factors(at), factors])
        lip_share = np.concatenate([[chisel], lip_share])
        lip_sine = np.concatenate([[1.0], lip_sine])
    return Point(middle[None], lip_share[None], lip_sine[None], factors[None])


def nominal_point() -> Point:
    """Return the rings of a drill with the usual geometry."""
    return point_of(*(prior.value for prior in GEOMETRY.values()))


def sampled_points(z: Array, web_share: Array | None = None) -> Point:
    """Return the rings of drills with the geometry of each sample, shape (n, rings)."""
    columns = [prior.x(z[:, len(NAMES) + at]) for at, prior in enumerate(GEOMETRY.values())]
    if web_share is not None:
        columns[0] = web_share
    points = [point_of(*map(float, row)) for row in np.column_stack(columns)]
    return Point(
        *(
            np.concatenate([getattr(each, name) for each in points])
            for name in ("radius", "share", "sine", "factors")
        )
    )


def nominal_law() -> Law:
    """Return the cited values of bone, shape (1,)."""
    cited = constants("cutting", "bone")
    return Law({name: np.array([cited[name].value]) for name in NAMES})


def sampled_law(z: Array) -> Law:
    """Return samples over the cited ranges of bone, as `tissue run --band` draws them."""
    cited = constants("cutting", "bone")
    return Law({name: Prior.of(cited[name], name).x(z[:, at]) for at, name in enumerate(NAMES)})


@dataclass(frozen=True)
class Loads:
    """Parts of thrust [N] and torque [N mm], each of shape (n,)."""

    thrust_chip: Array
    thrust_edge: Array
    torque_chip: Array
    torque_edge: Array

    @property
    def thrust_N(self) -> Array:
        """Thrust [N]."""
        return self.thrust_chip + self.thrust_edge

    @property
    def torque_Nmm(self) -> Array:
        """Torque [N mm]."""
        return self.torque_chip + self.torque_edge

    def scaled(self, chip: float, edge: float) -> "Loads":
        """Return the loads with chip and edge coefficients multiplied by factors."""
        return replace(
            self,
            thrust_chip=chip * self.thrust_chip,
            thrust_edge=edge * self.thrust_edge,
            torque_chip=chip * self.torque_chip,
            torque_edge=edge * self.torque_edge,
        )


def drill_loads(
    law: Law, point: Point, *, diameter_mm: Array, feed_per_turn_mm: Array, density_kg_m3: Array
) -> Loads:
    """Return the loads of a fully engaged point, shape (n,).

    The last three have shape (n,) or are numbers.
    """
    radius_mm = 0.5 * np.asarray(diameter_mm, float).reshape(-1, 1)
    feed_mm = np.asarray(feed_per_turn_mm, float).reshape(-1, 1)
    strength = law.strength(np.asarray(density_kg_m3, float).reshape(-1))
    thickness = feed_mm / FLUTES * point.sine
    size = max(len(thickness), len(law["radial_chip_N_mm2"]), len(radius_mm))
    chip, edge = law.chip_and_edge(np.broadcast_to(thickness, (size, thickness.shape[1])))
    width = FLUTES * radius_mm * point.share
    arm = radius_mm * point.radius
    parts = {}
    for name, each in (("chip", chip), ("edge", edge)):
        unit = "N_mm2" if name == "chip" else "N_mm"
        radial = law[f"radial_{name}_{unit}"]
        tangential = law[f"tangential_{name}_{unit}"]
        pushed = radial * (width * each * point.factors[..., 1]).sum(axis=1)
        turned = tangential * (width * each * point.factors[..., 0] * arm / point.sine).sum(axis=1)
        parts[f"thrust_{name}"] = strength * pushed
        parts[f"torque_{name}"] = strength * turned
    return Loads(**parts)


DEFAULT = "minimum chip, chisel and rake (default)"
"""Variant of the cited constants and the usual drill."""
VARIANTS: dict[str, tuple[dict[str, float], bool]] = {
    "earlier constants, simple law, simple drill": (OLD | {"minimum_chip_um": 0.0}, False),
    "simple law, simple drill": ({"minimum_chip_um": 0.0}, False),
    "minimum chip, simple drill": ({}, False),
    DEFAULT: ({}, True),
    "size exponent 0.15, chisel and rake": ({"size_exponent": 0.15}, True),
}
"""Variants by name: constants that change, and whether the drill has chisel edge and rake."""


def variant(name: str) -> tuple[Law, Point]:
    """Return law and drill of a variant, at the cited values, shape (1,)."""
    changes, refined = VARIANTS[name]
    return nominal_law().changed(**changes), nominal_point() if refined else point_of(
        0.0, 0.0, 118.0
    )
