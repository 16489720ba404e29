"""Material constants of this package with their sources: cutting coefficients and priors.

A cited constant is a constant in the TOML files of this package, which state its source.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.resources import files
from typing import ClassVar, TypedDict

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError

UM = 1e-6  # [m]
N_MM2 = 1e6  # [Pa]
N_MM = 1e3  # [N/m]
LINEAR = {"size_exponent": 0.0, "minimum_chip_um": 0.0, "reference_chip_um": 100.0}
"""Constants of the size effect for a material without a size effect.

The cutting law is then linear in the chip thickness.
"""
CUT_AS = {
    "enamel": "enamel",
    "dentin": "dentin",
    "caries": "dentin",
    "pulp": "soft",
    "ligament": "soft",
}
"""Name of the material whose cutting coefficients a layer of a tooth uses.

Layers that are not listed use a material of bone.
"""


@dataclass(frozen=True)
class Constant:
    """Cited constant with value, plausible range and source.

    The name of a constant states the unit.
    """

    value: float
    low: float
    high: float
    source: str
    confidence: str


class Entry(TypedDict):
    """Cited constant as it is written in a TOML file."""

    value: float
    range: list[float]
    source: str
    confidence: str


@dataclass(frozen=True)
class CuttingCoefficients:
    """Cutting coefficients of a material: chip coefficients [Pa] and edge coefficients [N/m].

    The chip coefficients are valid at the reference chip thickness. How they depend on the chip
    thickness (size effect) is described in `effective_chip`. Without a minimum chip thickness the
    law is linear in the chip thickness.
    """

    tangential_chip_Pa: float
    radial_chip_Pa: float
    axial_chip_Pa: float
    tangential_edge_N_m: float
    radial_edge_N_m: float
    axial_edge_N_m: float
    reference_density_kg_m3: float
    density_exponent: float
    size_exponent: float = 0.0
    minimum_chip_m: float = 0.0
    reference_chip_m: float = 1e-4

    def __post_init__(self) -> None:
        if self.size_exponent > 0.0 and self.minimum_chip_m <= 0.0:
            raise InputError(
                "cutting.minimum_chip_um",
                "be above 0 with a size effect, because its coefficients are infinite at 0",
                f"{1e6 * self.minimum_chip_m:g}",
                "use a value such as 1, or set cutting.size_exponent to 0",
            )

    CHIP: ClassVar[tuple[str, ...]] = "tangential_chip_Pa", "radial_chip_Pa", "axial_chip_Pa"
    EDGE: ClassVar[tuple[str, ...]] = "tangential_edge_N_m", "radial_edge_N_m", "axial_edge_N_m"


def effective_chip(
    thickness_m: Array, exponent: ArrayLike, minimum_m: ArrayLike, reference_m: ArrayLike
) -> tuple[Array, Array]:
    """Return effective chip thickness [m] and active share of the edge force, shape (n,) each.

    The force per edge length is the chip coefficient times the effective thickness, plus the edge
    coefficient times this share. See `kernels.cutting` for the law.

    Parameters
    ----------
    thickness_m
        Chip thickness h [m], shape (n,).
    exponent, minimum_m, reference_m
        Exponent m, minimum thickness h_min [m] and reference thickness h_0 [m] of each chip.
    """
    minimum = np.asarray(minimum_m, float)
    cut = np.maximum(thickness_m, minimum)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(cut > 0.0, (cut / reference_m) ** -np.asarray(exponent, float), 1.0)
        share = np.where(thickness_m < minimum, thickness_m / minimum, 1.0)
    return thickness_m * scale, share


@cache
def constants(table: str, material: str) -> dict[str, Constant]:
    """Return the constants of a material in the TOML file of a table.

    The keys are the names of the constants, including their units.

    Raises
    ------
    InputError
        If the material is not listed.
    """
    entries = _table(table)
    if material not in entries:
        raise InputError(
            "material", f"be one of {', '.join(entries)}", material, "choose a listed name"
        )
    return {
        name: Constant(
            entry["value"],
            entry["range"][0],
            entry["range"][1],
            entry["source"],
            entry["confidence"],
        )
        for name, entry in entries[material].items()
    }


def listed(table: str) -> tuple[str, ...]:
    """Return the names of the materials in the TOML file of a table, in the order of the file."""
    return tuple(_table(table))


def thermal_material(layer: str) -> str:
    """Return the material in ``tooth.toml`` whose thermal constants apply to a layer.

    Each layer of a tooth has its own thermal constants. All layers of bone use the same thermal
    constants.
    """
    return layer if layer in CUT_AS else "bone"


def add_material(table: str, material: str, entries: dict[str, Entry]) -> None:
    """Add a material to a table in this process; the TOML file of the table is not changed.

    Raises
    ------
    InputError
        If the table already has a material with this name.
    """
    known = _table(table)
    if material in known:
        raise InputError(
            "material", f"not be one of {', '.join(known)}", material, "choose another name"
        )
    known[material] = entries


@cache
def _table(table: str) -> dict[str, dict[str, Entry]]:
    return tomllib.loads(files("tissue.materials").joinpath(f"{table}.toml").read_text("utf-8"))


def cutting_coefficients(material: str, **changes: float | None) -> CuttingCoefficients:
    """Return the cutting coefficients of a material in SI units.

    ``changes`` replace some of the constants. As in the TOML file, the names in ``changes`` include
    the unit.

    Raises
    ------
    InputError
        If the material or a constant's name is not listed.
    """
    return changed_coefficients(constants("cutting", material), changes)


def changed_coefficients(
    cited: Mapping[str, Constant], changes: Mapping[str, float | None]
) -> CuttingCoefficients:
    """Convert cutting constants to cutting coefficients in SI units.

    ``changes`` replace some of the constants. A minimum chip thickness of zero selects the linear
    law, which has no size effect.

    Raises
    ------
    InputError
        If ``changes`` contains a name that is not a constant.
    """
    values = LINEAR | {name: constant.value for name, constant in cited.items()}
    for name, value in changes.items():
        if name not in values:
            raise InputError(
                "cutting", f"set one of {', '.join(values)}", name, "choose a listed name"
            )
        if value is not None:
            values[name] = value
    # If the caller adds a size effect without a minimum chip thickness, an error is raised below.
    if values["minimum_chip_um"] == 0.0 and not changes.get("size_exponent"):
        values["size_exponent"] = 0.0
    found: dict[str, float] = {}
    for side in ("tangential", "radial", "axial"):
        found[f"{side}_chip_Pa"] = values[f"{side}_chip_N_mm2"] * N_MM2
        found[f"{side}_edge_N_m"] = values[f"{side}_edge_N_mm"] * N_MM
    return CuttingCoefficients(
        **found,
        reference_density_kg_m3=values["reference_density_kg_m3"],
        density_exponent=values["density_exponent"],
        size_exponent=values["size_exponent"],
        minimum_chip_m=values["minimum_chip_um"] * UM,
        reference_chip_m=values["reference_chip_um"] * UM,
    )


Z_95 = 1.6448536269514722
"""95 % quantile of the standard normal distribution."""
W_95 = 1.959963984540054
"""95 % quantile of the absolute value of a standard normal variable."""
BOUNDS = {
    "poisson_ratio": (0.0, 0.49995),
    "prony_g1": (0.0, 0.5),
    "prony_g2": (0.0, 0.5),
    "heat_share": (0.0, 1.0),
}
"""Smallest and largest value with which a scene can be built, keyed by the constant's name.

Only constants whose range is close to a limit are listed. These are Poisson's ratios of nearly
incompressible solids, relaxation shares (their sum must be below 1), and the share of heat. Cited
ranges of Poisson's ratio end at 0.4999.
"""
NEAR_ZERO = 0.05
"""Threshold below which a prior compresses values, relative to the cited value (judgement).

If the range of a constant begins at zero, small values are compressed so that they stay above zero,
see `Prior`.
"""


@dataclass(frozen=True)
class Prior:
    """Distribution of a constant, given by its median and its 5 and 95 % quantiles.

    A number z ~ N(0, 1) is mapped to y = y_value + c (exp(g z) - 1). Here y_value is y at the
    median, and c and g follow from the three quantiles. Hence y has a shifted log-normal
    distribution, or a normal one for g = 0. The constant x follows from y:

    - With `bounds`: y = logit of x between the bounds.
    - With a positive range: y = ln x.
    - With a range that contains negative numbers: y = x.
    - With a range that begins at zero: y = s ln(exp(x / s) - 1) with s = 0.05 `value`. Then y is
      close to x if x is well above s, and x is always positive. The 5 % quantile is 0.035 `value`.

    If `value` is an end of the range, the distribution is half-normal from there, and 95 % of it
    lies inside the range.

    Attributes
    ----------
    value, low, high
        Median, 5 % quantile and 95 % quantile in the unit of the constant.
    bounds
        Smallest and largest possible value of the constant; None if there are no bounds.

    Raises
    ------
    InputError
        If the value lies outside its range, or a number is not finite.
    """

    value: float
    low: float
    high: float
    bounds: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite([self.low, self.high]).all() and self.low <= self.value <= self.high):
            raise InputError(
                "range",
                f"contain the value {self.value:g}",
                f"[{self.low:g}, {self.high:g}]",
                "give its 5 and 95 % quantiles",
            )

    @classmethod
    def of(cls, constant: Constant, name: str) -> "Prior":
        """Return the prior of a cited constant.

        Parameters
        ----------
        constant
            Value and range.
        name
            Name of the constant, such as ``soft.liver.poisson_ratio``. The last part of the name,
            such as ``poisson_ratio``, selects the bounds.
        """
        bounds = BOUNDS.get(name.rpartition(".")[2])
        # The logit is infinite at a bound.
        is_inside = bounds is not None and bounds[0] < constant.low and constant.high < bounds[1]
        return cls(constant.value, constant.low, constant.high, bounds if is_inside else None)

    @property
    def fixed(self) -> bool:
        """True if the range is a single number, so that the constant cannot be estimated."""
        return self.low == self.high

    @property
    def is_one_sided(self) -> bool:
        """True if the value is an end of its range."""
        return not self.fixed and self.value in (self.low, self.high)

    def mirrored(self) -> "Prior":
        """Return the two-sided prior that consists of this one-sided prior and its mirror image.

        The prior is mirrored at `value`.
        """
        low, value, high = self._knots
        outer = [min(low, 2.0 * value - high), max(high, 2.0 * value - low)]
        ends = self._from_y(np.array(outer)).tolist()
        return Prior(self.value, min(ends[0], self.low), max(ends[1], self.high), self.bounds)

    def x(self, z: ArrayLike) -> Array:
        """Return the constant's values for standard normal numbers `z`, an array of any shape."""
        return self._from_y(self._y(np.asarray(z, float)))

    def slope(self, z: ArrayLike) -> Array:
        """Return the derivative dx/dz, with the shape of z."""
        z = np.asarray(z, float)
        x = self.x(z)
        slope_y = self._slope_y(z)
        if self.bounds is not None:
            least, most = self.bounds
            return slope_y * (x - least) * (most - x) / (most - least)
        if self._is_log:
            return slope_y * x
        if self._is_near_zero:
            return slope_y * -np.expm1(-x / self._squeeze)
        return slope_y

    def z(self, x: ArrayLike) -> Array:
        """Return the standard normal numbers z for which the constant has the values x.

        For values outside the support of the distribution, the result is infinite.
        """
        x = np.asarray(x, float)
        if self.fixed:
            return np.zeros(x.shape)
        share = (self._to_y(x) - self._knots[1]) / self._span
        if self.is_one_sided:
            from scipy.special import erf, erfc, ndtri

            w = W_95 * np.maximum(share, 0.0)
            with np.errstate(divide="ignore"):
                # erf rounds to 1 for large w, and erfc rounds to 1 for small w.
                z = np.where(w > 1.0, -ndtri(erfc(w / np.sqrt(2.0))), ndtri(erf(w / np.sqrt(2.0))))
            return z if self._span > 0.0 else -z
        skew = self._skew
        # -1: limit of the logarithm; values outside the support have an infinite z.
        stretched = np.maximum(share * np.expm1(skew), -1.0)
        with np.errstate(divide="ignore"):
            grown = np.log1p(stretched)
        # Without skew the distribution is normal. The quotient would be 0 / 0.
        return Z_95 * (share if abs(skew) < 1e-9 else grown / skew)

    @property
    def _is_log(self) -> bool:
        return self.bounds is None and self.low > 0.0

    @property
    def _is_near_zero(self) -> bool:
        return self.bounds is None and self.low == 0.0 < self.value

    @property
    def _squeeze(self) -> float:
        return NEAR_ZERO * self.value

    @cached_property
    def _knots(self) -> tuple[float, float, float]:
        """Coordinates y of `low`, `value` and `high`."""
        low, value, high = self._to_y(np.array([self.low, self.value, self.high])).tolist()
        # y is -inf at x = 0. At y = 0, the constant is 0.035 times its median.
        return (0.0 if self._is_near_zero else low), value, high

    @cached_property
    def _skewed(self) -> float:
        """Factor (exp(s) - 1) / s with the skew s of `_skew`; cached because it is used often."""
        from scipy.special import exprel

        return float(exprel(self._skew))

    @cached_property
    def _span(self) -> float:
        """Signed distance in y from the value to the upper end of the range.

        If the value is the upper end, the result is the distance to the lower end.
        """
        low, value, high = self._knots
        return low - value if self.value == self.high else high - value

    @cached_property
    def _skew(self) -> float:
        """Logarithm of (y_high - y_value) / (y_value - y_low)."""
        low, value, high = self._knots
        return float(np.log((high - value) / (value - low)))

    def _y(self, z: Array) -> Array:
        from scipy.special import exprel

        middle = self._knots[1]
        if self.fixed:
            return np.full(z.shape, middle)
        if self.is_one_sided:
            return middle + self._span * _absolute(z if self._span > 0.0 else -z) / W_95
        return middle + self._span * z / Z_95 * exprel(self._skew * z / Z_95) / self._skewed

    def _slope_y(self, z: Array) -> Array:
        if self.fixed:
            return np.zeros(z.shape)
        if self.is_one_sided:
            w = _absolute(z if self._span > 0.0 else -z)
            # Ratio of the densities of z and of its absolute value w.
            return abs(self._span) / W_95 * 0.5 * np.exp(0.5 * (w * w - z * z))
        return self._span / Z_95 * np.exp(self._skew * z / Z_95) / self._skewed

    def _to_y(self, x: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.bounds is not None:
                return np.log(x - self.bounds[0]) - np.log(self.bounds[1] - x)
            if self._is_log:
                return np.log(x)
            if self._is_near_zero:
                return x + self._squeeze * np.log(-np.expm1(-x / self._squeeze))
            return x

    def _from_y(self, y: Array) -> Array:
        if self.bounds is not None:
            least, most = self.bounds
            return least + (most - least) * np.exp(-np.logaddexp(0.0, -y))
        if self._is_log:
            return np.exp(y)
        if self._is_near_zero:
            return self._squeeze * np.logaddexp(0.0, y / self._squeeze)
        return y


def _absolute(z: Array) -> Array:
    """Convert standard normal numbers to half-normal numbers with equal cumulative probability.

    The result increases with z and is positive.
    """
    from scipy.special import erfinv, ndtr, ndtri

    # The two forms are mathematically equal. Each form is accurate in one tail.
    upper = -ndtri(0.5 * ndtr(-np.maximum(z, 0.0)))
    return np.where(z > 0.0, upper, np.sqrt(2.0) * erfinv(ndtr(np.minimum(z, 0.0))))
