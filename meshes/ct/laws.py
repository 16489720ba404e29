"""Density laws by name, from a line, from a phantom, or from a phantom's measured rods."""

import math
from collections.abc import Sequence

import numpy as np

from meshes.base.errors import InputError, require_range
from meshes.ct.calibration import calibrate
from meshes.ct.density import ASH_SHARE, ASH_SHARE_SD, CT_DENSITY, DensityLaw, scanner_law
from meshes.images.frame import Image

__all__ = ["DENSITY_LAWS", "density_law", "phantom_law", "rods_law"]

DENSITY_LAWS = {
    law.name: law
    for law in (
        CT_DENSITY,
        scanner_law(
            "dragomir-daescu",
            0.7,
            -9.0,
            source="ash 0.7 HU - 9 kg/m3 of a Siemens Somatom Definition at 120 kVp with a "
            "Mindways "
            "phantom "
            "(Cong 2011, Dragomir-Daescu 2011, table 1 of Knowles 2016)",
            slope_sd=0.16,
            offset_sd_kg_m3=55.0,
        ),
    )
}
"""Density laws by name, each of one scanner.

The band of each law holds the tabulated values of bone at 62 to 80 keV, -10 to 47 % off the second
line, see `CT_DENSITY`.
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

Each entry holds slope, offset [kg/m3], the relative standard deviation of apparent density, and its
source. 1.22 K2HPO4 + 52.3 is from Les 1994 (table 1 of Knowles 2016). The factor 0.9 follows from
the line of Dragomir-Daescu 2011. The 3 % for HA is the uncertainty of ICRU 44's calcium, see
`calibration`.
"""
_KIND = "name a phantom's equivalent as apparent, ash, HA or K2HPO4"


def density_law(text: str, image: Image) -> DensityLaw:
    """Return the law that the option ``--density`` selects.

    Parameters
    ----------
    text
        A name of `DENSITY_LAWS`; ``line:SLOPE,OFFSET`` [kg/m3 per Hounsfield unit, kg/m3] of
        apparent density, or ``line:SLOPE,OFFSET,K2HPO4`` (HA, ash) of a phantom's equivalent
        density; or ``internal``, calibrated by the image's own air, fat, muscle and cortex.
    image
        The CT [Hounsfield units].

    Raises
    ------
    InputError
        If the text is none of these, or the image lacks tissues that a calibration needs.
    """
    text = text.strip()
    if text.lower() == "internal":
        return calibrate(image).law
    if text.lower() in DENSITY_LAWS:
        return DENSITY_LAWS[text.lower()]
    kind, colon, numbers = text.partition(":")
    parts = [part.strip() for part in numbers.split(",")]
    if kind.lower() == "line" and colon and len(parts) in (2, 3):
        try:
            slope = float(parts[0])
            offset = float(parts[1])
        except ValueError:
            slope = math.nan
        if math.isfinite(slope):
            return phantom_law(
                slope, offset, equivalent=parts[2] if len(parts) == 3 else "apparent"
            )
    raise InputError(
        "density",
        (
            f"be internal, {', '.join(DENSITY_LAWS)}, or line:SLOPE,OFFSET in kg/m3 of apparent "
            "density (line:SLOPE,OFFSET,K2HPO4 or ,HA of a phantom)"
        ),
        f"{text!r}",
        "use internal, or line:1.17,-15",
    )


def phantom_law(
    slope_mg_cm3_per_HU: float,
    offset_mg_cm3: float,
    *,
    equivalent: str,
    covariance: tuple[float, float, float] = (0.0, 0.0, 0.0),
    residual_sd_mg_cm3: float = 0.0,
) -> DensityLaw:
    """Return the law of a scan with a density phantom in it.

    Parameters
    ----------
    slope_mg_cm3_per_HU, offset_mg_cm3
        Line from Hounsfield units to the phantom's equivalent density [mg/cm3, which is kg/m3].
    equivalent
        Substance of the density: ``K2HPO4`` or ``HA`` in water, ``ash``, or ``apparent``.
    covariance, residual_sd_mg_cm3
        Uncertainty of that line, as in `DensityLaw`.

    Raises
    ------
    InputError
        If the slope is not positive, or the equivalent is unknown.
    """
    slope = require_range(
        "slope", slope_mg_cm3_per_HU, 0.05, 20.0, "use kg/m3 per Hounsfield unit, about 0.8 to 1.5"
    )
    offset = require_range(
        "offset", offset_mg_cm3, -2000.0, 2000.0, "use kg/m3 at 0 Hounsfield units, -20 to 110"
    )
    known = {name.lower(): name for name in _TO_ASH}
    if equivalent.lower() not in known:
        raise InputError("equivalent", f"be one of {', '.join(_TO_ASH)}", f"{equivalent!r}", _KIND)
    kind = known[equivalent.lower()]
    ash_slope, ash_offset, relative_sd, source = _TO_ASH[kind]
    factor = ash_slope / ASH_SHARE
    return DensityLaw(
        factor * slope,
        factor * offset + ash_offset / ASH_SHARE,
        name=f"line:{slope:g},{offset:g},{kind}",
        source=source
        if kind == "apparent"
        else f"{source}, ash over apparent {ASH_SHARE} +- {ASH_SHARE_SD} (Schileo)",
        covariance=(
            factor**2 * covariance[0],
            factor**2 * covariance[1],
            factor**2 * covariance[2],
        ),
        residual_sd_kg_m3=factor * residual_sd_mg_cm3,
        relative_sd=relative_sd,
    )


def rods_law(
    densities_mg_cm3: Sequence[float],
    mean_HU: Sequence[float],
    *,
    equivalent: str,
    sd_HU: Sequence[float] | None = None,
) -> DensityLaw:
    """Fit the law of a phantom's rods by weighted least squares.

    Parameters
    ----------
    densities_mg_cm3, mean_HU
        Known density [mg/cm3] and measured mean of each rod, three rods at least.
    equivalent
        As in `phantom_law`.
    sd_HU
        Standard error of each mean; None: equal for all. Rods are weighted by its inverse square.

    Raises
    ------
    InputError
        If the rods are too few, not finite, or of one value.
    """
    density = np.asarray(densities_mg_cm3, dtype=np.float64)
    hu = np.asarray(mean_HU, dtype=np.float64)
    error = np.ones(len(hu)) if sd_HU is None else np.asarray(sd_HU, dtype=np.float64)
    if not len(density) == len(hu) == len(error) >= 3:
        counts = f"{len(density)} densities, {len(hu)} means and {len(error)} errors"
        raise InputError(
            "rods", "be three at least, a density and a mean each", counts, "measure more rods"
        )
    if not (np.isfinite([density, hu, error]).all() and (error > 0.0).all() and np.ptp(hu) > 1.0):
        raise InputError(
            "rods",
            "have finite densities, means that differ and errors above 0",
            f"means {hu.min():g} to {hu.max():g} HU",
            "measure rods of several densities",
        )
    (slope, offset), covariance = np.polyfit(hu, density, 1, w=1.0 / error, cov=True)
    away = density - slope * hu - offset
    return phantom_law(
        float(slope),
        float(offset),
        equivalent=equivalent,
        covariance=(float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])),
        residual_sd_mg_cm3=float(np.sqrt(np.sum(away**2) / (len(hu) - 2))),
    )
