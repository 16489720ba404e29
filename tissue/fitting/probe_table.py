"""Tables of probe force against depth, without times, from several presses of one tissue."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.units import name_of
from tissue.fitting.log_columns import TIMES, column_for, parsed, quantities, the_columns
from tissue.fitting.log_files import LogColumns, refusal

DEPTH = "depth_mm"
FORCE = "force_N"
PROBE = "probe"
MEASURES = {DEPTH: "length", FORCE: "force", PROBE: "number"}
"""Kind of quantity in each column, as a key of `meshes.base.units.UNITS`."""
FEWEST_PROBES = 3
"""Smallest number of presses. The intervals follow from the scatter between presses."""
FEWEST_STEPS = 4
"""Smallest number of depths of a press: one more than modulus, shape and bias."""
Press = tuple[Array, Array]
"""Increasing depths [m] and the forces [N] of one press."""
SHORT = 0.9
"""Largest depth of a press, relative to the median, below which this press is not used."""


@dataclass(frozen=True, eq=False)
class ProbeTable:
    """Forces of several presses on one tissue, at the same depths.

    Attributes
    ----------
    path
        File from which the table was read.
    depths_m
        Increasing depths [m], shape (d,), measured from the first contact.
    forces_N
        Force of each press at these depths [N], shape (n, d).
    notes
        Findings and assumptions, in sentences.
    """

    path: Path
    depths_m: Array
    forces_N: Array
    notes: tuple[str, ...] = ()


def is_probe_table(names: Sequence[str], columns: Sequence[str]) -> bool:
    """Return True if columns contain a depth but no times, as in a table of presses."""
    asked = {each.partition("=")[0].strip() for each in columns}
    if "time_s" in asked or any(name_of(each, "time") in TIMES for each in names):
        return False
    return DEPTH in asked or column_for(DEPTH, "length", names) is not None


def read_presses(
    path: Path, found: LogColumns, columns: Sequence[str] = ()
) -> tuple[list[Press], tuple[str, ...]]:
    """Return the presses in the columns of a file, and notes on them.

    Parameters
    ----------
    path
        Path of the file, used in error messages.
    found
        Columns of the file: ``depth_mm``, ``force_N``, and ``probe``, which numbers the presses.
        Without ``probe``, a new press begins where the depth decreases.
    columns
        ``NAME=COLUMN`` or ``NAME=COLUMN:UNIT`` for a quantity whose column has another name or
        unit.

    Raises
    ------
    InputError
        If a column is missing.
    """
    notes = [*found.notes]
    values, _ = quantities(found, parsed(columns, tuple(MEASURES)), MEASURES, notes)
    for name in (DEPTH, FORCE):
        if name not in values:
            raise refusal(
                path,
                f"have the column {name}",
                the_columns(found.names[:12]),
                f"name the column by --column {name}=COLUMN[:UNIT]",
            )
    depths = values[DEPTH]
    forces = values[FORCE]
    if PROBE in values:
        starts = np.flatnonzero(np.diff(values[PROBE], prepend=np.nan) != 0.0)
    else:
        starts = np.flatnonzero(np.diff(depths, prepend=np.inf) < 0.0)
    presses: list[Press] = []
    for rows in np.split(np.arange(len(depths)), starts[1:]):
        known = rows[np.isfinite(depths[rows]) & np.isfinite(forces[rows])]
        order = known[np.argsort(depths[known], kind="stable")]
        depth, first = np.unique(depths[order], return_index=True)
        presses.append((depth, forces[order][first]))
    return presses, tuple(notes)


def at_common_depths(path: Path, presses: list[Press], notes: tuple[str, ...]) -> ProbeTable:
    """Interpolate all presses to the same depths, the medians of the measured depths.

    Raises
    ------
    InputError
        If a press has too few depths, or there are too few presses.
    """
    if not presses:
        raise refusal(path, "contain presses", "none", "add rows")
    largest = np.array([depth[-1] if len(depth) else 0.0 for depth, _ in presses])
    enough = np.array([len(depth) >= FEWEST_STEPS for depth, _ in presses])
    used = enough & (largest >= SHORT * np.median(largest))
    if used.sum() < FEWEST_PROBES:
        raise refusal(
            path,
            f"contain at least {FEWEST_PROBES} complete presses",
            f"{used.sum()}",
            (
                "repeat the press at several places. A complete press has at least "
                f"{FEWEST_STEPS} depths, and its largest depth is at least {SHORT:.0%} of the "
                "median of all largest depths"
            ),
        )
    if not used.all():
        notes = (*notes, f"{(~used).sum()} of {len(used)} presses are short and left out")
    kept = [press for press, keep in zip(presses, used, strict=True) if keep]
    steps = int(np.median([len(depth) for depth, _ in kept]))
    share = np.linspace(0.0, 1.0, steps)
    # The medians at equal shares of the steps lie close to the measured depths of every press.
    places = [np.interp(share, np.linspace(0.0, 1.0, len(depth)), depth) for depth, _ in kept]
    common = np.median(places, axis=0)
    common = np.clip(
        common, max(depth[0] for depth, _ in kept), min(depth[-1] for depth, _ in kept)
    )
    common = np.unique(common)
    if not common[-1] > 0.0 or len(common) < FEWEST_STEPS:
        raise InputError(
            "measured",
            "contain presses whose depths overlap",
            f"presses without common depths in {path.name}",
            "check the zero of the depths",
        )
    forces = np.stack([PchipInterpolator(depth, force)(common) for depth, force in kept])
    return ProbeTable(path, common, forces, notes)
