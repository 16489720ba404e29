"""Result of a fit to any kind of measurement."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.laws import LawMisfit
from tissue.fitting.organ_runs import KEYS
from tissue.materials.constants import Prior

NUISANCES = ("density.", KEYS)
"""Name prefixes of fitted numbers that belong to the specimen or to the scene.

Such numbers are not constants of a material.
"""
FAR_SD = 3.0
FAR_TIMES = 10.0
"""Factor above or below the cited range beyond which a value contradicts its prior.

This limit is needed in addition to `FAR_SD`, because some priors have a heavy tail towards zero.
`FAR_SD` is a limit in standard deviations of the prior. By chance, 0.3 % of the constants lie
beyond it.
"""
UNIT_TIMES = 100.0
"""Smallest factor above or below the cited range that suggests a wrong unit.

Units such as N and kN differ by factors of 1000.
"""
UNITS = {"N_mm2": "N/mm²", "N_mm": "N/mm", "kPa": "kPa", "um": "µm", "s": "s"}
"""Usual form of each unit at the end of a constant's name."""


def words_of(name: str) -> tuple[str, str]:
    """Split a constant's name into words and its unit in the usual notation."""
    unit = next((each for each in UNITS if name.endswith(f"_{each}")), "")
    words = name.removesuffix(f"_{unit}").removeprefix("cutting.")
    return words.replace(".", " ").replace("_", " "), UNITS.get(unit, "")


@dataclass(frozen=True)
class ConstantFit:
    """Constant before and after a fit.

    Attributes
    ----------
    name
        ``TABLE.MATERIAL.NAME``, or ``density.LAYER`` for the specimen's factor on the density of a
        layer.
    prior
        Cited median and range.
    low, value, high
        Posterior quantiles at 5, 50 and 95 %, in the unit that the name gives.
    z
        `low`, `value`, `high` and the two ends of the cited range, transformed so that the prior is
        standard normal, shape (5,).
    contraction
        Standard deviation of the constant after the fit, divided by the standard deviation before
        the fit.
    state
        ``determined``, ``narrowed``, ``at its prior``, or ``doubtful``. A value is doubtful if it
        lies far outside its cited range, or if the fitted clock offset contradicts the prior of the
        offset.
    """

    name: str
    prior: Prior
    low: float
    value: float
    high: float
    z: tuple[float, ...]
    contraction: float
    state: str

    @property
    def is_far(self) -> bool:
        """True if the value lies far outside the cited range."""
        is_outside = (
            self.value > FAR_TIMES * self.prior.high > 0.0
            or self.value < self.prior.low / FAR_TIMES
        )
        return abs(self.z[1]) > FAR_SD or is_outside

    @property
    def doubt(self) -> str:
        """Warning about a fitted constant far outside the range of its cited source."""
        is_below = self.z[1] < 0.0
        ratio = self.value / self.prior.high
        if is_below:
            ratio = self.prior.low / max(self.value, 1e-300)
        is_large = np.isfinite(ratio) and ratio >= FAR_TIMES
        side = f"{f'{ratio:.3g} times ' if is_large else ''}{'below' if is_below else 'above'}"
        cause = ""
        if is_large and ratio >= UNIT_TIMES:
            cause = f", as with forces in {'kN' if is_below else 'mN'} that are read in N"
        return (
            f"{self.name} = {self.value:.3g} is {side} its range of {self.prior.low:g} to "
            f"{self.prior.high:g} ({abs(self.z[1]):.1f} standard deviations of the prior) and does "
            f"not count as determined{cause}. Check the units and signs of the log, the scene and "
            "the tool"
        )


class Fitted(ABC):
    """Constants of a scene, fitted to a measurement.

    Attributes
    ----------
    source
        Kind of the measurement in words, such as ``log``.
    meaning
        Explanation of the numbers in the constants file that the fit writes.
    findings
        States (`ConstantFit.state`) of the constants whose intervals the report gives.
    name
        Name of the scene.
    path
        File of the measurement.
    notes
        Findings and assumptions, in sentences.
    fixed
        Values of fixed constants on which the fitted constants depend, keyed by name.
    laws
        Misfits of the cutting laws to a table of steady loads; empty for other measurements.
    """

    source: ClassVar[str] = "log"
    meaning: ClassVar[str] = (
        "value: median; range: 5 and 95 % of the posterior; correlation: of the standard normal "
        "numbers of each."
    )
    findings: ClassVar[tuple[str, ...]] = ("determined",)
    name: str
    path: Path
    notes: tuple[str, ...]
    fixed: Mapping[str, float]
    laws: tuple[LawMisfit, ...] = ()
    constants: tuple[ConstantFit, ...]
    """All fitted constants."""

    @property
    def of_material(self) -> tuple[int, ...]:
        """Indices of the constants that belong to a material, not to the specimen or the scene."""
        return tuple(
            at for at, each in enumerate(self.constants) if not each.name.startswith(NUISANCES)
        )

    @property
    def scene_keys(self) -> dict[str, float]:
        """Fitted values that belong to keys of the scene file, not to a material."""
        return {each.name: each.value for each in self.constants if each.name.startswith(KEYS)}

    @property
    def correlation(self) -> Array:
        """Correlation matrix of the fitted constants that belong to a material."""
        return np.eye(len(self.of_material))

    @property
    @abstractmethod
    def doubts(self) -> tuple[str, ...]:
        """Sentences about results that contradict the priors or the model."""

    @property
    @abstractmethod
    def sentences(self) -> tuple[str, ...]:
        """Sentences that summarise the fit for the user."""

    @property
    def verdicts(self) -> list[str]:
        """Sentences on doubtful results and on the constants that the measurement determines."""
        found = [f"doubtful: {each}" for each in self.doubts]
        for each in self.constants:
            if each.state in self.findings:
                words, unit = words_of(each.name)
                interval = f"{each.value:.3g} ({each.low:.3g} to {each.high:.3g}) {unit}"
                found.append(f"{words}: {interval}".rstrip())
        return found

    @property
    @abstractmethod
    def size(self) -> dict[str, float]:
        """Amount of data, to be written to ``fit.json``."""

    @property
    @abstractmethod
    def numbers(self) -> dict[str, Any]:
        """Further entries of ``fit.json``."""

    @property
    @abstractmethod
    def columns(self) -> dict[str, Array]:
        """Measured and fitted loads, keyed by column name in ``loads.csv``."""

    @abstractmethod
    def draw(self, path: Path) -> None:
        """Draw measured and fitted loads to a picture file."""

    @property
    def tables(self) -> dict[str, list[dict[str, str]]]:
        """Tables of the report, keyed by title. The keys of a row are the column headings."""
        return {}
