"""What a CT holds: whether its values are Hounsfield units, its noise, metal in it, and how much of it is what."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Ints
from meshes.base.errors import by, in_brackets
from meshes.images.frame import Image

__all__ = ["Histogram", "Inspection", "histogram_of", "inspect"]

AIR_HU, SOFT_HU = (-1100, -900), (-150, 150)
"""Ranges in which air, and fat to muscle, lie in any CT [HU]."""
METAL_HU = 3000
"""Above it lies no tissue: enamel, the densest, reaches about 2800 HU at 120 kV (M)."""
_COARSE_MM = 5.0
"""Distance of slices from which they are reported as coarse."""
_LEAST_METAL = 8
"""Voxels: fewer are noise."""
_LEAST_SHARE = 1e-3
_LOWEST, _HIGHEST = -2000, 20_000
"""Values beyond are counted at the ends of the histogram."""
_MOST_SAMPLED = 4_000_000
_MAD = 0.6745
"""Median absolute deviation of a normal variable of sd 1."""


@dataclass(frozen=True, eq=False)
class Histogram:
    """How many voxels have each whole value.

    Attributes
    ----------
    first
        Value of the first count.
    counts
        Voxels by value, shape (n,).
    """

    first: int
    counts: Ints

    @property
    def values(self) -> Ints:
        """Value of each count."""
        return self.first + np.arange(len(self.counts))

    def share(self, low: float, high: float) -> float:
        """Share of voxels from one value to another."""
        inside = (self.values >= low) & (self.values <= high)
        return float(self.counts[inside].sum() / self.counts.sum())

    def peak(self, low: float, high: float, *, width: int = 15) -> float | None:
        """Most frequent value within a range, counts averaged over `width` values; None where nothing lies there."""
        inside = (self.values >= low) & (self.values <= high)
        if not self.counts[inside].any():
            return None
        smooth = np.convolve(self.counts[inside], np.ones(width), mode="same")
        return float(self.values[inside][int(np.argmax(smooth))])


@dataclass(frozen=True)
class Inspection:
    """What was found in an image.

    Attributes
    ----------
    source
        File or folder name.
    shape, spacing_mm
        Voxels, and the distance between neighbours [mm], along left, back and head.
    low_mm, high_mm
        Corners of the image [mm, LPS].
    lowest, highest
        Least and greatest value.
    is_hounsfield
        Whether the values can be Hounsfield units: air about -1000 or soft tissue about 0 to 60.
    noise
        Standard deviation of soft tissue between neighbours, in units of the values; None where there is none. Noise
        that neighbours share is not in it.
    metal_mm3, metal_mm
        Volume above 3000 HU [mm3] and the centre of it [mm, LPS]; None where there is none.
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

    def sentences(self) -> list[str]:
        """What a person should know, a sentence each."""
        size = by(np.subtract(self.high_mm, self.low_mm), ".4g")
        found = [
            f"{self.source}: {by(self.shape)} voxels of {by(self.spacing_mm, '.4g')} mm, {size} mm in all "
            "(left, back, head)",
            f"values from {self.lowest:g} to {self.highest:g}"
            + (", Hounsfield units by their air and soft tissue" if self.is_hounsfield else ", not Hounsfield units"),
        ]
        if max(self.spacing_mm) >= _COARSE_MM:
            found.append(
                f"voxels up to {max(self.spacing_mm):.4g} mm apart are coarse: the bone between them is interpolated, "
                "and thin parts are lost"
            )
        if self.noise is not None:
            found.append(f"noise of soft tissue: {self.noise:.3g} HU (standard deviation between neighbours)")
        if self.metal_mm is not None:
            found.append(
                f"metal: {self.metal_mm3:.3g} mm3 above {METAL_HU} HU around {in_brackets(self.metal_mm, '.4g')} mm; "
                "streaks falsify density around it"
            )
        return found


def histogram_of(values: NDArray[np.number]) -> Histogram:
    """Counts of the values, rounded to whole ones."""
    if np.issubdtype(values.dtype, np.integer):
        low, high = max(int(values.min()), _LOWEST), min(int(values.max()), _HIGHEST)
        clipped = values if (int(values.min()), int(values.max())) == (low, high) else np.clip(values, low, high)
        whole = clipped.astype(np.int32).ravel(order="K")
    else:
        whole = np.rint(np.clip(values, _LOWEST, _HIGHEST)).astype(np.int32).ravel(order="K")
        low = int(whole.min())
    whole -= np.int32(low)
    return Histogram(low, np.bincount(whole))


def inspect(image: Image) -> Inspection:
    """Look into an image volume of LPS axes."""
    values, spacing = image.values, np.array(image.spacing_mm)
    histogram = histogram_of(values)
    air, soft = histogram.share(*AIR_HU), histogram.share(*SOFT_HU)
    hounsfield = histogram.first < -100 and (air > _LEAST_SHARE or soft > 0.01)
    metal_mm3, metal_mm = 0.0, None
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
    )


def _noise(values: NDArray[np.number]) -> float | None:
    """Standard deviation of soft tissue between neighbours in a slice, robust against edges."""
    step = max(round(values.size / _MOST_SAMPLED), 1)
    slices = values[:, :, ::step].astype(np.float32)
    low, high = SOFT_HU
    one, next_to_it = slices[:-1], slices[1:]
    inside = (one > low) & (one < high) & (next_to_it > low) & (next_to_it < high)
    found = (next_to_it - one)[inside]
    if len(found) < 1000:
        return None
    return float(np.median(np.abs(found)) / (_MAD * np.sqrt(2.0)))
