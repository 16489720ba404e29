"""Regions of air, fat, muscle, blood and dense cortex in a CT, found by themselves or with the help of labels."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Ints, Singles
from meshes.ct.labels import Labels, on_grid_of
from meshes.images.frame import Image

__all__ = ["Region", "find_regions"]

_SLAB_VOXELS = 4e6
_MOST_VOXELS = 4e7
"""Larger images are looked at in every second, third ... slab."""
_MODES_HU = {"air": (-1060.0, -940.0), "adipose": (-140.0, -45.0), "muscle": (15.0, 95.0)}
"""Where the most frequent value of a tissue lies between effective energies of 40 and 120 keV, for the tissues of ICRU
44 (fat -99 to -57, muscle 45 to 40) and 35 Hounsfield units to either side."""
_SMOOTHING_HU = 4.0
_LEAST_PEAK, _PROMINENCE = 0.2, 0.02
"""Height and prominence of a maximum over the highest in the tissue's range."""
_WINDOW_HU = 12
_WIDTH_ERROR = 0.1
"""Error of a maximum over its full width at half prominence: a quarter of its standard deviation."""
_SMALLEST_MM3 = 500.0
_FEWEST_VOXELS = 60
_DENSE_HU = 700.0
_METAL_HU = 2500.0
"""Above all bone but enamel; metal and its surroundings are left out."""
_METAL_REACH_MM = 12.0
_DENSEST_SHARE = 0.1
_SMALLEST_CORTEX_MM3 = 80.0
_ERROR_HU = 1.0
"""Least standard error of a region: 12-bit steps of 1 and shading across the image."""
_BLOOD = ("aorta", "inferior_vena_cava", "superior_vena_cava", "heart", "blood")
_MUSCLE = ("gluteus", "autochthon", "iliopsoas", "muscle", "quadriceps", "deltoid")
_ADIPOSE = ("subcutaneous_fat", "adipose", "fat")
_LABELLED = {"blood": _BLOOD, "muscle": _MUSCLE, "adipose": _ADIPOSE}
_LABEL_RANGE_HU = {"blood": (20.0, 95.0), "muscle": (0.0, 110.0), "adipose": (-160.0, -30.0)}
"""Labelled tissue outside its range is not used: contrast medium in blood, for one."""


@dataclass(frozen=True)
class Region:
    """One tissue in an image: mean and its standard error [HU], volume [mm3], and how it was found."""

    tissue: str
    mean_HU: float
    error_HU: float
    volume_mm3: float
    found_by: str

    def as_dict(self) -> dict[str, Any]:
        """The region as a JSON object."""
        return asdict(self)


@dataclass(frozen=True, eq=False)
class _Slab:
    """Some slices with what filters of 3 x 3 x 3 voxels make of them, flat arrays but for `values`."""

    values: Singles
    mean: Singles
    sd: Singles
    spread: Singles
    least: Singles


def find_regions(image: Image, *, labels: Labels | None = None) -> dict[str, Region]:
    """Regions of each tissue that the image holds, by tissue: air, adipose, muscle, blood, cortex.

    Homogeneous voxels are those whose neighbourhood varies by no more than noise; air, fat and muscle are the most
    frequent values of them in their ranges. Cortex is the densest tenth of the bone whose 26 neighbours are bone too,
    away from metal. Blood has the value of muscle: it takes labels.

    Parameters
    ----------
    image
        The CT [Hounsfield units].
    labels
        Labels such as TotalSegmentator's; muscles, vessels and fat are taken from them.
    """
    voxel_mm3 = math.prod(image.spacing_mm)
    slabs = _slab_starts(image.values.shape)
    noise = _noise(image, slabs)
    counts = np.zeros(1300, dtype=np.int64)
    air: list[Singles] = []
    dense: list[Singles] = []
    padding = float(image.values.min())
    reach = _METAL_REACH_MM / np.array(image.spacing_mm)
    for slab in _slabs(image, slabs):
        held = (slab.sd > 0.0) | (slab.mean != padding) | (padding >= _MODES_HU["air"][0] + 45.0)
        even = held & (slab.sd < 1.6 * noise + 1.0) & (slab.spread < 3.0 * noise + 3.0)
        counts += np.histogram(slab.mean[even], bins=len(counts), range=(-1100.0, 200.0))[0]
        low, high = _MODES_HU["air"]
        air.append(slab.values[even & (slab.mean > low) & (slab.mean < high)][::7])
        dense.append(_dense_voxels(slab, noise, reach))
    used = len(slabs.starts) / slabs.whole
    regions = {
        tissue: region
        for tissue in _MODES_HU
        if (region := _most_frequent(tissue, counts, voxel_mm3 / used, noise)) is not None
    }
    if "air" in regions:  # the median is not moved by values cut off at -1024
        regions["air"] = Region("air", float(np.median(np.concatenate(air))), 3.0, regions["air"].volume_mm3, "value")
    cortex = _cortex(np.concatenate(dense), voxel_mm3 / used)
    return regions | ({"cortex": cortex} if cortex else {}) | (_labelled(image, labels, noise) if labels else {})


@dataclass(frozen=True)
class _Slabs:
    starts: range
    thickness: int
    whole: int


def _slab_starts(shape: tuple[int, ...]) -> _Slabs:
    """First slices of the slabs that are looked at, their thickness, and how many would be the whole image."""
    thickness = max(int(_SLAB_VOXELS // (shape[0] * shape[1])), 4)
    whole = math.ceil(shape[2] / thickness)
    return _Slabs(range(0, shape[2], thickness * math.ceil(math.prod(shape) / _MOST_VOXELS)), thickness, whole)


def _slabs(image: Image, slabs: _Slabs) -> Iterator[_Slab]:
    from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

    for first in slabs.starts:
        start, stop = max(first - 2, 0), min(first + slabs.thickness + 2, image.values.shape[2])
        values = image.values[:, :, start:stop].astype(np.float32)
        centre = slice(first - start, first - start + slabs.thickness)
        shift = np.float32(values.mean())
        mean = uniform_filter(values - shift, 3)
        variance = uniform_filter((values - shift) ** 2, 3) - mean**2
        spread = maximum_filter(mean, 3) - minimum_filter(mean, 3)
        sd = np.sqrt(np.maximum(variance - 1e-3, 0.0))
        least = minimum_filter(values, 3)
        yield _Slab(*(a[:, :, centre] for a in (values, mean + shift, sd, spread, least)))


def _noise(image: Image, slabs: _Slabs) -> float:
    """Noise [HU]: the lower third of local standard deviations in soft tissue, or of all voxels where there is none."""
    middle = slabs.starts[len(slabs.starts) // 2]
    slab = next(_slabs(image, _Slabs(range(middle, middle + 1), slabs.thickness, slabs.whole)))
    soft = slab.sd[(slab.mean > -160.0) & (slab.mean < 120.0)]
    return float(np.quantile(soft if soft.size > 1000 else slab.sd, 0.3))


def _most_frequent(tissue: str, counts: Ints, voxel_mm3: float, noise: float) -> Region | None:
    """Region around a maximum of the histogram in the tissue's range, if it holds enough.

    The highest maximum; of muscle the lowest that is not small, since organs with contrast medium lie above it. The
    error grows with the maximum's width, where several tissues make it.
    """
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import find_peaks, peak_widths

    low, high = (int(edge) + 1100 for edge in _MODES_HU[tissue])
    smooth = gaussian_filter1d(counts.astype(np.float64), _SMOOTHING_HU)[low:high]
    peaks = find_peaks(smooth, height=_LEAST_PEAK * smooth.max(), prominence=_PROMINENCE * smooth.max())[0]
    if smooth.max() <= 0.0 or not len(peaks):
        return None
    peak = peaks[0] if tissue == "muscle" else peaks[np.argmax(smooth[peaks])]
    width = float(peak_widths(smooth, [peak])[0][0])
    top = low + int(peak)
    window = np.arange(max(top - _WINDOW_HU, 0), min(top + _WINDOW_HU + 1, len(counts)))
    inside = counts[window]
    count = int(inside.sum())
    if count * voxel_mm3 < _SMALLEST_MM3 or count < _FEWEST_VOXELS:
        return None
    mean = float(np.average(window + 0.5 - 1100.0, weights=inside))
    error = math.hypot(_ERROR_HU, noise / math.sqrt(count / 27.0), _WIDTH_ERROR * width)
    return Region(tissue, mean, error, count * voxel_mm3, "value")


def _dense_voxels(slab: _Slab, noise: float, reach: Array) -> Singles:
    """Local means [HU] of bone within bone, away from metal."""
    from scipy.ndimage import uniform_filter

    chosen = slab.least > _DENSE_HU
    metal = slab.values > _METAL_HU
    if chosen.any() and metal.sum() >= 5:
        near = uniform_filter(metal.astype(np.float32), tuple(2 * math.ceil(each) + 1 for each in reach))
        chosen &= near < 1e-6
    return slab.mean[chosen & (slab.sd < np.maximum(2.0 * noise, 0.06 * slab.mean))]


def _cortex(dense: Singles, voxel_mm3: float) -> Region | None:
    """Median of the densest tenth, its error from how the tenth above and below differ."""
    count = max(int(_DENSEST_SHARE * len(dense)), math.ceil(_SMALLEST_CORTEX_MM3 / voxel_mm3), _FEWEST_VOXELS)
    if len(dense) < count:
        return None
    densest = np.sort(dense)[-count:]
    error = 0.5 * float(np.quantile(densest, 0.8) - np.quantile(densest, 0.2))
    return Region("cortex", float(np.median(densest)), math.hypot(5.0, error), count * voxel_mm3, "value")


def _labelled(image: Image, labels: Labels, noise: float) -> dict[str, Region]:
    """Tissues that labels name, two voxels inside them, where their value is what the tissue may have."""
    from scipy.ndimage import find_objects

    labels = on_grid_of(labels, image)
    voxel_mm3, numbers = math.prod(image.spacing_mm), labels.image.values
    boxes = dict(enumerate(find_objects(numbers.astype(np.uint8)), start=1))
    found = {}
    for tissue, names in _LABELLED.items():
        chosen = {number: name for number, name in labels.names.items() if name.lower().startswith(names)}
        parts = [_inner(image.values, numbers, number, box) for number in chosen if (box := boxes.get(number))]
        inside = np.concatenate(parts) if parts else np.empty(0)
        low, high = _LABEL_RANGE_HU[tissue]
        middle = float(np.median(inside)) if len(inside) >= _FEWEST_VOXELS else math.nan
        if low < middle < high and len(inside) * voxel_mm3 >= _SMALLEST_MM3:
            error = math.hypot(2.0 * _ERROR_HU, noise / math.sqrt(len(inside)))
            by = f"labels {', '.join(list(chosen.values())[:3])}"
            found[tissue] = Region(tissue, middle, error, len(inside) * voxel_mm3, by)
    return found


def _inner(
    values: NDArray[np.number], numbers: NDArray[np.number], number: int, box: tuple[slice, ...]
) -> NDArray[np.number]:
    """Values of a label's voxels that are two voxels inside it."""
    from scipy.ndimage import binary_erosion

    return values[box][binary_erosion(numbers[box] == number, iterations=2)]
