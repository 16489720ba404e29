"""Density calibration without a phantom, by air, fat, muscle and cortex of the same CT.

After Michalski et al. 2020 (Med Eng Phys 78:55), written from the paper's method: the effective
energy is the energy at which the attenuation of the reference tissues fits their Hounsfield units
best. Differences from the paper: linear attenuation is fitted, because Hounsfield units are linear
in it. All unknowns have priors and are found together, so that their uncertainty reaches the
density. Dense bone of ICRU 44 in marrow leads to apparent density, because relations from K2HPO4 to
ash in use differ by 30 %.
"""

import math
import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Ints, Singles
from meshes.base.errors import InputError, require_range
from meshes.ct.density import ASH_SHARE, ASH_SHARE_SD, DENSITY_LAWS, DensityLaw, line_law
from meshes.images.frame import Image

__all__ = [
    "Calibration",
    "Region",
    "density_law",
    "find_regions",
    "fit_regions",
    "hounsfield",
    "linear_attenuation",
    "mass_attenuation",
]

ENERGIES_KEV = (30.0, 150.0)
"""Range of the tables [keV]."""


def mass_attenuation(material: str, energy_keV: float) -> float:
    """Compute the mass attenuation coefficient [m2/kg] of a material of ``attenuation.toml``.

    It is the sum over the material's elements by their mass fractions. Between the energies of the
    table, the logarithms are interpolated by cubic splines. These are within 0.2 % of the finer
    tables of Elam et al. 2002.

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

    They are 0 in water and -1000 in vacuum.
    """
    return 1000.0 * (linear_attenuation_1_m / linear_attenuation("water", energy_keV) - 1.0)


@cache
def _table() -> dict[str, Any]:
    return tomllib.loads((files("meshes.ct") / "attenuation.toml").read_text("utf-8"))


@cache
def _curves() -> dict[str, Any]:
    """Return the logarithm of each element's coefficient [cm2/g] over the log energy [keV]."""
    from scipy.interpolate import CubicSpline

    table = _table()
    at = np.log(table["energies_keV"])
    return {
        element: CubicSpline(at, np.log(values)) for element, values in table["elements"].items()
    }


_SPREAD = {"air": 0.0, "adipose": 0.02, "muscle": 0.01, "cortex": 0.04}
"""Relative standard deviation of a tissue's attenuation between persons.

Fat and muscle: half of the difference between adipose tissues 1 to 3 and between muscles 1 to 3 of
Woodard and White 1986 (Br J Radiol 59:1209), with the fat in muscle. Cortex: pores of 3 to 12 % and
density of 1.85 to 2.0 g/cm3 where it is densest.
"""
# prior of the effective energy: clinical tubes of 80 to 140 kV make about 50 to 85 keV
_ENERGY_KEV = 72.0
_ENERGY_SD_KEV = 15.0
_LIMITS_KEV = (38.0, 140.0)
"""Limits of the fitted energy. No photon of a 140 kV tube has more; 80 kV make about 50 keV."""
_WATER_SD_HU = 4.0  # water is 0 +- 4 HU in a scanner's acceptance test (IEC 61223-3-5)
_SCALE_SD = 0.01  # error of a scanner's scale; of 0.003 to 0.03, none moves the energy by 0.1 keV
_MARROW_FAT = 0.6  # fraction of fat in the pores: red marrow has 0.4, yellow 0.8 (ICRP 89)
_MARROW_FAT_SD = 0.25
_MINERAL_SD = 0.03
"""Relative standard deviation of apparent density from mineral.

ICRU 44's calcium makes ash 0.57 of dense bone, and the ratio of Schileo 2008 is 0.598. The value is
half of their difference.
"""
# mean squared misfit, in standard deviations, above which the values are not Hounsfield units
_WORST_FIT = 9.0
_CHANCE = 0.1  # a misfit less probable than this widens the band

# Sizes, limits and widths below are not critical: on the synthetic CT, half or twice the value of
# one moves the effective energy by less than 0.9 keV, whose standard error is 2.4 to 5 keV.
_SLAB_VOXELS = 4e6  # filtered at once: five arrays of 16 MB
_MOST_VOXELS = 4e7  # only every second, third ... slab of a larger image is used
_MODES_HU = {"air": (-1060.0, -940.0), "adipose": (-140.0, -45.0), "muscle": (15.0, 95.0)}
"""Range of a tissue's most frequent value between effective energies of 40 and 120 keV.

The ranges are from the tissues of ICRU 44 (fat -99 to -57, muscle 45 to 40) and 35 HU to either
side.
"""
_BINS_HU = (-1100, 200)
"""Range of the histogram, which holds all of `_MODES_HU`, in bins of 1 HU."""
_SMOOTHING_HU = 4.0  # standard deviation; single bins have chance maxima
_LEAST_PEAK = 0.2  # height of a maximum, relative to the highest in the tissue's range
_PROMINENCE = 0.02  # likewise
_WINDOW_HU = 12  # to either side of a maximum: values that its mean is taken over
# error over full width at half prominence: a quarter of the maximum's standard deviation
_WIDTH_ERROR = 0.1
_SMALLEST_MM3 = 500.0  # of air, fat or muscle; smaller parts are mixtures at boundaries
_FEWEST_VOXELS = 60
_DENSE_HU = 700.0  # above trabecular bone and contrast medium
_METAL_HU = 2500.0  # above all bone but enamel
_METAL_REACH_MM = 12.0  # bone nearer to metal is left out: streaks falsify it
_DENSEST_SHARE = 0.1  # of the dense voxels: the others hold pores and partial volume
_SMALLEST_CORTEX_MM3 = 80.0
# smallest standard error of a region: 12-bit steps of 1 and shading across the image
_ERROR_HU = 1.0


@dataclass(frozen=True)
class Region:
    """Mean value of one tissue in an image and its standard error [HU]."""

    mean_HU: float
    error_HU: float


@dataclass(frozen=True)
class Calibration:
    """Density law of Hounsfield units that a calibration found.

    `energy_keV` is the effective energy, with its standard deviation.
    """

    law: DensityLaw
    energy_keV: float
    energy_sd_keV: float


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
            f"be internal, {', '.join(DENSITY_LAWS)}, or line:SLOPE,OFFSET in kg/m3 of apparent "
            "density (line:SLOPE,OFFSET,K2HPO4 or ,HA of a phantom)",
            f"{text!r}",
            "use internal, or line:1.17,-15",
        )
    return line_law(slope, offset, *parts[2:])


def fit_regions(regions: dict[str, Region], *, source: str) -> Calibration:
    """Fit effective energy, scanner line and density law to the means of regions.

    The fit includes the uncertainty of the results.

    The unknowns are the energy, the scanner's error of water and scale, the fat in marrow and each
    tissue's deviation from ICRU 44, as standard normal numbers. The covariance is the covariance of
    the linearised problem.

    Raises
    ------
    InputError
        If too few tissues are given, or their values fit no energy.
    """
    from scipy.optimize import approx_fprime, least_squares
    from scipy.special import chdtri

    tissues = [tissue for tissue in _SPREAD if tissue in regions]
    # Air has nearly the same value at every energy, and cortex alone differs most between persons.
    if len(tissues) < 2 or not {"adipose", "muscle"}.intersection(tissues):
        raise InputError(
            "an internal calibration",
            "find fat or muscle and a second tissue",
            f"{', '.join(tissues) or 'none'} in {source}",
            "keep the soft tissue in the image, or give a phantom's line as line:SLOPE,OFFSET",
        )
    means = np.array([regions[tissue].mean_HU for tissue in tissues])
    errors = np.array([regions[tissue].error_HU for tissue in tissues])

    def misfit(unknown: Array) -> Array:
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
        seen = ", ".join(f"{tissue} {regions[tissue].mean_HU:.0f}" for tissue in tissues)
        raise InputError(
            "grey values",
            "be Hounsfield units for an internal calibration",
            f"{seen} in {source}, which fit no energy",
            "give a phantom's line as line:SLOPE,OFFSET",
        )
    covariance = np.linalg.inv(found.jac.T @ found.jac) * max(
        squared / chdtri(len(tissues), _CHANCE), 1.0
    )
    slope, offset = _density_line(found.x)
    # The unknowns are about 1, so this step is far above rounding and far below their spread.
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
    """Compute the Hounsfield units that the scanner shows for a linear attenuation [1/m]."""
    true = hounsfield(attenuation_1_m, _energy(unknown))
    return (1.0 + _SCALE_SD * float(unknown[1])) * true + _WATER_SD_HU * float(unknown[2])


def _density_line(unknown: Array) -> Array:
    """Compute slope [kg/m3 per HU] and offset [kg/m3] of a mixture of dense bone and marrow."""
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

    A voxel is homogeneous if its neighbourhood varies by no more than noise. Air, fat and muscle
    are their most frequent values in the tissues' ranges. Cortex is the densest tenth of the voxels
    that are surrounded by bone, away from metal.
    """
    from scipy.ndimage import uniform_filter

    # At least four slices: each slab is filtered with two more on either side.
    thickness = max(int(_SLAB_VOXELS // math.prod(image.values.shape[:2])), 4)
    whole = range(0, image.values.shape[2], thickness)
    starts = whole[:: math.ceil(image.values.size / _MOST_VOXELS)]
    _, mean, sd, _, _ = _filtered(image, starts[len(starts) // 2], thickness)
    # Fat to muscle [HU]. Voxels at edges have a larger deviation, so noise is a low quantile.
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
        # A scanner writes a constant lowest value outside its field of view, unless that value is
        # air: from -1015 HU on it is air itself.
        held = (sd > 0.0) | (mean != padding) | (padding >= air_low + 45.0)
        # 1 and 3 HU admit images with hardly any noise.
        even = held & (sd < 1.6 * noise + 1.0) & (spread < 3.0 * noise + 3.0)
        counts += np.histogram(mean[even], bins=len(counts), range=_BINS_HU)[0]
        # Every seventh value: the median needs no more, and air fills half of an image.
        air.append(values[even & (mean > air_low) & (mean < air_high)][::7])
        bone = least > _DENSE_HU
        metal = values > _METAL_HU
        # Fewer bright voxels are noise or enamel. The share of metal around a voxel is 0 up to
        # rounding.
        if bone.any() and metal.sum() >= 5:
            bone &= uniform_filter(metal.astype(np.float32), reach) < 1e-6
        # Pores below the resolution vary the values of cortex by more than noise: 6 % are allowed.
        dense.append(mean[bone & (sd < np.maximum(2.0 * noise, 0.06 * mean))])
    found = {tissue: _most_frequent(tissue, counts, voxel_mm3, noise) for tissue in _MODES_HU}
    if found["air"] is not None:
        # Values cut off at -1024 do not move the median. An error of 1 to 10 HU changes the energy
        # of the synthetic CT by 0.01 keV.
        found["air"] = Region(float(np.median(np.concatenate(air))), 3.0)
    found["cortex"] = _cortex(np.concatenate(dense), voxel_mm3)
    return {tissue: region for tissue, region in found.items() if region is not None}


def _filtered(image: Image, start: int, thickness: int) -> list[Singles]:
    """Filter a slab of an image over 3 x 3 x 3 voxels.

    Returns the values, and their mean, standard deviation, spread of the mean, and minimum.
    """
    from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

    # Two filters of three voxels after each other need two more slices at each end.
    first = max(start - 2, 0)
    values = image.values[:, :, first : start + thickness + 2].astype(np.float32)
    shift = np.float32(values.mean())  # sums of squares keep their digits
    mean = uniform_filter(values - shift, 3)
    variance = uniform_filter((values - shift) ** 2, 3) - mean**2
    filtered = (
        values,
        mean + shift,
        # 1e-3 HU2 is above the rounding of the sums, so that constant values have deviation 0.
        np.sqrt(np.maximum(variance - 1e-3, 0.0)),
        maximum_filter(mean, 3) - minimum_filter(mean, 3),
        minimum_filter(values, 3),
    )
    return [each[:, :, start - first : start - first + thickness] for each in filtered]


def _most_frequent(tissue: str, counts: Ints, voxel_mm3: float, noise: float) -> Region | None:
    """Find the maximum of the histogram in the tissue's range, if it holds enough voxels.

    It is the highest maximum. For muscle it is the lowest maximum that is not small, since organs
    with contrast medium lie above it. The error grows with the maximum's width, which several
    tissues may increase.
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
        # A counted value is a mean of 27 voxels, so count / 27 of them are independent.
        mean,
        math.hypot(_ERROR_HU, noise / math.sqrt(count / 27.0), _WIDTH_ERROR * width),
    )


def _cortex(dense: Singles, voxel_mm3: float) -> Region | None:
    """Compute the median of the densest tenth; its error is half of its spread."""
    count = max(
        int(_DENSEST_SHARE * len(dense)),
        math.ceil(_SMALLEST_CORTEX_MM3 / voxel_mm3),
        _FEWEST_VOXELS,
    )
    if len(dense) < count:
        return None
    densest = np.sort(dense)[-count:]
    error = 0.5 * float(np.quantile(densest, 0.8) - np.quantile(densest, 0.2))
    # 5 HU is the smallest error: 1 to 15 HU change the energy by less than 0.1 keV.
    return Region(float(np.median(densest)), math.hypot(5.0, error))
