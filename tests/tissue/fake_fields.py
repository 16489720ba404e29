"""A run of bone in layers that tells of itself what a tooth would: measures and fields over time."""

from dataclasses import replace

import numpy as np

from tissue.fields import FieldSeries, Frame
from tissue.run import Run
from tissue.trace import Table

CORNERS = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
"""Corners of a hexahedron in VTK's order."""


def block_series(low_m, high_m, count, layer_names=("bone",), times_s=(0.0, 0.1, 0.25)):
    """A block of hexahedra whose von Mises stress is x + 10 t, in MPa for x in mm; one more cell goes every frame."""
    axes = [np.linspace(a, b, n + 1) for a, b, n in zip(low_m, high_m, count, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape(np.array(count) + 1)
    cells = np.stack(
        [number[tuple(slice(s, s + n) for s, n in zip(at, count, strict=True))].ravel() for at in CORNERS], axis=1
    )
    centre = 1e3 * nodes[cells].mean(axis=1)
    layer = (np.arange(len(cells)) % len(layer_names)).astype(np.uint8)
    series = FieldSeries(nodes, cells, layer, tuple(layer_names))
    for index, time in enumerate(times_s):
        stress = (np.abs(centre[:, 0]) + 10.0 * time).astype(np.float32)
        stress[:index] = np.nan
        moved = (1e3 * nodes * time).astype(np.float32)
        series.frames.append(
            Frame(time, {"displacement_um": moved}, {"von_mises_MPa": stress, "principal_1_MPa": -stress})
        )
    return series


class Told:
    """A tissue with measures and fields of its own."""

    measure_names = ("dentin_over_pulp_mm", "tooth_x_um", "tooth_y_um")

    def __init__(self, tissue, fields):
        self._tissue, self.fields = tissue, fields

    def __getattr__(self, name):
        return getattr(self._tissue, name)


def told(run, *, fields=True):
    """The run as if its tissue had measures, and fields over the whole of its voxels."""
    trace, volume = run.trace, run.parts.volume
    columns = (*trace.columns[:-1], *Told.measure_names, trace.columns[-1])
    own = np.linspace(3.0, 1.0, len(trace.rows))[:, None] * (1.0, 0.5, -0.5)
    table = Table(columns, np.hstack([trace.rows[:, :-1], own, trace.rows[:, -1:]]), trace.layer_names)
    series = block_series(*volume.bounds_m, (8, 8, 6), volume.layer_names) if fields else None
    parts = replace(run.parts, tissue=Told(run.parts.tissue, series))
    events = [(0.1, "something gives way"), (0.11, "something else does"), (0.3, "all is gone")]
    return Run(run.scene, parts, table, run.timing, events=events, compute="cpu", folder=None)
