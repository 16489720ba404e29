"""Density calibration without a phantom, from the air, fat, muscle and cortex of the same CT.

The method follows Michalski et al. 2020 (Med Eng Phys 78:55). The effective energy is the energy at
which tabulated attenuations of the reference tissues best fit the Hounsfield units of these
tissues. There are three differences from the paper. First, the linear attenuation is fitted,
because Hounsfield units are linear in this attenuation. Second, all unknowns have priors and are
estimated together, so the uncertainty of the density includes the uncertainty of the unknowns.
Third, bone is treated as a mixture of dense bone (ICRU 44) and marrow. Published relations between
K2HPO4 and ash density are not used, because these relations differ from each other by 30 %.
"""

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Ints, Singles
from meshes.base.errors import InputError, enumerated, require_range
from meshes.ct.density import ASH_SHARE, ASH_SHARE_SD, DENSITY_LAWS, DensityLaw, line_law
from meshes.images.frame import Image

ENERGIES_KEV = (30.0, 150.0)
"""Energy range of the attenuation tables [keV]."""


def mass_attenuation(material: str, energy_keV: float) -> float:
    """Compute a material's mass attenuation coefficient [m2/kg] from ``attenuation.toml``.

    The coefficient is the sum over the chemical elements, weighted by their mass fractions. Between
    the energies of the table, the logarithm of the coefficient is interpolated by cubic splines.
    The result differs by less than 0.2 % from the finer tables of Elam et al. 2002.

    Raises
    ------
    InputError
        If the energy is outside the table.
    """
    energy = require_range(
        "energy_keV", energy_keV, *ENERGIES_KEV, "use the effective energy, about 70"
    )
    curves = _curves()
    fractions = _table()["materials"][material]["fractions"]
    total = sum(
        share * np.exp(curves[element](np.log(energy))) for element, share in fractions.items()
    )
    return 0.1 * float(total)  # cm2/g to m2/kg


def density_of(material: str) -> float:
    """Return the density [kg/m3] of a material of ``attenuation.toml``."""
    return float(_table()["materials"][material]["density_kg_m3"])


def linear_attenuation(material: str, energy_keV: float) -> float:
    """Compute the linear attenuation coefficient [1/m] of a material of ``attenuation.toml``."""
    return density_of(material) * mass_attenuation(material, energy_keV)


def hounsfield(linear_attenuation_1_m: float, energy_keV: float) -> float:
    """Convert a linear attenuation coefficient [1/m] to Hounsfield units.

    Hounsfield units are 0 in water and -1000 in vacuum.
    """
    return 1000.0 * (linear_attenuation_1_m / linear_attenuation("water", energy_keV) - 1.0)


@cache
def _table() -> dict[str, Any]:
    return tomllib.loads((files("meshes.ct") / "attenuation.toml").read_text("utf-8"))


@cache
def _curves() -> dict[str, Any]:
    """Return one spline per element: log attenuation coefficient [cm2/g] over log energy [keV]."""
    from scipy.interpolate import CubicSpline

    table = _table()
    at = np.log(table["energies_keV"])
    return {
        element: CubicSpline(at, np.log(values)) for element, values in table["elements"].items()
    }


_SPREAD = {"air": 0.0, "adipose": 0.02, "muscle": 0.01, "cortex": 0.04}
"""Relative standard deviation of a tissue's attenuation between patients.

For fat, the value is half of the difference between adipose tissues 1 and 3 of Woodard and White
1986 (Br J Radiol 59:1209). For muscle, the value is half of the difference between muscles 1 and 3
in the same paper, and includes the fat in muscle. For cortex, the value follows from a porosity of
3 to 12 % and a density of 1.85 to 2.0 g/cm3 in the densest bone.
"""
# prior of the effective energy: it is about 50 to 85 keV for clinical tubes with 80 to 140 kV
_ENERGY_KEV = 72.0
_ENERGY_SD_KEV = 15.0
_LIMITS_KEV = (38.0, 140.0)
"""Limits of the effective energy in the fit [keV].

A photon of a 140 kV tube has at most 140 keV. The effective energy of an 80 kV tube is about 50
keV.
"""
_WATER_SD_HU = 4.0  # acceptance test of a scanner: water 0 +- 4 HU (IEC 61223-3-5)
_SCALE_SD = 0.01  # scale error; values of 0.003 to 0.03 change the energy by less than 0.1 keV
_MARROW_FAT = 0.6  # fraction of fat in the pores: red marrow has 0.4, yellow 0.8 (ICRP 89)
_MARROW_FAT_SD = 0.25
_MINERAL_SD = 0.03
"""Relative standard deviation of apparent densities that are computed from a mineral content.

The ratio of ash density to bone density is 0.57 from the calcium content in ICRU 44, and 0.598 in
Schileo 2008. The standard deviation is about half of the relative difference between these ratios.
"""
# mean squared misfit, in squared standard deviations, above which the values are not Hounsfield
# units
_WORST_FIT = 9.0
_CHANCE = 0.1  # a misfit with less than this probability widens the band

# The sizes, limits and widths below are not critical. On the synthetic CT, half or twice a value
# changes the effective energy by less than 0.9 keV. The standard error of the energy is 2.4 to 5
# keV.
_SLAB_VOXELS = 4e6  # voxels filtered at once: five arrays of 16 MB
_MOST_VOXELS = 4e7  # of a larger image, only every n-th slab is used
_MODES_HU = {"air": (-1060.0, -940.0), "adipose": (-140.0, -45.0), "muscle": (15.0, 95.0)}
"""Range [HU] in which the most frequent value of each tissue is searched.

At 60 to 120 keV, the tables of ICRU 44 give -89 to -56 HU for fat and 44 to 41 HU for muscle.
"""
_BINS_HU = (-1100, 200)
"""Range of the histogram [HU], with bins of 1 HU. It contains all ranges of `_MODES_HU`."""
_SMOOTHING_HU = 4.0  # standard deviation of the smoothing; single bins have random maxima
_LEAST_PEAK = 0.2  # height of a maximum, relative to the highest maximum in the tissue's range
_PROMINENCE = 0.02  # prominence of a maximum, relative to the same highest maximum
_WINDOW_HU = 12  # half width of the range of values that are averaged around a maximum
# error divided by full width at half prominence, a quarter of the maximum's standard deviation
_WIDTH_ERROR = 0.1
_SMALLEST_MM3 = 500.0  # of air, fat or muscle; smaller regions are mixtures at boundaries
_FEWEST_VOXELS = 60  # the standard error of a mean is then an eighth of the spread
_DENSE_HU = 700.0  # above trabecular bone and contrast medium
_METAL_HU = 2500.0  # above all bone but enamel
_METAL_REACH_MM = 12.0  # bone nearer to metal is not used because of streaks
_DENSEST_SHARE = 0.1  # of the dense voxels; the others have pores or partial volume
_SMALLEST_CORTEX_MM3 = 80.0  # volume of a cube of 4.3 mm
# smallest standard error of a region, because of 12-bit steps of 1 and shading across the image
_ERROR_HU = 1.0


@dataclass(frozen=True)
class Region:
    """Mean value of a tissue in an image, and standard error of the mean [HU]."""

    mean_HU: float
    error_HU: float


@dataclass(frozen=True)
class Calibration:
    """Result of a calibration: law that converts Hounsfield units to density.

    `energy_keV` and `energy_sd_keV` are the effective energy of the X-rays and its standard
    deviation.
    """

    law: DensityLaw
    energy_keV: float
    energy_sd_keV: float


def density_law(text: str, image: Image) -> DensityLaw:
    """Return the law that the option ``--density`` selects.

    Parameters
    ----------
    text
        One of: a name in `DENSITY_LAWS`; ``line:SLOPE,OFFSET`` for apparent density;
        ``line:SLOPE,OFFSET,K2HPO4`` (or HA, ash) for the equivalent density of a phantom;
        ``internal`` for a calibration with the image's own air, fat, muscle and cortex. The units
        are kg/m3 per Hounsfield unit (SLOPE) and kg/m3 (OFFSET).
    image
        The CT [Hounsfield units].

    Raises
    ------
    InputError
        If the text has none of these forms, or the image lacks tissues that a calibration needs.
    """
    text = text.strip()
    if text.lower() == "internal":
        return fit_regions(find_regions(image), source=image.source).law
    if text.lower() in DENSITY_LAWS:
        return DENSITY_LAWS[text.lower()]
    kind, _, rest = text.partition(":")
    parts = [part.strip() for part in rest.split(",")]
    try:
        slope, offset = map(float, parts[:2])
    except ValueError:
        slope = math.nan
    if kind.lower() != "line" or len(parts) > 3 or not math.isfinite(slope):
        raise InputError(
            "density",
            f"be internal, {', '.join(DENSITY_LAWS)}, line:SLOPE,OFFSET (apparent density in "
            "kg/m3), or line:SLOPE,OFFSET,K2HPO4 or line:SLOPE,OFFSET,HA (density of a phantom)",
            f"{text!r}",
            "use internal, or line:1.17,-15",
        )
    return line_law(slope, offset, *parts[2:])


def fit_regions(regions: dict[str, Region], *, source: str) -> Calibration:
    """Fit the X-ray energy, the scanner errors and the density law to the mean values of tissues.

    The result includes the uncertainty of the density law.

    The unknowns are the effective energy, the scanner's error in the value of water, the scanner's
    scale error, the fat content of marrow, and one deviation for each tissue. This deviation is the
    relative difference between the tissue's attenuation and the value according to ICRU 44. Each
    unknown is scaled such that its prior is the standard normal distribution. The covariance is
    computed from the linearised problem.

    Raises
    ------
    InputError
        If too few tissues are given, or no energy fits the values of the tissues.
    """
    from scipy.optimize import approx_fprime, least_squares
    from scipy.special import chdtri

    tissues = [tissue for tissue in _SPREAD if tissue in regions]
    # Air has nearly the same value at every energy, and cortex differs most between patients, so
    # these two tissues are not enough.
    if len(tissues) < 2 or not {"adipose", "muscle"}.intersection(tissues):
        raise InputError(
            "an internal calibration",
            "find two tissues, one of them fat or muscle",
            f"{enumerated(tissues) or 'none'} in {source}",
            "keep the soft tissue in the image, or give a phantom's line as line:SLOPE,OFFSET",
        )
    means = np.array([regions[tissue].mean_HU for tissue in tissues])
    errors = np.array([regions[tissue].error_HU for tissue in tissues])

    def misfit(unknown: Array) -> Array:
        """Return the residuals of the fit and the unknowns, all in standard deviations."""
        energy = _energy(unknown)
        fitted = [
            _read((1.0 + _SPREAD[tissue] * deviation) * linear_attenuation(tissue, energy), unknown)
            for tissue, deviation in zip(tissues, unknown[4:], strict=True)
        ]
        return np.concatenate([(fitted - means) / errors, unknown])

    # Four unknowns precede the deviations of tissues: energy, water, scale and fat in marrow.
    bounds = np.full((2, 4 + len(tissues)), np.inf) * [[-1.0], [1.0]]
    bounds[:, 0] = (np.array(_LIMITS_KEV) - _ENERGY_KEV) / _ENERGY_SD_KEV
    found = least_squares(misfit, np.zeros(4 + len(tissues)), bounds=bounds)
    squared = 2.0 * float(found.cost)
    if squared > _WORST_FIT * len(tissues):
        seen = enumerated(f"{tissue} {regions[tissue].mean_HU:.0f}" for tissue in tissues)
        raise InputError(
            "grey values",
            "be Hounsfield units for an internal calibration",
            f"{seen} in {source}, which fit no X-ray energy",
            "give a phantom's line as line:SLOPE,OFFSET",
        )
    covariance = np.linalg.inv(found.jac.T @ found.jac) * max(
        squared / chdtri(len(tissues), _CHANCE), 1.0
    )
    slope, offset = _density_line(found.x)
    # The unknowns have a standard deviation of 1, so this step is far larger than rounding errors
    # and far smaller than their spread.
    derivatives = approx_fprime(found.x, _density_line, 1e-6)
    spread = derivatives @ covariance @ derivatives.T
    energy = _energy(found.x)
    energy_sd = _ENERGY_SD_KEV * math.sqrt(covariance[0, 0])
    law = DensityLaw(
        float(slope),
        float(offset),
        name="internal",
        source=f"internal calibration after Michalski 2020 by {', '.join(tissues)}: effective "
        f"energy {energy:.0f} +- {energy_sd:.0f} keV; dense bone of ICRU 44 in marrow, ash over "
        f"apparent {ASH_SHARE} +- {ASH_SHARE_SD} (Schileo 2008)",
        covariance=(float(spread[0, 0]), float(spread[0, 1]), float(spread[1, 1])),
        relative_sd=math.hypot(_MINERAL_SD, ASH_SHARE_SD / ASH_SHARE),
    )
    return Calibration(law, energy, energy_sd)


def _energy(unknown: Array) -> float:
    return _ENERGY_KEV + _ENERGY_SD_KEV * float(unknown[0])


def _read(attenuation_1_m: float, unknown: Array) -> float:
    """Compute the Hounsfield units that a scanner shows for a linear attenuation [1/m].

    `unknown` contains the energy and the scanner's errors, see `fit_regions`.
    """
    true = hounsfield(attenuation_1_m, _energy(unknown))
    return (1.0 + _SCALE_SD * float(unknown[1])) * true + _WATER_SD_HU * float(unknown[2])


def _density_line(unknown: Array) -> Array:
    """Compute the slope [kg/m3 per HU] and offset [kg/m3] for mixtures of dense bone and marrow."""
    energy = _energy(unknown)
    fat = _MARROW_FAT + _MARROW_FAT_SD * unknown[3]
    marrow = fat * linear_attenuation("adipose", energy) + (1.0 - fat) * linear_attenuation(
        "muscle", energy
    )
    marrow_HU = _read(marrow, unknown)
    slope = density_of("cortex") / (
        _read(linear_attenuation("cortex", energy), unknown) - marrow_HU
    )
    return np.array([slope, -slope * marrow_HU])


def find_regions(image: Image) -> dict[str, Region]:
    """Find air, adipose, muscle and cortex in a CT.

    Only voxels in homogeneous neighbourhoods are used. Values in such a neighbourhood differ only
    by noise. The values of fat and muscle are maxima of the histogram in the ranges of these
    tissues. The value of air is the median in its range. Cortex is the densest tenth of the voxels
    that are surrounded by bone and not near metal.
    """
    from scipy.ndimage import uniform_filter

    # At least four slices, because each slab is filtered with two more slices on each side.
    thickness = max(int(_SLAB_VOXELS // math.prod(image.values.shape[:2])), 4)
    whole = range(0, image.values.shape[2], thickness)
    starts = whole[:: math.ceil(image.values.size / _MOST_VOXELS)]
    _, mean, sd, _, _ = _filtered(image, starts[len(starts) // 2], thickness)
    # Range from fat to muscle [HU]. Voxels at edges have a larger deviation, so a low quantile is
    # the noise.
    soft = sd[(mean > -160.0) & (mean < 120.0)]
    noise = float(np.quantile(soft if soft.size > 1000 else sd, 0.3))
    voxel_mm3 = math.prod(image.spacing_mm) * len(whole) / len(starts)
    reach = [2 * math.ceil(_METAL_REACH_MM / spacing) + 1 for spacing in image.spacing_mm]
    padding = float(image.values.min())
    air_low, air_high = _MODES_HU["air"]
    counts = np.zeros(_BINS_HU[1] - _BINS_HU[0], dtype=np.int64)
    air = []
    dense = []
    for start in starts:
        values, mean, sd, spread, least = _filtered(image, start, thickness)
        # Outside its field of view, a scanner writes a constant lowest value. A lowest value of
        # -1015 HU or more is air.
        held = (sd > 0.0) | (mean != padding) | (padding >= air_low + 45.0)
        # The limits of 1 and 3 HU also accept images with little noise.
        even = held & (sd < 1.6 * noise + 1.0) & (spread < 3.0 * noise + 3.0)
        counts += np.histogram(mean[even], bins=len(counts), range=_BINS_HU)[0]
        # Every seventh value is enough for the median, because air fills half of an image.
        air.append(values[even & (mean > air_low) & (mean < air_high)][::7])
        bone = least > _DENSE_HU
        metal = values > _METAL_HU
        # Fewer bright voxels are noise or enamel. The tolerance of the share of metal around a
        # voxel is for rounding errors.
        if bone.any() and metal.sum() >= 5:
            bone &= uniform_filter(metal.astype(np.float32), reach) < 1e-6
        # The values of cortex vary by more than noise because of pores below the resolution, so 6 %
        # are allowed.
        dense.append(mean[bone & (sd < np.maximum(2.0 * noise, 0.06 * mean))])
    found = {tissue: _most_frequent(tissue, counts, voxel_mm3, noise) for tissue in _MODES_HU}
    if found["air"] is not None:
        # Values that are truncated at -1024 HU do not change the median. For errors of 1 to 10 HU,
        # the energy of the synthetic CT changes by 0.01 keV.
        found["air"] = Region(float(np.median(np.concatenate(air))), 3.0)
    found["cortex"] = _cortex(np.concatenate(dense), voxel_mm3)
    return {tissue: region for tissue, region in found.items() if region is not None}


def _filtered(image: Image, start: int, thickness: int) -> list[Singles]:
    """Compute local statistics of a slab of an image in neighbourhoods of 3 x 3 x 3 voxels.

    Return five arrays: the grey values and, around each voxel, the mean, the standard deviation,
    the range of the means, and the minimum.
    """
    from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

    # Two successive filters with three voxels need two more slices at each end.
    first = max(start - 2, 0)
    values = image.values[:, :, first : start + thickness + 2].astype(np.float32)
    shift = np.float32(values.mean())  # avoids cancellation in sums of squares
    mean = uniform_filter(values - shift, 3)
    variance = uniform_filter((values - shift) ** 2, 3) - mean**2
    filtered = (
        values,
        mean + shift,
        # 1e-3 HU2 is more than the rounding error of the sums, so that the deviation of constant
        # values is 0.
        np.sqrt(np.maximum(variance - 1e-3, 0.0)),
        maximum_filter(mean, 3) - minimum_filter(mean, 3),
        minimum_filter(values, 3),
    )
    return [each[:, :, start - first : start - first + thickness] for each in filtered]


def _most_frequent(tissue: str, counts: Ints, voxel_mm3: float, noise: float) -> Region | None:
    """Find the histogram's maximum in the tissue's range; return None for too few voxels.

    For air and fat, the highest maximum is used. For muscle, the first maximum that is not small is
    used, because organs with contrast medium have higher Hounsfield values. The standard error
    increases with the width of the maximum, because a wide maximum may contain several tissues.
    """
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks, peak_widths

    low, high = (int(edge) - _BINS_HU[0] for edge in _MODES_HU[tissue])
    smooth = gaussian_filter1d(counts.astype(np.float64), _SMOOTHING_HU)[low:high]
    peaks = find_peaks(
        smooth, height=_LEAST_PEAK * smooth.max(), prominence=_PROMINENCE * smooth.max()
    )[0]
    if smooth.max() <= 0.0 or not len(peaks):
        return None
    peak = peaks[0] if tissue == "muscle" else peaks[np.argmax(smooth[peaks])]
    width = float(peak_widths(smooth, [peak])[0][0])
    top = low + int(peak)
    window = np.arange(max(top - _WINDOW_HU, 0), min(top + _WINDOW_HU + 1, len(counts)))
    count = int(counts[window].sum())
    if count * voxel_mm3 < _SMALLEST_MM3 or count < _FEWEST_VOXELS:
        return None
    mean = float(np.average(window + 0.5 + _BINS_HU[0], weights=counts[window]))
    return Region(
        # Each counted value is a mean of 27 voxels, so only count / 27 values are independent.
        mean,
        math.hypot(_ERROR_HU, noise / math.sqrt(count / 27.0), _WIDTH_ERROR * width),
    )


def _cortex(dense: Singles, voxel_mm3: float) -> Region | None:
    """Compute the median value of the densest tenth of the dense voxels.

    The standard error is half of the range from the 20th to the 80th percentile, combined with 5 HU
    (root of the sum of squares).
    """
    count = max(
        int(_DENSEST_SHARE * len(dense)),
        math.ceil(_SMALLEST_CORTEX_MM3 / voxel_mm3),
        _FEWEST_VOXELS,
    )
    if len(dense) < count:
        return None
    densest = np.sort(dense)[-count:]
    error = 0.5 * float(np.quantile(densest, 0.8) - np.quantile(densest, 0.2))
    # The smallest error is 5 HU. Values of 1 to 15 HU change the energy by less than 0.1 keV.
    return Region(float(np.median(densest)), math.hypot(5.0, error))
