"""Tables of steady loads on a drill, by feed and speed, and their log density for a fit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array, eye_array

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fitting.cutting import CuttingForward, forward_of
from tissue.fitting.log_files import LogColumns, refusal
from tissue.fitting.problem import MeasuredLoads
from tissue.fitting.target import Target, Unpacked
from tissue.models.bone.engagement import DensityNodes, plunge_unit_loads
from tissue.models.bone.law_limits import THICKEST_M
from tissue.scene.anatomy import BlockAnatomy
from tissue.scene.scene import Scene
from tissue.scene.tool import Tool
from tissue.simulation.builders.cutting import cutter_of
from tissue.simulation.load_record import LayerLoads, LoadRecord
from tissue.simulation.trace import Table

__all__ = ["SteadyTable", "TableTarget", "is_table", "read_table", "table_forward"]


FEEDS = ("feed_mm_min", "feed_mm_s", "feed_mm_per_turn")
SPIN = "spin_rpm"
LOADS = {
    "thrust_N": ("force_z_N", 1.0),
    "torque_Nm": ("torque_z_Nm", 1.0),
    "torque_Nmm": ("torque_z_Nm", 1e-3),
}
"""Channel of the simulation and factor to SI units, for each column of loads in a table."""
SCATTERS = {name: name.replace("_", "_pm_") for name in LOADS}
"""Columns of the scatter of each load: one standard deviation."""
COLUMNS = (*FEEDS, SPIN, *LOADS, *SCATTERS.values())
FEWEST_ROWS = 2
DRILL = "twist-drill"
LAYER = "bone"
"""Name of the only layer of a block of bone."""
NORMAL = 1e6
"""Degrees of freedom for which Student's distribution is practically normal."""


@dataclass(frozen=True, eq=False)
class SteadyTable:
    """Steady loads on a drill that is pushed along its axis into bone.

    Attributes
    ----------
    path
        File.
    feeds_per_turn_m
        Feed per turn of each row [m], shape (n,).
    loads
        Thrust [N] and torque [N m], as far as they were measured, shape (n, channels).
    scatter
        Standard deviation of each load, shape (n, channels). None if the table has no scatter.
    names, channels
        Names of the loads in the table, and names of the corresponding channels of the simulation.
    notes
        Findings and assumptions, in sentences.
    """

    path: Path
    feeds_per_turn_m: Array
    loads: Array
    scatter: Array | None
    names: tuple[str, ...]
    channels: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def units(self) -> Array:
        """Divisors of the loads, shape (n, channels).

        The divisor is the scatter of the load. Without a scatter, it is the mean of the load over
        the rows.
        """
        if self.scatter is not None:
            return self.scatter
        return np.broadcast_to(self.loads.mean(axis=0), self.loads.shape)


def is_table(names: Sequence[str]) -> bool:
    """Return whether columns belong to a table of steady loads: a feed or a thrust, but no times.

    A file with a column ``time_s`` is a log.
    """
    return "time_s" not in names and bool({*FEEDS, *LOADS} & set(names))


def read_table(path: Path, found: LogColumns) -> SteadyTable:
    """Read a table of steady loads from the columns of a file.

    Parameters
    ----------
    path
        The file, for messages.
    found
        Columns of the file. The column of the feed is ``feed_mm_min`` or ``feed_mm_s``, each with
        ``spin_rpm``, or ``feed_mm_per_turn``. The columns of the loads are ``thrust_N``, and
        ``torque_Nmm`` or ``torque_Nm``; at least one of them is needed. The standard deviation of
        a load is in a column such as ``thrust_pm_N``.

    Raises
    ------
    InputError
        If a column is missing or unknown, or a number is not above zero.
    """
    refuse = partial(refusal, path)
    if unknown := [name for name in found.names if name not in COLUMNS]:
        raise refuse(
            f"hold columns named {', '.join(COLUMNS)}",
            ", ".join(unknown[:12]),
            "rename these columns or leave them out",
        )
    feeds = [name for name in FEEDS if name in found.names]
    if len(feeds) != 1:
        raise refuse(
            f"hold one column of {', '.join(FEEDS)}",
            " and ".join(feeds) or "none",
            "state the feed once",
        )
    if feeds[0] != FEEDS[2] and SPIN not in found.names:
        raise refuse(f"hold {SPIN} with {feeds[0]}", "none", f"add {SPIN}, or give {FEEDS[2]}")
    names = tuple(name for name in LOADS if name in found.names)
    channels = tuple(LOADS[name][0] for name in names)
    if not names or len(set(channels)) < len(channels):
        raise refuse(
            "hold thrust_N, or torque_Nmm or torque_Nm, or a thrust and a torque",
            " and ".join(names) or "neither",
            "state each load once",
        )
    scattered = tuple(load for load, name in SCATTERS.items() if name in found.names)
    if scattered and scattered != names:
        raise refuse(
            "hold the scatter of each load in the unit of the load, or no scatter",
            ", ".join(SCATTERS[load] for load in scattered),
            f"give {' and '.join(SCATTERS[load] for load in names)}",
        )

    def positive(name: str) -> Array:
        """Return a column whose numbers must be positive."""
        values = found.numbers(name)
        wrong = np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))
        if len(wrong):
            value = f"{values[wrong[0]]:g} in row {wrong[0] + 1}"
            raise refuse(f"hold numbers above 0 as {name}", value, "correct or remove that row")
        return values

    columns = {name: positive(name) for name in found.names}
    feeds_mm = columns[feeds[0]]
    if len(feeds_mm) < FEWEST_ROWS:
        raise refuse(
            f"hold {FEWEST_ROWS} rows or more", "1 row", "add rows of other feeds or speeds"
        )
    if feeds[0] == "feed_mm_min":
        feeds_mm = feeds_mm / columns[SPIN]
    elif feeds[0] == "feed_mm_s":
        feeds_mm = 60.0 * feeds_mm / columns[SPIN]
    factors = np.array([LOADS[name][1] for name in names])
    scatter = None
    if scattered:
        scatter = factors * np.column_stack([columns[SCATTERS[name]] for name in names])
    return SteadyTable(
        path,
        1e-3 * feeds_mm,
        factors * np.column_stack([columns[name] for name in names]),
        scatter,
        names,
        channels,
        found.notes,
    )


def table_forward(scene: Scene, table: SteadyTable, free: Sequence[str] = ()) -> CuttingForward:
    """Return the function for the loads of a table's rows, divided by `SteadyTable.units`.

    Each row is handled like a recorded tick.

    Parameters
    ----------
    scene
        Scene with a block of bone and a drill. Motion, device and spin of the scene are ignored.
    table
        Measured loads.
    free
        Free constants, see `tissue.fitting.cutting.cutting_forward`.

    Raises
    ------
    InputError
        If the scene has no block of bone or no drill, the chips are thicker than the drill, or
        `free` names an unknown constant.
    """
    tool = scene.tool
    if not isinstance(tool, Tool) or tool.kind != DRILL:
        raise InputError(
            "tool.kind",
            f"be {DRILL} for a table of steady loads",
            tool.kind,
            f"use --set tool.kind={DRILL} with the drill's sizes",
        )
    if not isinstance(scene.anatomy, BlockAnatomy):
        raise InputError(
            "anatomy.kind",
            "be block, a block of bone of one density, for a table of steady loads",
            scene.anatomy.kind,
            "use a scene such as milling",
        )
    # Spin and length have no effect on steady loads at a feed per turn. A short drill has few
    # elements besides those of its point.
    length_mm = 2.0 * tool.diameter_mm
    cutter = cutter_of(tool.model_copy(update={"spin_rpm": 1000.0, "length_mm": length_mm}))
    thickest_m = float(table.feeds_per_turn_m.max()) / cutter.flute_count
    if thickest_m > cutter.profile.radius_m:
        raise refusal(
            table.path,
            f"hold feeds below the drill's radius per tooth ({tool.diameter_mm / 2.0:g} mm)",
            f"{1e3 * thickest_m:.3g} mm",
            f"give the unit of the feed by the name of its column, one of {', '.join(FEEDS)}",
        )
    notes = table.notes
    if thickest_m > THICKEST_M:
        notes += (
            f"the largest feed is {1e3 * thickest_m:.2g} mm per tooth, but the cutting law holds "
            f"up to {1e3 * THICKEST_M:g} mm",
        )
    chips_m, unit = plunge_unit_loads(cutter, table.feeds_per_turn_m)
    places = [at for at, name in enumerate(CuttingForward.channels) if name in table.channels]
    unit[..., places] /= table.units
    density = round(scene.anatomy.density_kg_m3)
    rows = np.arange(len(table.feeds_per_turn_m), dtype=np.float64)
    record = LoadRecord(
        scene=scene,
        times_s=rows,
        layer_names=(LAYER,),
        layers={0: LayerLoads(DensityNodes.of(density, density), chips_m, unit)},
        engaged_m2=np.full((len(rows), 1), cutter.cutting_area_m2),
        trace=Table((), np.zeros((len(rows), 0))),
        notes={},
    )
    return replace(forward_of(scene, record, free), notes=notes)


class TableTarget(Target):
    """Log density of constants given a table: independent normal errors of its rows.

    The standard deviation is the scatter. Without a scatter, it is a free number for each load. The
    clock offset, the biases, and the correlation and tails of the noise have no effect, so they
    stay at the medians of their priors.
    """

    def __init__(self, forward: CuttingForward, table: SteadyTable) -> None:
        measured = MeasuredLoads(forward.times_s, table.loads / table.units, table.channels)
        super().__init__(forward, measured)
        self._has_scatter = table.scatter is not None

    def unpacked(self, u: Array) -> Unpacked:
        """See `Target`."""
        each = super().unpacked(u)
        still = np.zeros(len(self.log.channels))
        return replace(
            each,
            offset_s=0.0,
            bias=still,
            scale=still + 1.0 if self._has_scatter else each.scale,
            correlation=still,
            freedom=still + NORMAL,
        )

    def linearised(self, u: Array) -> tuple[Array, Array]:
        """See `Target`."""
        simulated, moved = super().linearised(u)
        moved[:, :, self.constants :] = 0.0
        return simulated, moved

    def _shifted(self, offset_s: float) -> tuple[csr_array, csr_array]:
        rows = len(self.forward.times_s)
        return csr_array(eye_array(rows)), csr_array((rows, rows))
