"""Linear laws that convert grey values to the apparent density of bone, with uncertainties."""

from dataclasses import asdict, dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from meshes.base.arrays import Numbers, Singles
from meshes.base.errors import InputError, enumerated, require_range

ASH_SHARE = 0.598
ASH_SHARE_SD = 0.004
"""Standard deviation of `ASH_SHARE`, the ratio of ash density to apparent density of human bone.

The ratio is 0.598 +- 0.004 for cortical and trabecular bone (Schileo et al. 2008, J Biomech
41:2483).
"""


@dataclass(frozen=True)
class DensityLaw:
    """Apparent density [kg/m3] = slope * grey value + offset, limited to a range.

    Apparent density is wet mass divided by volume, including pores. The uncertainties describe only
    the linear relation. They do not include the noise of a voxel or the blur of thin bone.

    Attributes
    ----------
    slope_kg_m3, offset_kg_m3
        Density per unit of grey value, and density at grey value 0 [kg/m3].
    lowest_kg_m3, highest_kg_m3
        Limits of the density [kg/m3].
    name, source
        Name and source of the linear relation.
    covariance
        Variance of the slope, covariance of slope and offset, and variance of the offset
        [(kg/m3)^2].
    relative_sd
        Relative standard deviation of a factor that multiplies all densities, such as the ratio of
        ash density to apparent density.
    """

    slope_kg_m3: float
    offset_kg_m3: float
    lowest_kg_m3: float = 50.0
    highest_kg_m3: float = 2000.0
    name: str = "line"
    source: str = "given"
    covariance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    relative_sd: float = 0.0

    def __call__(self, values: Numbers) -> Singles:
        """Compute the density [kg/m3] of grey values. The result has the shape of `values`."""
        density = np.float32(self.slope_kg_m3) * values + np.float32(self.offset_kg_m3)
        return np.clip(density, self.lowest_kg_m3, self.highest_kg_m3).astype(np.float32)

    def sd(self, values: Numbers) -> Singles:
        """Compute the standard uncertainty [kg/m3] of densities from mean grey values.

        The limits of the density are not applied.
        """
        values = np.asarray(values, dtype=np.float64)
        slope, both, offset = self.covariance
        scaled = self.relative_sd * (self.slope_kg_m3 * values + self.offset_kg_m3)
        variance = slope * values**2 + 2.0 * both * values + offset + scaled**2
        return np.sqrt(np.maximum(variance, 0.0)).astype(np.float32)

    def band(self, values: Numbers) -> tuple[Singles, Singles]:
        """Compute a lower and an upper bound [kg/m3] of the density from mean grey values.

        The density lies within the bounds with a probability of 90 %.
        """
        values = np.asarray(values, dtype=np.float64)
        half = NormalDist().inv_cdf(0.95) * self.sd(values)
        middle = self.slope_kg_m3 * values + self.offset_kg_m3
        limits = (self.lowest_kg_m3, self.highest_kg_m3)
        low = np.clip(middle - half, *limits).astype(np.float32)
        return low, np.clip(middle + half, *limits).astype(np.float32)

    def as_dict(self) -> dict[str, Any]:
        """Return the law as a JSON object. Densities are in kg/m3."""
        return {**asdict(self), "covariance": list(self.covariance)}


def _scanner_law(
    name: str, ash: tuple[float, float], source: str, *, slope_sd: float, offset_sd_kg_m3: float
) -> DensityLaw:
    """Return the density law from one scanner's linear relation of Hounsfield units and ash.

    The uncertainty of the law includes the difference between scanners.

    Parameters
    ----------
    name, source
        See `DensityLaw`.
    ash
        Ash density per Hounsfield unit, and ash density at 0 Hounsfield units [kg/m3].
    slope_sd
        Relative standard deviation of the slope.
    offset_sd_kg_m3
        Standard deviation of the apparent density at 0 Hounsfield units [kg/m3].
    """
    slope, offset = (each / ASH_SHARE for each in ash)
    return DensityLaw(
        slope,
        offset,
        name=name,
        source=f"{source}; ash over apparent {ASH_SHARE} (Schileo 2008); uncertain as another "
        "scanner's line",
        covariance=((slope_sd * slope) ** 2, 0.0, offset_sd_kg_m3**2),
        relative_sd=ASH_SHARE_SD / ASH_SHARE,
    )


CT_DENSITY = _scanner_law(
    "ct",
    (0.887, 63.3),
    "ash 0.887 HU + 63.3 kg/m3 of one scanner",
    slope_sd=0.27,
    offset_sd_kg_m3=60.0,
)
"""Density law of one scanner. Calibrate your own scanner before you rely on densities.

Densities that are computed from the tables of ``attenuation.toml`` at 62 to 80 keV are 8 to 39 %
lower than those of the law. These computed densities lie within the law's uncertainty band.
"""
_MAYO_DENSITY = _scanner_law(
    "dragomir-daescu",
    (0.7, -9.0),
    "ash 0.7 HU - 9 kg/m3 of a Siemens Somatom Definition at 120 kVp with a Mindways phantom "
    "(Cong 2011, Dragomir-Daescu 2011, table 1 of Knowles 2016)",
    slope_sd=0.16,
    offset_sd_kg_m3=55.0,
)
DENSITY_LAWS = {law.name: law for law in (CT_DENSITY, _MAYO_DENSITY)}
"""Density laws by name. Each law is the linear relation measured on one scanner.

The uncertainty band of each law contains the densities that are computed from attenuation tables at
62 to 80 keV, see `CT_DENSITY`. These densities are up to 10 % lower and up to 47 % higher than
those of the law ``dragomir-daescu``.
"""

_TO_ASH = {
    "apparent": (ASH_SHARE, 0.0, 0.0, "apparent density as stated"),
    "ash": (1.0, 0.0, ASH_SHARE_SD / ASH_SHARE, "ash density as stated"),
    "HA": (0.877, 79.0, 0.03, "ash = 0.877 HA + 79 kg/m3 (Schileo 2008)"),
    "K2HPO4": (
        1.06,
        38.9,
        0.1,
        "ash = 1.06 K2HPO4 + 38.9 kg/m3 (Keyak 1994; slopes of 0.9 to 1.22 are in use)",
    ),
}
"""Conversion from a phantom's equivalent density to ash density.

Each entry has the slope, the offset [kg/m3], the relative standard deviation of the apparent
density, and the source. The slopes in use for K2HPO4 range from 0.9 (from the line of
Dragomir-Daescu 2011) to 1.22 (Les 1994, table 1 of Knowles 2016). For HA, the standard deviation of
3 % is the uncertainty of the calcium content in ICRU 44, see `meshes.ct.calibration`.
"""


def line_law(slope: float, offset: float, equivalent: str = "apparent") -> DensityLaw:
    """Return the density law for a phantom density that is linear in Hounsfield units.

    Parameters
    ----------
    slope, offset
        Density per Hounsfield unit [kg/m3], and density at 0 Hounsfield units [kg/m3]. 1 kg/m3 is
        equal to 1 mg/cm3.
    equivalent
        Substance to which the density refers: ``K2HPO4`` or ``HA`` in water, ``ash``, or
        ``apparent``.

    Raises
    ------
    InputError
        If the slope is not positive, or the equivalent is unknown.
    """
    # The ranges are wide. They exclude other units, such as 0.001 g/cm3 per Hounsfield unit.
    require_range("slope", slope, 0.05, 20.0, "use kg/m3 per Hounsfield unit, about 0.8 to 1.5")
    require_range("offset", offset, -2000.0, 2000.0, "use kg/m3 at 0 Hounsfield units, -20 to 110")
    kind = {name.lower(): name for name in _TO_ASH}.get(equivalent.lower())
    if kind is None:
        raise InputError(
            "equivalent", f"be one of {enumerated(_TO_ASH, 'or')}", f"{equivalent!r}", "choose one"
        )
    ash_slope, ash_offset, relative_sd, source = _TO_ASH[kind]
    if kind != "apparent":
        source = f"{source}, ash over apparent {ASH_SHARE} +- {ASH_SHARE_SD} (Schileo)"
    return DensityLaw(
        ash_slope / ASH_SHARE * slope,
        (ash_slope * offset + ash_offset) / ASH_SHARE,
        name=f"line:{slope:g},{offset:g},{kind}",
        source=source,
        relative_sd=relative_sd,
    )
