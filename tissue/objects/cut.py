"""Result of a cut through bone: force, torque and removed volume at each pose."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.hints import suggests_arguments
from tissue.models.tissue_model import TICK_S
from tissue.objects.trace import Trace
from tissue.simulation.loop import Loop
from tissue.simulation.trace import Table, TraceLayout, write_table

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

__all__ = ["Cut", "saved_table"]


@suggests_arguments
class Cut:
    """Force, torque and removed volume at every pose of a cut.

    The forces act on the tool. The torques are about the tip of the tool.

    Attributes
    ----------
    trace
        All columns, keyed by name, with one row per pose: ``cut.trace["force_z_N"]``.
    notes
        Notes on findings, keyed by subject.
    pose_us
        Computing time of each pose [µs], shape (n,).
    events
        Events, each with a time [s] and a sentence. An example is an overlap of the tool with a
        structure to keep clear of.
    """

    def __init__(
        self, trace: Table, pose_us: Array, events: Sequence[tuple[float, str]] = ()
    ) -> None:
        self.trace = Trace(trace)
        self.pose_us = pose_us
        self.events = list(events)
        self.notes: dict[str, str] = {}
        start_mm3 = float(self.trace["removed_mm3"][0])
        if start_mm3 > 0.0:
            self.notes["start"] = (
                f"the first pose lies inside bone: {start_mm3:.3g} mm3 were removed "
                "there without a force; if this is not intended, check the axis, the "
                "unit and the frame of the poses"
            )

    @classmethod
    def of(cls, loop: Loop, times_s: Array, *, removed_before_m3: Array) -> "Cut":
        """Return the result of a loop that has run through given poses at given times [s].

        The volume that was removed before the loop is not included.
        """
        layout = TraceLayout.of(loop.parts.tissue.layer_names)
        names = [name for name in loop.trace.columns if not name.startswith("model_")]
        places = [loop.trace.columns.index(name) for name in names]
        rows = loop.trace.rows.copy()
        rows[:, layout.time] = times_s
        # The removal of a slow cut is spread over several ticks, so the last row takes the final
        # volume.
        rows[-1, layout.removed_by_layer] = 1e9 * loop.parts.tissue.removed_m3
        rows[:, layout.removed_by_layer] -= 1e9 * removed_before_m3
        rows[:, layout.removed] = rows[:, layout.removed_by_layer].sum(axis=1)
        trace = Table(tuple(names), rows[:, places], loop.trace.layer_names)
        last = len(times_s) - 1
        events = [
            (float(times_s[min(round(at_s / TICK_S), last)]), what) for at_s, what in loop.events
        ]
        return cls(trace, np.asarray(loop.timing["tick_us"]), events)

    def __len__(self) -> int:
        return len(self.trace.rows)

    @property
    def times_s(self) -> Array:
        """Times of the poses [s], shape (n,)."""
        return np.asarray(self.trace["time_s"])

    @property
    def tip_mm(self) -> Array:
        """Tips of the tool [mm], shape (n, 3)."""
        return self.trace.vectors("tool", "mm")

    @property
    def force_N(self) -> Array:
        """Force on the tool [N], shape (n, 3).

        The force is 0 at the first pose, where the tool is at rest.
        """
        return self.trace.vectors("force", "N")

    @property
    def force_magnitude_N(self) -> Array:
        """Magnitude of the force [N], shape (n,)."""
        return np.linalg.norm(self.force_N, axis=1)

    @property
    def torque_Nm(self) -> Array:
        """Torque about the tip [N m], shape (n, 3)."""
        return self.trace.vectors("torque", "Nm")

    @property
    def removed_mm3(self) -> Array:
        """Volume that this cut has removed up to each pose [mm3], shape (n,)."""
        return np.asarray(self.trace["removed_mm3"])

    def distance_mm(self, name: str) -> Array:
        """Return the distance [mm], shape (n,), of the tool from a structure to keep clear of.

        The distance is negative where tool and structure overlap.

        Raises
        ------
        InputError
            If no structure of this name was given.
        """
        column = f"distance_{name}_mm"
        if column not in self.trace.columns:
            raise InputError(
                "name",
                "be a structure given as keep_clear",
                name,
                "give this structure to Bone.cut",
            )
        return np.asarray(self.trace[column])

    @property
    def layer(self) -> NDArray[np.str_]:
        """Name of the layer in which the largest area of the tool is engaged at each pose.

        The names have shape (n,). The name is "none" without contact.
        """
        return np.asarray(self.trace["layer"])

    def to_pandas(self) -> "pandas.DataFrame":
        """Return all columns as a table, one row per pose.

        See `tissue.objects.trace.Trace.to_pandas`.
        """
        return self.trace.to_pandas()

    def to_xarray(self) -> "xarray.Dataset":
        """Return all columns over time; see `tissue.objects.trace.Trace.to_xarray`."""
        return self.trace.to_xarray()

    def save(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write all columns to a file in the format of its suffix.

        The suffixes are .csv, .mat (MATLAB), .npz, .parquet and .h5.

        Raises
        ------
        InputError
            If the suffix is unknown, the package that writes the format is not installed, or the
            file exists and `overwrite` is not set.
        """
        return saved_table(self.trace, path, overwrite=overwrite)

    def plot(self, *, over: "Figure | None" = None, label: str | None = None) -> "Figure":
        """Draw force and torque over time, each in a panel of its own.

        Without a label the panels show the components and the magnitude. With a label they show
        only the magnitude.

        Parameters
        ----------
        over
            Figure of an earlier plot into which this cut is drawn: ``b.plot(over=a.plot(label="a"),
            label="b")``.
        label
            Name of this cut in the legend.
        """
        from tissue.objects.plots import new_panels
        from tissue.show.figures.figure import COMPONENTS

        panels = new_panels(2) if over is None else over.axes
        shown = (self.force_N, "force / N"), (self.torque_Nm, "torque / N m")
        for panel, (values, what) in zip(panels, shown, strict=True):
            if label is None:
                for axis, column, colour in zip("xyz", values.T, COMPONENTS, strict=True):
                    panel.plot(self.times_s, column, color=colour, linewidth=1.0, label=axis)
            look = {"color": "0.2", "label": "size"} if label is None else {"label": label}
            panel.plot(self.times_s, np.linalg.norm(values, axis=1), linewidth=1.0, **look)
            panel.set_ylabel(what)
        panels[0].legend(ncols=4, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0))
        panels[-1].set_xlabel("time / s")
        chart: Any = panels[0].figure
        return chart

    def __repr__(self) -> str:
        force = self.force_magnitude_N
        return (
            f"Cut({len(self)} poses in {self.times_s[-1] - self.times_s[0]:.4g} s, "
            f"{self.removed_mm3[-1]:.4g} mm3 "
            f"removed, peak force {force.max():.3g} N, {np.median(self.pose_us):.0f} us a pose"
            f"{''.join(f'; {note}' for note in self.notes.values())})"
        )


def saved_table(trace: Table, path: str | Path, *, overwrite: bool) -> Path:
    """Write columns to a file in the format of its suffix, and return its path.

    Raises
    ------
    InputError
        If the suffix is unknown, the package that writes the format is not installed, or the file
        exists and `overwrite` is not set.
    """
    path = Path(path)
    if path.exists() and not overwrite:
        raise InputError("path", "not exist", path, "choose another path, or pass overwrite=True")
    write_table(trace, path)
    return path
