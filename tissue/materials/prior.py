"""Prior of a cited constant: a smooth, increasing map of a standard normal number.

The map passes through the value and the range of the constant.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import erf, erfc, erfinv, ndtr, ndtri

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.materials.constants import Constant

__all__ = ["Prior"]

Z_95 = 1.6448536269514722
"""95 % quantile of a standard normal number."""
W_95 = 1.959963984540054
"""95 % quantile of the absolute value of a standard normal number."""
BOUNDS = {
    "poisson_ratio": (0.0, 0.49995),
    "prony_g1": (0.0, 0.5),
    "prony_g2": (0.0, 0.5),
    "heat_share": (0.0, 1.0),
}
"""Smallest and largest value with which a scene can be built, by the name of a constant.

Only constants whose range is close to these limits are listed: nearly incompressible solids, and
relaxation shares whose sum must stay below one.
"""
NEAR_ZERO = 0.05
"""Threshold of the soft limit above zero, as a share of the cited value.

If a range begins at zero, values below this threshold are compressed so that they stay above zero.
"""


@dataclass(frozen=True)
class Prior:
    """Distribution of a constant with median `value` and 5 and 95 % quantiles `low` and `high`.

    A number z ~ N(0, 1) is mapped to y = y_value + c (exp(g z) - 1). This is the shifted log-normal
    (or normal) distribution through the three quantiles. The constant x follows from y:

    - With `bounds`: y = logit of x between the bounds.
    - With a positive range: y = ln x.
    - With a range that contains negative numbers: y = x.
    - With a range from zero: y = s ln(exp(x / s) - 1) with s = 0.05 value. Then y is close to x
      where x is well above s, and x stays positive. The quantile `low` is 0.035 value.

    If the value is at one end of its range, the distribution is half-normal on the other side, with
    95 % of it inside the range.

    Attributes
    ----------
    value, low, high
        Median and quantiles in the unit of the constant.
    bounds
        Smallest and largest value of any draw; None without bounds.

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
                f"hold the value {self.value:g}",
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
            Name of the constant, such as ``soft.liver.poisson_ratio``. The last part selects the
            bounds.
        """
        bounds = BOUNDS.get(name.rpartition(".")[2])
        is_inside = bounds is not None and bounds[0] < constant.low and constant.high < bounds[1]
        return cls(constant.value, constant.low, constant.high, bounds if is_inside else None)

    @property
    def fixed(self) -> bool:
        """True if the range is a single number, so that there is nothing to identify."""
        return self.low == self.high

    @property
    def is_one_sided(self) -> bool:
        """True if the value is an end of its range."""
        return not self.fixed and self.value in (self.low, self.high)

    def mirrored(self) -> "Prior":
        """Return a two-sided prior: a one-sided prior together with its reflection at the value."""
        low, value, high = self._knots
        outer = [min(low, 2.0 * value - high), max(high, 2.0 * value - low)]
        ends = self._from_y(np.array(outer)).tolist()
        return Prior(self.value, min(ends[0], self.low), max(ends[1], self.high), self.bounds)

    def x(self, z: ArrayLike) -> Array:
        """Return the values of the constant for standard normal numbers, of any shape."""
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
        """Return the standard normal numbers of values; infinite outside the support."""
        x = np.asarray(x, float)
        if self.fixed:
            return np.zeros(x.shape)
        share = (self._to_y(x) - self._knots[1]) / self._span
        if self.is_one_sided:
            w = W_95 * np.maximum(share, 0.0)
            with np.errstate(divide="ignore"):
                z = np.where(w > 1.0, -ndtri(erfc(w / np.sqrt(2.0))), ndtri(erf(w / np.sqrt(2.0))))
            return z if self._span > 0.0 else -z
        skew = self._skew
        stretched = np.maximum(share * np.expm1(skew), -1.0)
        with np.errstate(divide="ignore"):
            grown = np.log1p(stretched)
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
        """Coordinates y of low, value and high."""
        low, value, high = self._to_y(np.array([self.low, self.value, self.high])).tolist()
        return (0.0 if self._is_near_zero else low), value, high

    @cached_property
    def _skewed(self) -> float:
        """Factor between shift and span of the log-normal distribution, cached for all values."""
        return float(_relative(self._skew))

    @cached_property
    def _span(self) -> float:
        """Signed distance in y from the value to the upper end of the range.

        If the value is the upper end, it is the distance to the lower end.
        """
        low, value, high = self._knots
        return low - value if self.value == self.high else high - value

    @cached_property
    def _skew(self) -> float:
        """Logarithm of the ratio of the upper to the lower half of the range, in y."""
        low, value, high = self._knots
        return float(np.log((high - value) / (value - low)))

    def _y(self, z: Array) -> Array:
        middle = self._knots[1]
        if self.fixed:
            return np.full(z.shape, middle)
        if self.is_one_sided:
            return middle + self._span * _absolute(z if self._span > 0.0 else -z) / W_95
        return middle + self._span * z / Z_95 * _relative(self._skew * z / Z_95) / self._skewed

    def _slope_y(self, z: Array) -> Array:
        if self.fixed:
            return np.zeros(z.shape)
        if self.is_one_sided:
            w = _absolute(z if self._span > 0.0 else -z)
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


def _relative(power: ArrayLike) -> Array:
    """Return (exp(power) - 1) / power, which is one at zero."""
    power = np.asarray(power, float)
    small = np.abs(power) < 1e-9
    return np.where(small, 1.0 + 0.5 * power, np.expm1(power) / np.where(small, 1.0, power))


def _absolute(z: Array) -> Array:
    """Return the absolute value of a normal number as a function of its quantile.

    The function increases with z and starts from zero.
    """
    upper = -ndtri(0.5 * ndtr(-np.maximum(z, 0.0)))
    return np.where(z > 0.0, upper, np.sqrt(2.0) * erfinv(ndtr(np.minimum(z, 0.0))))
