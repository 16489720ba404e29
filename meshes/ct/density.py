"""Apparent density of bone from grey values, with the uncertainty of the line that is used."""

from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from meshes.base.arrays import Numbers, Singles
from meshes.base.errors import InputError, require_range, require_ranges

__all__ = ["ASH_SHARE", "ASH_SHARE_SD", "CT_DENSITY", "DensityLaw", "scanner_law"]

ASH_SHARE = 0.598
ASH_SHARE_SD = 0.004
"""Standard deviation of the ratio of ash to apparent density of human bone.

The ratio is for cortical and trabecular bone together: 0.598 +- 0.004 (Schileo et al. 2008, J
Biomech 41:2483).
"""


@dataclass(frozen=True)
class DensityLaw:
    """Apparent density [kg/m3] = slope * grey value + offset, limited to a range.

    Apparent density is wet mass over the volume with its pores. The uncertainties belong to the
    line. They include neither the noise of a voxel nor the blur of thin bone.

    Attributes
    ----------
    slope_kg_m3, offset_kg_m3
        Density per grey value and at grey value 0 [kg/m3].
    lowest_kg_m3, highest_kg_m3
        Limits [kg/m3].
    name, source
        Name of the line, and its source.
    covariance
        Variance of the slope, covariance of both, variance of the offset [(kg/m3)^2].
    residual_sd_kg_m3
        Standard deviation of the measured densities from the line [kg/m3].
    relative_sd
        Relative standard deviation of a factor of the whole density, such as the ratio of ash to
        apparent density.
    """

    slope_kg_m3: float
    offset_kg_m3: float
    lowest_kg_m3: float = 50.0
    highest_kg_m3: float = 2000.0
    name: str = "line"
    source: str = "given"
    covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    residual_sd_kg_m3: float = 0.0
    relative_sd: float = 0.0

    def __post_init__(self) -> None:
        require_ranges(
            ("slope_kg_m3", self.slope_kg_m3, -1e6, 1e6, "use about 1.48 for Hounsfield units"),
            ("offset_kg_m3", self.offset_kg_m3, -1e6, 1e6, "use about 106 for Hounsfield units"),
            ("highest_kg_m3", self.highest_kg_m3, 1.0, 20000.0, "use 2000"),
            ("lowest_kg_m3", self.lowest_kg_m3, 0.0, self.highest_kg_m3, "use 50"),
            (
                "residual_sd_kg_m3",
                self.residual_sd_kg_m3,
                0.0,
                20000.0,
                "use 0 where it is not known",
            ),
            (
                "relative_sd",
                self.relative_sd,
                0.0,
                1.0,
                "use 0.007 for the ratio of ash to apparent density",
            ),
        )
        slope, both, offset = self.covariance
        if not (slope >= 0.0 and offset >= 0.0 and both * both <= slope * offset * (1.0 + 1e-9)):
            raise InputError(
                "covariance",
                "be of two numbers",
                f"variances {slope:g} and {offset:g} with covariance {both:g}",
                "use what a regression states, or zeros",
            )

    def __call__(self, values: Numbers) -> Singles:
        """Compute the density [kg/m3] of grey values, same shape."""
        density = np.float32(self.slope_kg_m3) * values + np.float32(self.offset_kg_m3)
        return np.clip(density, self.lowest_kg_m3, self.highest_kg_m3).astype(np.float32)

    def sd(self, values: Numbers) -> Singles:
        """Compute the standard uncertainty of the density [kg/m3] of mean grey values.

        It is the uncertainty before the limits are applied.
        """
        values = np.asarray(values, dtype=np.float64)
        slope, both, offset = self.covariance
        scaled = self.relative_sd * (self.slope_kg_m3 * values + self.offset_kg_m3)
        variance = (
            slope * values**2 + 2.0 * both * values + offset + self.residual_sd_kg_m3**2 + scaled**2
        )
        return np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)

    def band(self, values: Numbers, share: float = 0.9) -> tuple[Singles, Singles]:
        """Compute bounds [kg/m3] of the density of tissue of mean grey values.

        The density lies within the bounds with probability `share`.

        Raises
        ------
        InputError
            If `share` is not in [0.01, 0.999].
        """
        share = require_range("share", share, 0.01, 0.999, "use 0.9")
        values = np.asarray(values, dtype=np.float64)
        half = NormalDist().inv_cdf(0.5 + 0.5 * share) * self.sd(values)
        middle = self.slope_kg_m3 * values + self.offset_kg_m3
        low, high = (
            np.clip(bound, self.lowest_kg_m3, self.highest_kg_m3)
            for bound in (middle - half, middle + half)
        )
        return low.astype(np.float32), high.astype(np.float32)

    def as_dict(self) -> dict[str, Any]:
        """Return the law as a JSON object, densities in kg/m3."""
        return {**asdict(self), "covariance": list(self.covariance)}


def scanner_law(
    name: str,
    ash_kg_m3: float,
    offset_kg_m3: float,
    *,
    source: str,
    slope_sd: float,
    offset_sd_kg_m3: float,
) -> DensityLaw:
    """Return the law of one scanner's line to ash density [kg/m3].

    Its uncertainty includes the difference to other scanners.

    Parameters
    ----------
    name, source
        See `DensityLaw`.
    ash_kg_m3, offset_kg_m3
        Ash density per Hounsfield unit and at 0 [kg/m3].
    slope_sd
        Relative standard deviation of the slope.
    offset_sd_kg_m3
        Standard deviation of the apparent density at 0 Hounsfield units [kg/m3].
    """
    slope = ash_kg_m3 / ASH_SHARE
    return DensityLaw(
        slope,
        offset_kg_m3 / ASH_SHARE,
        name=name,
        source=(
            f"{source}; ash over apparent {ASH_SHARE} (Schileo 2008); uncertain as another "
            "scanner's line"
        ),
        covariance=((slope_sd * slope) ** 2, 0.0, offset_sd_kg_m3**2),
        relative_sd=ASH_SHARE_SD / ASH_SHARE,
    )


CT_DENSITY = scanner_law(
    "ct",
    0.887,
    63.3,
    source="ash 0.887 HU + 63.3 kg/m3 of one scanner",
    slope_sd=0.27,
    offset_sd_kg_m3=60.0,
)
"""Hounsfield units to apparent density by one scanner's line: calibrate before relying on it.

Its band is wide enough to hold bone by the tables of `meshes.ct.calibration` at 62 to 80 keV, which
is 8 to 39 % less dense than the line.
"""
