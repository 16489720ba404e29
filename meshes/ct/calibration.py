"""Density calibration without a phantom: air, fat, muscle, blood and cortex of the same CT are the phantom.

After Michalski et al. 2020 (Med Eng Phys 78:55): the effective energy is the one at which the attenuation of the
reference tissues fits their Hounsfield units best; a two-component model of triglyceride and K2HPO4 then makes a
density of each value. Written from the paper's method. Where it differs: linear attenuation is fitted, since Hounsfield
units are linear in it; all unknowns are found together with what is known of them beforehand, so that their uncertainty
reaches the density; and dense bone of ICRU 44 in marrow, the second two-component model, leads to apparent density,
because relations from K2HPO4 to ash in use differ by 30 %.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.ct.attenuation import density_of, hounsfield, linear_attenuation
from meshes.ct.density import ASH_SHARE, ASH_SHARE_SD, DensityLaw
from meshes.ct.labels import Labels
from meshes.ct.tissue_regions import Region, find_regions
from meshes.images.frame import Image

__all__ = ["InternalCalibration", "calibrate", "fit_regions", "internal_calibration"]

_SPREAD = {"air": 0.0, "adipose": 0.02, "muscle": 0.01, "blood": 0.01, "cortex": 0.04}
"""Relative standard deviation of a tissue's attenuation between persons. Fat and muscle: half of what adipose tissues 1
to 3 and muscles 1 to 3 of Woodard and White 1986 (Br J Radiol 59:1209) lie apart, with the fat in muscle; blood: its
haematocrit of 0.37 to 0.5; cortex: pores of 3 to 12 % and density of 1.85 to 2.0 g/cm3 where it is densest."""
_ENERGY_KEV, _ENERGY_SD_KEV = 72.0, 15.0
"""Effective energy beforehand: clinical tubes of 80 to 140 kV make about 50 to 85 keV."""
_LOWEST_KEV, _HIGHEST_KEV = 38.0, 140.0
_WATER_SD_HU, _SCALE_SD = 4.0, 0.01
"""What a scanner may be off: water 0 +- 4 HU in its acceptance test (IEC 61223-3-5), and the scale by 1 %."""
_MARROW_FAT, _MARROW_FAT_SD = 0.6, 0.25
"""Share of fat in what fills the pores: red marrow has 0.4, yellow 0.8 (ICRP 89)."""
_MINERAL_SD = 0.03
"""Relative standard deviation of apparent density from mineral: ICRU 44's calcium makes ash 0.57 of dense bone, the
ratio of Schileo 2008 is 0.598; half of what these lie apart."""
_WORST_FIT = 9.0
"""Mean square of misfits over their standard deviations that no Hounsfield units have."""
_CHANCE = 0.1
"""A misfit that chance makes less often than this widens the band."""
_SOFT = ("adipose", "muscle", "blood")


@dataclass(frozen=True)
class InternalCalibration:
    """What a calibration found.

    Attributes
    ----------
    law
        Apparent density [kg/m3] of Hounsfield units.
    energy_keV, energy_sd_keV
        Effective energy and its standard deviation [keV].
    k2hpo4
        Slope [kg/m3 per HU] and offset [kg/m3] of the K2HPO4-equivalent density in triglyceride.
    regions
        Regions that were found, by tissue.
    misfits
        Measured less fitted mean of each region [HU], tissues as in the tables.
    notes
        What was missing or unlikely, a sentence each.
    """

    law: DensityLaw
    energy_keV: float
    energy_sd_keV: float
    k2hpo4: tuple[float, float]
    regions: dict[str, Region]
    misfits: dict[str, float]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """The calibration as a JSON object."""
        return {
            "law": self.law.as_dict(),
            "effective_energy_keV": self.energy_keV,
            "effective_energy_sd_keV": self.energy_sd_keV,
            "k2hpo4_slope_kg_m3": self.k2hpo4[0],
            "k2hpo4_offset_kg_m3": self.k2hpo4[1],
            "regions": {tissue: region.as_dict() for tissue, region in self.regions.items()},
            "misfits_HU": self.misfits,
            "notes": list(self.notes),
        }


def internal_calibration(image: Image, *, labels: Labels | None = None) -> DensityLaw:
    """Density law of a CT by its own tissues, see `calibrate`."""
    return calibrate(image, labels=labels).law


def calibrate(image: Image, *, labels: Labels | None = None) -> InternalCalibration:
    """Calibrate a CT by its own air, fat, muscle, cortex and, with labels, blood.

    Parameters
    ----------
    image
        The CT [Hounsfield units].
    labels
        Labels on the image's grid that name muscles or vessels.

    Raises
    ------
    InputError
        If too few tissues are found, or what is found fits those of no energy.
    """
    return fit_regions(find_regions(image, labels=labels), source=image.source)


def fit_regions(regions: dict[str, Region], *, source: str) -> InternalCalibration:
    """Effective energy, scanner line and density law that fit the means of regions best, with their uncertainty.

    Unknowns are the energy, the scanner's error of water and scale, each tissue's deviation from ICRU 44 and the fat in
    marrow, all with normal priors. The covariance is that of the linearised problem; a misfit beyond chance
    widens it.

    Raises
    ------
    InputError
        See `calibrate`.
    """
    from scipy.optimize import least_squares
    from scipy.special import chdtri

    tissues = [tissue for tissue in _SPREAD if tissue in regions]
    _require_enough(tissues, source)
    means = np.array([regions[tissue].mean_HU for tissue in tissues])
    errors = np.array([regions[tissue].error_HU for tissue in tissues])

    def predicted(unknown: Array) -> Array:
        energy = _energy(unknown)
        each = [1.0 + _SPREAD[tissue] * unknown[4 + k] for k, tissue in enumerate(tissues)]
        return np.array([_read(f * linear_attenuation(t, energy), unknown) for f, t in zip(each, tissues, strict=True)])

    def misfit(unknown: Array) -> Array:
        return np.concatenate([(predicted(unknown) - means) / errors, unknown])

    limits = [(edge - _ENERGY_KEV) / _ENERGY_SD_KEV for edge in (_LOWEST_KEV, _HIGHEST_KEV)]
    free = np.full(3 + len(tissues), np.inf)
    found = least_squares(
        misfit, np.zeros(4 + len(tissues)), bounds=(np.append(limits[0], -free), np.append(limits[1], free))
    )
    misfit_squared = 2.0 * float(found.cost)
    if misfit_squared > _WORST_FIT * len(tissues):
        seen = ", ".join(f"{tissue} {regions[tissue].mean_HU:.0f}" for tissue in tissues)
        raise InputError(
            f"grey values must be Hounsfield units for an internal calibration, got {seen} in {source}, which fit no "
            "energy: give a phantom's line as line:SLOPE,OFFSET"
        )
    covariance = np.linalg.inv(found.jac.T @ found.jac) * max(misfit_squared / chdtri(len(tissues), _CHANCE), 1.0)
    line, slopes = _with_derivatives(_density_line, found.x)
    spread = slopes @ covariance @ slopes.T
    energy, energy_sd = _energy(found.x), _ENERGY_SD_KEV * math.sqrt(covariance[0, 0])
    at = f"{energy:.0f} +- {energy_sd:.0f} keV"
    law = DensityLaw(
        float(line[0]),
        float(line[1]),
        name="internal",
        source=f"internal calibration after Michalski 2020 by {', '.join(tissues)}: effective energy {at}; dense bone "
        f"of ICRU 44 in marrow, ash over apparent {ASH_SHARE} +- {ASH_SHARE_SD} (Schileo 2008)",
        covariance=(float(spread[0, 0]), float(spread[0, 1]), float(spread[1, 1])),
        relative_sd=math.hypot(_MINERAL_SD, ASH_SHARE_SD / ASH_SHARE),
    )
    plain = found.x * np.concatenate([[1.0, 1.0, 1.0, 0.0], np.zeros(len(tissues))])
    misfits = {tissue: float(m - p) for tissue, m, p in zip(tissues, means, predicted(plain), strict=True)}
    k2hpo4 = _k2hpo4_line(found.x)
    return InternalCalibration(law, energy, energy_sd, k2hpo4, regions, misfits, _notes(tissues, source, energy))


def _energy(unknown: Array) -> float:
    return _ENERGY_KEV + _ENERGY_SD_KEV * float(unknown[0])


def _read(attenuation_1_m: float, unknown: Array) -> float:
    """Hounsfield units that the scanner shows of a linear attenuation [1/m]."""
    true = hounsfield(attenuation_1_m, _energy(unknown))
    return (1.0 + _SCALE_SD * float(unknown[1])) * true + _WATER_SD_HU * float(unknown[2])


def _density_line(unknown: Array) -> Array:
    """Slope [kg/m3 per HU] and offset [kg/m3]: dense bone and marrow share the volume."""
    energy, fat = _energy(unknown), _MARROW_FAT + _MARROW_FAT_SD * unknown[3]
    marrow = fat * linear_attenuation("adipose", energy) + (1.0 - fat) * linear_attenuation("muscle", energy)
    dense_HU, marrow_HU = _read(linear_attenuation("cortex", energy), unknown), _read(marrow, unknown)
    slope = density_of("cortex") / (dense_HU - marrow_HU)
    return np.array([slope, -slope * marrow_HU])


def _k2hpo4_line(unknown: Array) -> tuple[float, float]:
    """Slope [kg/m3 per HU] and offset [kg/m3]: K2HPO4 and triglyceride share the volume."""
    energy = _energy(unknown)
    salt_HU, fat_HU = (_read(linear_attenuation(each, energy), unknown) for each in ("K2HPO4", "triglyceride"))
    slope = density_of("K2HPO4") / (salt_HU - fat_HU)
    return slope, -slope * fat_HU


def _with_derivatives(function: Callable[[Array], Array], at: Array, step: float = 1e-3) -> tuple[Array, Array]:
    """A function's value and its derivatives by central differences, shape (values, unknowns)."""
    slopes = [function(at + step * unit) - function(at - step * unit) for unit in np.eye(len(at))]
    return function(at), np.array(slopes).T / (2.0 * step)


def _require_enough(tissues: list[str], source: str) -> None:
    """Refuse a calibration without soft tissue, or with one region alone."""
    if len(tissues) < 2 or not any(tissue in _SOFT for tissue in tissues):
        raise InputError(
            f"an internal calibration must find fat or muscle and a second tissue, got {', '.join(tissues) or 'none'} "
            f"in {source}: keep the soft tissue in the image, or give a phantom's line as line:SLOPE,OFFSET"
        )


def _notes(tissues: list[str], source: str, energy: float) -> tuple[str, ...]:
    lacking = {
        "cortex": "no dense cortex thick enough for its voxels was found: the energy is hardly known, the band wide",
        "air": "no air was found: the scale is taken to be the scanner's own",
        "adipose": "no fat was found",
        "muscle": "no muscle was found",
    }
    missing = [text for tissue, text in lacking.items() if tissue not in tissues]
    notes = [f"Internal calibration of {source}: {text}." for text in missing]
    if not 50.0 <= energy <= 90.0:
        notes.append(
            f"An effective energy of {energy:.0f} keV is unusual for a clinical CT (50 to 90): check its units."
        )
    return tuple(notes)
