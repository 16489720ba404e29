"""Data of a fit: loads computed from the free constants, and measured loads averaged in blocks."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy.sparse import csr_array

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.materials.constants import Prior
from tissue.models.tissue_model import TICK_S


@dataclass(frozen=True)
class Parameter:
    """Free constant.

    Attributes
    ----------
    name
        Name in the files of constants, ``TABLE.MATERIAL.NAME``, such as
        ``cutting.bone.radial_chip_N_mm2``. ``density.LAYER`` is the factor by which the density map
        of a layer is multiplied.
    prior
        Prior that the fit uses for the constant.
    cited
        Original prior, if the cited value of the constant is an end of its range, such as a size
        exponent of 0. In this case, `prior` is the original prior mirrored at this end
        (`Prior.mirrored`), because the fit needs values on both sides of the end. Values beyond the
        end are replaced by the end, see `tissue.fitting.marginal`. None for a constant whose cited
        value lies inside its range.
    """

    name: str
    prior: Prior
    cited: Prior | None = None

    @classmethod
    def of(cls, name: str, cited: Prior) -> "Parameter":
        """Return the parameter of a cited constant.

        The cited value may lie inside its range or at an end of the range.
        """
        # a search needs values on both sides; `side` marks which of them are possible
        return cls(name, cited.mirrored(), cited) if cited.is_one_sided else cls(name, cited)

    @property
    def side(self) -> float:
        """Side of the cited value on which the constant may lie.

        The side is 1 above the cited value, -1 below it, and 0 if values on both sides are
        possible.
        """
        if self.cited is None:
            return 0.0
        return 1.0 if self.cited.value == self.cited.low else -1.0


def chosen(
    free: Sequence[str],
    possible: Sequence[Parameter],
    tags: Mapping[str, str] | None = None,
) -> list[Parameter]:
    """Return the parameters that match the patterns, or all parameters if there are no patterns.

    A pattern consists of words separated by dots. The first word is the table of the constant. Each
    other word is a part of the constant's name, a word in such a part, or the constant's tag.

    Parameters
    ----------
    free
        Patterns.
    possible
        Parameters to choose from.
    tags
        Tags: additional words that select a parameter, keyed by the parameter's name.

    Raises
    ------
    InputError
        If a pattern selects no parameter.
    """
    words = {}
    for each in possible:
        table, material, *rest = each.name.split(".")
        # names such as specific_energy_J_mm3 are found by their first two words too
        parts = [word for full in rest for word in (full, *full.split("_")[:2])]
        words[each.name] = (table, {material, (tags or {}).get(each.name, material), *rest, *parts})
    selected = set[str]()
    for pattern in free:
        table, *wanted = pattern.split(".")
        found = [
            name for name, (of, known) in words.items() if of == table and known >= set(wanted)
        ]
        if not found:
            raise InputError(
                "free",
                "name constants that can be fitted to this log",
                pattern,
                f"choose among {', '.join(words)}",
            )
        selected.update(found)
    return [each for each in possible if not free or each.name in selected]


class Forward(Protocol):
    """Loads and their derivatives along the poses of a log, as functions of constants."""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The p free constants."""
        ...

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the load components on the tool in the world frame, such as ``force_x_N``."""
        ...

    @property
    def times_s(self) -> Array:
        """Increasing times of the loads on the clock of the poses [s], shape (n,)."""
        ...

    def loads(self, x: Array) -> Array:
        """Return loads [N, N m] for the constants x in their units, shape (n, channels)."""
        ...

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives of loads with respect to constants, shape (n, channels, p)."""
        ...


SD_PER_MAD = 1.4826
"""Standard deviation of a normal variable divided by its median absolute deviation."""
FEWEST = 50
"""Smallest number of samples of a channel that a fit can use.

With fewer samples, the scale and the correlation of its noise cannot be estimated: the standard
error of a correlation is about 1 / sqrt(50) = 0.14.
"""


@dataclass(frozen=True)
class MeasuredLoads:
    """Loads on a tool over time.

    Attributes
    ----------
    times_s
        Times of the samples [s], at a constant rate, on the clock of the force sensor, shape (m,).
    values
        Loads [N, N m], shape (m, channels), NaN where missing.
    channels
        Names with units, such as ``force_x_N``.
    within_s
        Times relative to the time of a sample [s], shape (k,). A sample is the mean of the loads at
        these times.
    """

    times_s: Array
    values: Array
    channels: tuple[str, ...]
    within_s: tuple[float, ...] = (0.0,)

    def sizes(self) -> Array:
        """Robust root mean square of the loads of each channel [N or N m], shape (channels,).

        Outliers have little influence.

        All channels with the same unit get the same size: the largest root mean square among them.
        Without this rule, the size of an unloaded channel would be that of its noise.
        """
        middle = np.nanmedian(self.values, axis=0)
        spread = SD_PER_MAD * np.nanmedian(np.abs(self.values - middle), axis=0)
        # all loads except damaged samples lie within ten standard deviations
        cut = np.clip(self.values, middle - 10.0 * spread, middle + 10.0 * spread)
        # a channel that stays at one value for more than half of the log has no robust spread, so
        # it is not clipped
        size = np.sqrt(np.nanmean(np.where(spread > 0.0, cut, self.values) ** 2, axis=0))
        units = np.array([name.rpartition("_")[2] for name in self.channels])
        return np.array([size[units == unit].max() for unit in units])


@dataclass(frozen=True, eq=False)
class Problem:
    """Data of a fit: load function, measured log, and logs that could be measured next.

    Attributes
    ----------
    forward
        Function from the constants to the loads.
    measured
        Measured log, averaged over blocks.
    block_s
        Length of a block [s].
    candidates
        Function that returns the forward models of logs that could be measured next, keyed by
        description.
    notes
        Remarks for the report.
    fixed
        Fixed constants on which the free constants depend, keyed by name.
    finer
        Load functions that use a finer mesh. The first function uses the finer mesh for the whole
        log. Each further function uses it in one part of the log. None if the loads are computed
        without a mesh.
    mesh_factor
        Error of `forward`, divided by the difference between its loads and the loads on the finer
        mesh.
    """

    forward: Forward
    measured: MeasuredLoads
    block_s: float
    candidates: Callable[[], Mapping[str, Forward]]
    notes: tuple[str, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    finer: tuple[Forward, ...] | None = None
    mesh_factor: float = 1.0


MOST_SAMPLES = 2000
"""Approximate number of samples of a log that a fit uses.

Noise that lasts longer than a block is modelled, not averaged out.
"""
ROUNDING_S = 1e-6
"""Largest rounding error of the time between two samples [s].

Times with six decimals have an error of 1e-6 s. Seconds since 1970 in double precision have an
error of 2.4e-7 s.
"""
LEAST_BLOCK = 5
"""Smallest number of ticks in a block.

The mean over a block removes the force variation from tooth to tooth, and sensor noise above 100
Hz. Neither contains information about constants.
"""


def block_ticks(duration_s: float, period_s: float) -> int:
    """Return the number of ticks in a block, over which a log is averaged.

    If the log is sampled below 200 Hz, a block holds one sample.

    Parameters
    ----------
    duration_s, period_s
        Duration of the log, and time between two of its samples [s].
    """
    # 1e-6 ticks cover the rounding of a quotient that is a whole number
    return max(LEAST_BLOCK, int(np.ceil(max(duration_s / MOST_SAMPLES, period_s) / TICK_S - 1e-6)))


def block_averages(
    times_s: Array, values: Array, channels: tuple[str, ...], ticks: int
) -> MeasuredLoads:
    """Return the means of values over blocks of time.

    A mean is NaN if its block holds less than half of the expected samples.

    Parameters
    ----------
    times_s
        Increasing times [s], at any rate, shape (n,).
    values
        Values, shape (n, channels), NaN where missing.
    channels
        Names of the channels.
    ticks
        Number of ticks in a block.

    Raises
    ------
    InputError
        If a channel has fewer than 50 blocks with a mean.
    """
    block_s = ticks * TICK_S
    # a sample at the start of a block may lie before it by rounding
    place = np.floor((times_s - times_s[0] + ROUNDING_S) / block_s).astype(np.int64)
    count = int(place[-1]) + 1
    rate = float(np.median(np.diff(times_s)))
    known = np.isfinite(values)
    blocks = csr_array((np.ones(len(place)), (place, np.arange(len(place)))), (count, len(place)))
    counts = blocks @ known.astype(float)
    enough = counts >= max(0.5 * block_s / rate, 1.0)
    sums = blocks @ np.where(known, values, 0.0)
    averages = np.where(enough, sums / np.maximum(counts, 1.0), np.nan)
    samples = np.isfinite(averages).sum(axis=0)
    if len(samples) and samples.min() < FEWEST:
        raise InputError(
            "values",
            f"have at least {FEWEST} averaged samples of each channel",
            f"{samples.min()} of {channels[int(np.argmin(samples))]}",
            "remove the channel, or give a longer log",
        )

    starts = times_s[0] + block_s * np.arange(count)
    middles = (blocks @ times_s) / np.maximum(blocks.sum(axis=1), 1.0)
    shift = float(np.median((middles - starts)[enough.any(axis=1)]))
    each = max(round(block_s / rate), 1)
    within_s = tuple((rate * (np.arange(each) - 0.5 * (each - 1))).tolist())
    return MeasuredLoads(starts + shift, averages, channels, within_s)


def shift_operators(
    times_s: Array, wanted_s: Array, offset_s: float, within_s: Sequence[float] = (0.0,)
) -> tuple[csr_array, csr_array]:
    """Return matrices that interpolate from `times_s` to the times ``wanted_s - offset_s``.

    The interpolation is a cubic through four neighbours (Catmull and Rom, 1974). Its slope is
    continuous, so the derivative with respect to the offset is continuous too. Before the first and
    after the last known time, the nearest known value is used.

    Parameters
    ----------
    times_s
        Known times [s], increasing, shape (n,).
    wanted_s
        Wanted times [s], shape (m,), on a clock that is ahead of the clock of `times_s` by the
        offset.
    offset_s
        The offset [s].
    within_s
        Times relative to a wanted time [s], shape (k,). The values at these times are averaged.

    Returns
    -------
    tuple
        Matrix that yields the interpolated values, and matrix that yields their derivatives with
        respect to `offset_s` [1/s], both of shape (m, n).
    """
    last = len(times_s) - 1
    asked = (np.asarray(wanted_s)[:, None] + np.asarray(within_s)).ravel() - offset_s
    inside = (asked > times_s[0]) & (asked < times_s[-1])
    asked = np.clip(asked, times_s[0], times_s[-1])
    left = np.clip(np.searchsorted(times_s, asked, side="right") - 1, 0, last - 1)
    places = np.clip(left[:, None] + np.arange(-1, 3), 0, last)
    before, start, end, after = times_s[places].T
    width = end - start
    u = (asked - start) / width
    slopes = np.stack([width / (end - before), width / (after - start)])
    # Hermite's cubic: values at both ends, and slopes by the neighbours of each end
    blend = u * u * (3.0 - 2.0 * u)
    weights = _hermite(1.0 - blend, blend, slopes * [u * (1.0 - u) ** 2, u * u * (u - 1.0)])
    # the derivative of the same cubic by u
    blend = 6.0 * u * (1.0 - u)
    tangents = [(1.0 - u) * (1.0 - 3.0 * u), u * (3.0 * u - 2.0)]
    rates = _hermite(-blend, blend, slopes * tangents)
    rates *= np.where(inside, -1.0 / width, 0.0)[:, None]
    # each of the times of a mean has four neighbours
    each = 4 * len(within_s)
    starts = np.arange(0, weights.size + 1, each)
    shape = (len(wanted_s), last + 1)
    values, derivatives = (
        csr_array((found.ravel() / len(within_s), places.ravel(), starts), shape=shape)
        for found in (weights, rates)
    )
    return values, derivatives


def _hermite(at_start: Array, at_end: Array, tangents: Array) -> Array:
    """Return the weights of the four neighbours in a cubic's Hermite form, shape (m, 4)."""
    start, end = tangents
    return np.stack([-start, at_start - end, at_end + start, end], axis=1)
