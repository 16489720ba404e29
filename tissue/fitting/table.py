"""Tables of steady drill loads by feed and speed, and the log density that a fit maximises."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array, eye_array

from meshes.base.arrays import Array
from meshes.base.errors import InputError, enumerated
from meshes.base.units import column_of
from tissue.fitting.cutting import CuttingForward, forward_of
from tissue.fitting.log_columns import parsed, quantities, the_columns
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

FEEDS = ("feed_mm_s", "feed_mm_per_turn")
SPIN = "spin_rpm"
CHANNELS = {"thrust_N": "force_z_N", "torque_Nm": "torque_z_Nm"}
"""Simulated channel that corresponds to each column of measured loads."""
SCATTERS = {"thrust_N": "thrust_pm_N", "torque_Nm": "torque_pm_Nm"}
"""Column with the scatter (one standard deviation) of each load."""
MEASURES = {
    **dict(zip(FEEDS, ("speed", "length"), strict=True)),
    SPIN: "number",
    **dict.fromkeys(("thrust_N", "thrust_pm_N"), "force"),
    **dict.fromkeys(("torque_Nm", "torque_pm_Nm"), "torque"),
}
"""Kind of quantity in each column, as a key of `meshes.base.units.UNITS`."""
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
        File of the table.
    feeds_per_turn_m
        Feed per turn of each row [m], shape (n,).
    loads
        Measured loads, shape (n, channels): thrust [N], torque [N m], or both.
    scatter
        Standard deviation of each load, shape (n, channels). None if the table gives no standard
        deviations.
    channels
        Channels of the simulation that correspond to the loads.
    notes
        Findings and assumptions, in sentences.
    """

    path: Path
    feeds_per_turn_m: Array
    loads: Array
    scatter: Array | None
    channels: tuple[str, ...]
    notes: tuple[str, ...] = ()

    @property
    def units(self) -> Array:
        """Divisors of the loads in a fit, shape (n, channels).

        The divisor is the scatter of the load. If the table gives no scatter, the divisor is the
        mean load of the channel over the rows.
        """
        if self.scatter is not None:
            return self.scatter
        return np.broadcast_to(self.loads.mean(axis=0), self.loads.shape)


def is_table(names: Sequence[str]) -> bool:
    """Return True if columns are those of a table of loads: a feed or a load, but no times.

    A file with a column ``time_s`` is a log.
    """
    named = (*FEEDS, *CHANNELS)
    return "time_s" not in names and any(column_of(each, MEASURES[each], names) for each in named)


def read_table(path: Path, found: LogColumns, columns: Sequence[str] = ()) -> SteadyTable:
    """Read a table of steady loads from the columns of a file.

    Parameters
    ----------
    path
        Path of the file, used in error messages.
    found
        Columns of the file. The feed is in the column ``feed_mm_per_turn``, or in ``feed_mm_min``
        or ``feed_mm_s`` together with ``spin_rpm``. The loads are in the columns ``thrust_N`` and
        ``torque_Nmm`` or ``torque_Nm``; one load is enough. The standard deviation of a load is in
        a column such as ``thrust_pm_N``.
    columns
        ``NAME=COLUMN`` or ``NAME=COLUMN:UNIT`` for a quantity whose column has another name or
        unit.

    Raises
    ------
    InputError
        If a column is missing or unknown, or a value in a column is not above zero.
    """
    refuse = partial(refusal, path)
    notes = [*found.notes]
    values, unused = quantities(found, parsed(columns, tuple(MEASURES)), MEASURES, notes)
    if unused:
        raise refuse(
            f"have only the columns {enumerated(MEASURES)}, in any unit",
            the_columns(unused[:12]),
            "rename or remove these columns",
        )
    feeds = [name for name in FEEDS if name in values]
    if len(feeds) != 1:
        raise refuse(
            f"have exactly one column of {enumerated(FEEDS)}",
            enumerated(feeds) or "none",
            "give the feed in one column",
        )
    if feeds[0] == FEEDS[0] and SPIN not in values:
        raise refuse(
            f"have the column {SPIN} with the column {feeds[0]}",
            "none",
            f"add {SPIN}, or use the column {FEEDS[1]}",
        )
    loads = [name for name in CHANNELS if name in values]
    scatters = [name for name in SCATTERS.values() if name in values]
    if not loads or scatters not in ([], [SCATTERS[name] for name in loads]):
        raise refuse(
            "have the column thrust_N or torque_Nm, and a scatter for every load or for no load",
            the_columns(found.names),
            f"add the missing column, or remove {enumerated(SCATTERS.values())}",
        )
    for name, each in values.items():
        wrong = np.flatnonzero(~(np.isfinite(each) & (each > 0.0)))
        if len(wrong):
            value = f"another value in row {wrong[0] + 1}"
            raise refuse(f"have numbers above 0 in {name}", value, "correct or remove that row")
    feed_m = values[feeds[0]]
    if len(feed_m) < FEWEST_ROWS:
        raise refuse(
            f"have {FEWEST_ROWS} rows or more", "1 row", "add rows of other feeds or speeds"
        )
    if feeds[0] == FEEDS[0]:
        feed_m = 60.0 * feed_m / values[SPIN]
    return SteadyTable(
        path,
        feed_m,
        np.column_stack([values[name] for name in loads]),
        np.column_stack([values[name] for name in scatters]) if scatters else None,
        tuple(CHANNELS[name] for name in loads),
        tuple(notes),
    )


def table_forward(scene: Scene, table: SteadyTable, free: Sequence[str] = ()) -> CuttingForward:
    """Return the forward model of the loads in a table.

    The modelled loads are divided by `SteadyTable.units`. Each row is treated like one tick of a
    recorded run.

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
            "be block (bone of one density) for a table of steady loads",
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
            f"have feeds per tooth below the drill's radius of {tool.diameter_mm / 2.0:g} mm",
            f"{1e3 * thickest_m:.3g} mm",
            "give the unit of the feed in the name of its column, such as feed_mm_min",
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
    """Log density of constants given a table whose rows have independent normal errors.

    The standard deviation of an error is the scatter given in the table. If the table gives no
    scatter, the standard deviation of each channel is a free parameter. The clock offset, the
    biases, and the correlation and tails of the noise have no effect. They stay at the medians of
    their priors.
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
