"""Inspection of a CT image.

The inspection detects Hounsfield units, noise and metal. It suggests a threshold of bone, and
checks whether the image has plausible values in a label.
"""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Flags, Ints, Numbers
from meshes.base.errors import InputError, by, in_brackets
from meshes.images.frame import Image

AIR_HU = (-1100, -900)
SOFT_HU = (-150, 150)
"""Range of air (`AIR_HU`), and range from fat to muscle (`SOFT_HU`), in any CT [HU]."""
METAL_HU = 3000
"""Hounsfield units above which a voxel is metal. No tissue exceeds this value.

Enamel, the densest tissue, has up to about 2800 HU at 120 kV (from memory of the literature, medium
confidence).
"""
_COARSE_MM = 3.0
"""Slice distance above which slices are reported as coarse.

The value is larger than the thickness of most cortices.
"""
_LEAST_METAL = 8
"""Smallest number of voxels above `METAL_HU` that count as metal; fewer voxels are noise."""
_LEAST_SHARE = 1e-3
"""Smallest share of voxels with values in `AIR_HU` at which an image is assumed to contain air.

An image with air around a patient has a far larger share.
"""
_LOWEST = -2000
_HIGHEST = 20_000
"""Upper limit of the histogram. `_LOWEST` is the lower limit.

Values outside the limits are counted in the first and the last bin.

The limits bound the size of the histogram. CT values lie inside the limits: air has -1000 HU, and
metal has a few thousand HU.
"""
_MOST_SAMPLED = 4_000_000
"""Number of voxels from which noise is estimated. The error of the estimate is then about 0.1 %."""
_MAD = 0.6745
"""Median absolute deviation of a normal variable with a standard deviation of 1."""
LOWEST_HU = 150.0
HIGHEST_HU = 600.0
"""Smallest (`LOWEST_HU`) and largest threshold of bone in common use [HU].

Common thresholds are 150 HU for osteoporotic bone, 226 HU as the default of several programs, and
600 HU for cortical bone only.
"""
_SOFT_PEAK_HU = (-50.0, 120.0)
"""Range [HU] in which the most frequent value of soft tissue is searched.

The range includes fat, and soft tissue with contrast medium.
"""
_MOST_HU = 1600.0
"""Upper limit [HU] of the values from which the threshold of bone is computed.

Higher values, from enamel and metal, would raise the threshold.
"""
_EQUAL = 1e-9
"""Relative difference below which two variances count as equal.

The value is larger than the rounding error of sums of up to 1e9 voxels.
"""
_NO_BONE = 0.1
_LITTLE_BONE = 0.5
_ALL_BONE = 0.8
"""Limits for the share of a bone's label with values above `LOWEST_HU`.

Below `_NO_BONE`, an error is raised, because the cortex is more than a tenth of any bone. Below
`_LITTLE_BONE`, a warning is given, because the label may be mostly marrow, as in the humeral head
of an old person. The message suggests a flip if the flipped label has a share above `_ALL_BONE`.
"""
_FLIPS = ("left to right", "front to back", "head to feet")
_SOFT_ORGAN_HU = (-200.0, 300.0)
"""Range of the median value of a soft organ in any CT, with or without contrast agent [HU]."""
_CAUSES = (
    "give the labels of this image, and check that they are not flipped, moved or of another organ"
)


@dataclass(frozen=True, eq=False)
class Histogram:
    """Number of voxels of each integer value.

    Attributes
    ----------
    first
        Integer value to which the first count belongs.
    counts
        Number of voxels of each value, shape (n,).
    """

    first: int
    counts: Ints

    @property
    def values(self) -> Ints:
        """Integer value to which each count belongs."""
        return self.first + np.arange(len(self.counts))

    def share(self, low: float, high: float) -> float:
        """Return the share of voxels with values in a range."""
        inside = (self.values >= low) & (self.values <= high)
        return float(self.counts[inside].sum() / self.counts.sum())

    def peak(self, low: float, high: float) -> float | None:
        """Return the most frequent value in a range, or None if the range is empty.

        The counts are averaged over 15 values.
        """
        inside = (self.values >= low) & (self.values <= high)
        if not self.counts[inside].any():
            return None
        # Single counts have random maxima, with errors of up to 29 HU in two CTs. The results for
        # widths of 5 to 41 differ by at most 6 HU.
        smooth = np.convolve(self.counts[inside], np.ones(15), mode="same")
        return float(self.values[inside][int(np.argmax(smooth))])


@dataclass(frozen=True)
class Inspection:
    """Properties of an image.

    Attributes
    ----------
    source
        File or folder name.
    shape, spacing_mm
        Number of voxels, and distance between neighbours [mm], along x (left), y (back) and z
        (head).
    low_mm, high_mm
        Smallest and largest coordinates of the image [mm, LPS].
    lowest, highest
        Smallest and largest value.
    is_hounsfield
        Whether the values may be Hounsfield units. This is true if the lowest value is below -100,
        and enough values lie in the range of air or in the range of soft tissue.
    noise
        Estimated standard deviation of the values in soft tissue; None if there is no soft tissue.
        It is computed from differences between neighbouring voxels. Noise that is correlated
        between neighbouring voxels is not included.
    metal_mm3, metal_mm
        Volume of the voxels above 3000 HU [mm3], and their centre [mm, LPS]; 0 and None if there is
        no metal.
    padding
        Share of voxels with the lowest value if this value is below that of air; otherwise 0.
    """

    source: str
    shape: tuple[int, int, int]
    spacing_mm: tuple[float, float, float]
    low_mm: tuple[float, float, float]
    high_mm: tuple[float, float, float]
    lowest: float
    highest: float
    is_hounsfield: bool
    noise: float | None
    metal_mm3: float
    metal_mm: tuple[float, float, float] | None
    padding: float = 0.0

    def sentences(self) -> list[str]:
        """Return sentences that describe the image to users."""
        size = by(np.subtract(self.high_mm, self.low_mm), ".4g")
        found = [
            f"{self.source}: {by(self.shape)} voxels of {by(self.spacing_mm, '.4g')} mm, "
            f"{size} mm in all (left, back, head), from {in_brackets(self.low_mm, '.4g')} to "
            f"{in_brackets(self.high_mm, '.4g')} mm in LPS",
            f"values from {self.lowest:g} to {self.highest:g}"
            + (
                ", Hounsfield units by their air and soft tissue"
                if self.is_hounsfield
                else ", not Hounsfield units"
            ),
        ]
        if max(self.spacing_mm) >= _COARSE_MM:
            found.append(
                f"voxels up to {max(self.spacing_mm):.4g} mm apart are coarse: the bone "
                "between them is interpolated, "
                "and thin parts are lost"
            )
        if self.padding:
            found.append(
                f"padding: {self.padding:.1%} of the voxels have the value {self.lowest:g}, below "
                "air; they count as air"
            )
        if self.noise is not None:
            found.append(
                f"noise of soft tissue: {self.noise:.3g} HU (standard deviation between neighbours)"
            )
        if self.metal_mm is not None:
            found.append(
                f"metal: {self.metal_mm3:.3g} mm3 above {METAL_HU} HU around "
                f"{in_brackets(self.metal_mm, '.4g')} mm; "
                "streaks falsify density around it"
            )
        return found


def histogram_of(values: Numbers) -> Histogram:
    """Count the values after rounding to integers."""
    if np.issubdtype(values.dtype, np.integer):
        low = max(int(values.min()), _LOWEST)
        high = min(int(values.max()), _HIGHEST)
        whole = np.clip(values, low, high).astype(np.int32).ravel(order="K")
    else:
        whole = np.rint(np.clip(values, _LOWEST, _HIGHEST)).astype(np.int32).ravel(order="K")
        low = int(whole.min())
    whole -= np.int32(low)
    return Histogram(low, np.bincount(whole))


def inspect(image: Image) -> Inspection:
    """Inspect an image volume with LPS axes."""
    values = image.values
    spacing = np.array(image.spacing_mm)
    histogram = histogram_of(values)
    # A crop may not contain air. In other images, 1 % of the grey values may lie near 0 by chance,
    # but no value is below -100.
    is_tissue = histogram.share(*AIR_HU) > _LEAST_SHARE or histogram.share(*SOFT_HU) > 0.01
    hounsfield = histogram.first < -100 and is_tissue
    metal_mm3 = 0.0
    metal_mm = None
    if hounsfield and int(histogram.counts[histogram.values > METAL_HU].sum()) >= _LEAST_METAL:
        at = np.argwhere(values > METAL_HU)
        metal_mm3 = float(len(at) * spacing.prod())
        metal_mm = tuple((np.median(at, axis=0) * spacing + image.origin_mm).tolist())
    low = np.array(image.origin_mm) - 0.5 * spacing
    high = low + spacing * values.shape
    return Inspection(
        image.source,
        tuple(values.shape),
        image.spacing_mm,
        tuple(low.tolist()),
        tuple(high.tolist()),
        float(values.min()),
        float(values.max()),
        hounsfield,
        _noise(values) if hounsfield else None,
        metal_mm3,
        metal_mm,
        _padding(values) if hounsfield else 0.0,
    )


def _padding(values: Numbers) -> float:
    """Return the share of padding voxels, that is, of voxels with the lowest value.

    The result is 0 if the lowest value is not below air, or is caused by noise.
    """
    lowest = values.min()
    share = np.count_nonzero(values == lowest) / values.size
    return share if lowest < AIR_HU[0] and share > _LEAST_SHARE else 0.0


def _noise(values: Numbers) -> float | None:
    """Estimate the noise of soft tissue from differences of neighbours in a slice.

    The estimate is a standard deviation and is robust against edges.
    """
    step = max(round(values.size / _MOST_SAMPLED), 1)
    slices = values[:, :, ::step].astype(np.float32)
    low, high = SOFT_HU
    soft = (slices > low) & (slices < high)
    found = np.diff(slices, axis=0)[soft[:-1] & soft[1:]]
    # With 1000 differences, the error of the median is about 4 %.
    if len(found) < 1000:
        return None
    return float(np.median(np.abs(found)) / (_MAD * np.sqrt(2.0)))


def suggest_threshold(histogram: Histogram, *, is_hounsfield: bool) -> tuple[float, str]:
    """Suggest a threshold of bone, and return it with a sentence that explains the choice.

    Otsu's criterion determines the threshold between soft tissue and bone.

    For Hounsfield units, only values above soft tissue are used, and the threshold is limited to
    150 to 600 HU. If no soft tissue is found, the threshold is 226 HU.
    """
    values = histogram.values.astype(np.float64)
    counts = histogram.counts.astype(np.float64)
    if not is_hounsfield:
        level = _otsu(values, counts)
        return level, f"threshold {level:g} by Otsu's criterion over all values"
    soft = histogram.peak(*_SOFT_PEAK_HU)
    if soft is None:
        return (
            226.0,
            "threshold 226 HU, the value of common programs, because no soft tissue was found",
        )
    part = (values > soft) & (values < _MOST_HU)
    level = min(max(round(_otsu(values[part], counts[part])), LOWEST_HU), HIGHEST_HU)
    return level, f"threshold {level:g} HU by Otsu's criterion above soft tissue at {soft:g} HU"


def _otsu(values: Array, counts: Array) -> float:
    """Return the threshold with the largest between-class variance of a histogram (Otsu 1979).

    If there are empty bins between the two classes, all of them give the same variance. The
    threshold is then in the middle between the classes.
    """
    weight = np.cumsum(counts)
    mass = np.cumsum(counts * values)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (mass[-1] * weight / weight[-1] - mass) ** 2 / (weight * (weight[-1] - weight))
    between = np.where(np.isfinite(between), between, -1.0)
    best = np.flatnonzero(between[:-1] >= (1.0 - _EQUAL) * between.max())
    if len(best) < 2:
        return float(values[int(between.argmax())])
    return float(0.5 * (values[best[0]] + values[best[-1] + 1]))


def bone_label_note(image: Image, mask: Flags, name: str) -> str:
    """Return a warning if most of a bone's label is below 150 HU, else an empty string.

    Parameters
    ----------
    image
        CT [HU].
    mask
        Mask of the label's voxels, same shape as the image. At least one voxel is set.
    name
        Name of the label.

    Raises
    ------
    InputError
        If less than a tenth of the label is above 150 HU, because the label then does not lie on
        bone.
    """
    bone = image.values > LOWEST_HU
    share = float(bone[mask].mean())
    found = (
        f"{share:.0%} of its voxels above {LOWEST_HU:g} HU in {image.source} and a "
        f"median of {np.median(image.values[mask]):.0f} HU"
    )
    if share < _LITTLE_BONE:
        flipped = [float(bone[np.flip(mask, axis)].mean()) for axis in range(3)]
        axis = int(np.argmax(flipped))
        # If nearly all of the flipped label lies on bone, the message states that the label is
        # flipped.
        if flipped[axis] > max(_ALL_BONE, 2.0 * share):
            found += f" ({flipped[axis]:.0%} if it were flipped {_FLIPS[axis]})"
    if share < _NO_BONE:
        raise InputError("region", "be a label on bone", f"{name} with {found}", _CAUSES)
    if share < _LITTLE_BONE:
        return f"warning: most of {name} is not bone: {found}. If it is not marrow, {_CAUSES}."
    return ""


def soft_label_note(image: Image, mask: Flags, name: str) -> str:
    """Return a warning if an organ's label does not lie on soft tissue, else an empty string.

    The label does not lie on soft tissue if the median value in it is outside -200 to 300 HU.

    The parameters are the same as in `bone_label_note`.
    """
    low, high = _SOFT_ORGAN_HU
    middle = float(np.median(image.values[mask]))
    if low <= middle <= high:
        return ""
    return (
        f"warning: {name} does not lie on soft tissue, because its median is {middle:.0f} HU. "
        f"{_CAUSES[0].upper()}{_CAUSES[1:]}."
    )
