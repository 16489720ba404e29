"""Published measurements: small tables typed in from their sources, one file per data set."""

import tomllib
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from tissue.materials.constants import Prior

__all__ = ["DATA", "DataSet", "Figure", "Row", "Unknown", "data_sets"]

DATA = Path(__file__).with_name("data")
ORDER = (
    "macavelia2012_human",
    "macavelia2012_artificial",
    "pourgiv2024",
    "porcine2014",
    "orelaja2020_bovine",
    "orelaja2020_porcine",
    "orelaja2020_artificial",
    "jbsmse2020",
    "abjs16047",
    "saha1982",
    "wolff2024",
    "dog_jaw",
    "graft_rake",
    "graft_foam",
    "leucite",
    "yoshida2001",
    "karia2023",
    "marksman",
    "james2012",
    "james2013",
    "saw_thesis",
    "crown",
)
"""Data sets in the order of the tables: drilling, other cutting, ligament, geometry, sources."""


@dataclass(frozen=True)
class Row:
    """Measured thrust and torque of a drill at one speed and feed.

    Attributes
    ----------
    rpm, feed_mm_min
        Speed and feed; None if the source does not state them.
    thrust_N, torque_Nmm
        Measured means; None if not measured.
    thrust_scatter_N, torque_scatter_Nmm
        Scatter between specimens, as printed behind "+-".
    half
        ``fit`` for rows to which coefficients are fitted, ``test`` for the other rows.
    """

    half: str
    rpm: float | None = None
    feed_mm_min: float | None = None
    thrust_N: float | None = None
    thrust_scatter_N: float | None = None
    torque_Nmm: float | None = None
    torque_scatter_Nmm: float | None = None


@dataclass(frozen=True)
class Figure:
    """Measured figure other than a force of a drill, such as a ratio.

    ``low`` and ``high`` are the ends of the measured scatter; None without one.
    """

    name: str
    kind: str
    value: float
    low: float | None = None
    high: float | None = None
    depth_um: float | None = None


@dataclass(frozen=True)
class Unknown:
    """Quantity of the set-up that the source does not state, with a plausible range."""

    value: float
    range: tuple[float, float]
    source: str

    @property
    def prior(self) -> Prior:
        """Distribution with the ends of the range as 5 and 95 % quantiles."""
        return Prior(self.value, *self.range)


@dataclass(frozen=True)
class DataSet:
    """Measurements of one publication in one material.

    Attributes
    ----------
    key
        Name of the file without suffix.
    role
        ``test``; ``bounds a range`` if an end of a cited range rests on this set; ``source`` if a
        cited value rests on it, so that agreement is no validation.
    set_up_known
        Whether the source states every quantity of the set-up but the density.
    """

    key: str
    name: str
    species: str
    source: str
    read: str
    set_up: str
    law: str
    role: str
    set_up_known: bool
    role_note: str = ""
    diameter_mm: float | None = None
    specimens: int | None = None
    unknown: dict[str, Unknown] = field(default_factory=dict)
    rows: tuple[Row, ...] = ()
    figures: tuple[Figure, ...] = ()


def read(path: Path) -> DataSet:
    """Read a file of measurements."""
    entries = tomllib.loads(path.read_text("utf-8"))
    unknown = {
        name: Unknown(each["value"], tuple(each["range"]), each["source"])
        for name, each in entries.pop("unknown", {}).items()
    }
    rows = tuple(Row(**each) for each in entries.pop("rows", ()))
    figures = tuple(Figure(**each) for each in entries.pop("figures", ()))
    return DataSet(key=path.stem, unknown=unknown, rows=rows, figures=figures, **entries)


@cache
def data_sets() -> dict[str, DataSet]:
    """Return all data sets by their keys, in the order of the tables."""
    return {key: read(DATA / f"{key}.toml") for key in ORDER}
