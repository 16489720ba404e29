"""Runs whose tissue tells of itself: bone with measures and fields as a tooth has them, and a soft box that is pressed."""

import json
from dataclasses import replace

import numpy as np

from tissue.fem.fields import FieldSeries, Frame
from tissue.simulation.run import Run
from tissue.simulation.series import write_fields
from tissue.simulation.trace import Table, TraceWriter, trace_columns

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
    return Run(run.scene, parts, table, run.timing, events=events, compute="cpu", folder=None, poses=run.poses)


KUHN = ((0, 1, 3, 7), (0, 1, 7, 5), (0, 5, 7, 4), (0, 3, 2, 7), (0, 6, 4, 7), (0, 2, 6, 7))
"""A cube cut into six tetrahedra of positive volume; corner number is x + 2 y + 4 z."""
PRESSED_MM = (40.0, 40.0, 20.0)
"""Edges of the box that is pressed; its upper face is z = 0, its middle x = y = 0."""
YOUNG_PA, POISSON = 10e3, 0.45
PARTS = ("parenchyma", "capsule")


def pressed_series(count=(16, 16, 8), frames=11, *, end_s=1.0, depth_mm=6.0, width_mm=6.0):
    """A box of tetrahedra whose upper face is pressed in, with strain and stress of what moves it.

    It sinks like Boussinesq's half-space (1885) under a point that lies ``width_mm`` above it: by
    ``depth * width / distance``, and less towards the face below, which is held. The topmost cells are the capsule.
    """
    size = np.array(PRESSED_MM) * 1e-3
    axes = [np.linspace(-0.5 * s, 0.5 * s, n + 1) for s, n in zip(size[:2], count[:2], strict=True)]
    axes.append(np.linspace(-size[2], 0.0, count[2] + 1))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(nodes)).reshape(np.array(count) + 1)
    corner = [
        number[tuple(slice(s, s + n) for s, n in zip((c & 1, c >> 1 & 1, c >> 2), count, strict=True))].ravel()
        for c in range(8)
    ]
    cells = np.concatenate([np.stack([corner[c] for c in one], axis=1) for one in KUHN])
    edges = nodes[cells[:, 1:]] - nodes[cells[:, :1]]
    assert (np.linalg.det(edges) > 0.0).all()
    top = nodes[cells][:, :, 2].min(axis=1) > -1.5 * size[2] / count[2]
    series = FieldSeries(nodes, cells, top.astype(np.uint8), PARTS)
    width = 1e-3 * width_mm
    from_axis = np.hypot(nodes[:, 0], nodes[:, 1])
    far = np.sqrt(from_axis**2 + (width - nodes[:, 2]) ** 2)
    shape = np.zeros_like(nodes)
    shape[:, 2] = -(width / far) * (1.0 + nodes[:, 2] / size[2])
    shape[:, :2] = (0.3 * width * -nodes[:, 2] / far**3 * (size[2] + nodes[:, 2]))[:, None] * nodes[:, :2]
    held = np.isclose(nodes[:, 2], -size[2])
    for time in np.linspace(0.0, end_s, frames):
        moved = 1e-3 * depth_at(time, end_s, depth_mm) * shape
        gradient = np.linalg.solve(edges, moved[cells[:, 1:]] - moved[cells[:, :1]])
        strain = 0.5 * (gradient + gradient.swapaxes(1, 2))
        shear = YOUNG_PA / (2.0 * (1.0 + POISSON))
        volume = np.trace(strain, axis1=1, axis2=2)
        stress = 2.0 * shear * (strain + (POISSON / (1.0 - 2.0 * POISSON)) * volume[:, None, None] * np.eye(3))
        deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
        mises = np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
        reaction = np.zeros_like(nodes)
        reaction[held, 2] = -force_at(time, end_s, depth_mm) * far[held] ** -2 / (far[held] ** -2).sum()
        points = {"displacement_mm": 1e3 * moved, "reaction_N": reaction}
        in_cells = {
            "principal_1_kPa": 1e-3 * np.linalg.eigvalsh(stress)[:, -1],
            "von_mises_kPa": 1e-3 * mises,
            "max_principal_strain_percent": 100.0 * np.linalg.eigvalsh(strain)[:, -1],
        }
        single = [{k: v.astype(np.float32) for k, v in one.items()} for one in (points, in_cells)]
        series.frames.append(Frame(float(time), *single))
    return series


def depth_at(time_s, end_s, depth_mm):
    """How far the tool has pressed [mm]: a fifth of the time it only comes near."""
    return depth_mm * np.clip((time_s / end_s - 0.2) / 0.8, 0.0, 1.0)


def force_at(time_s, end_s, depth_mm):
    """Force on the tool [N], as of Hertz (1882)."""
    return 0.2 * depth_at(time_s, end_s, depth_mm) ** 1.5


SCENE = """name = "press"

[anatomy]
kind = "slab"
size_mm = [40.0, 40.0, 20.0]

[tool]
kind = "sphere-probe"
diameter_mm = 10.0

[motion]
kind = "path"
points_mm = [[0.0, 0.0, 4.0], [0.0, 0.0, -6.0]]
feed_mm_s = 10.0
"""


def pressed_run(folder, *, frames=11, end_s=1.0, depth_mm=6.0, status="complete", series=None):
    """Folder of a run that pressed a box of tetrahedra: scene, trace, summary and fields, and no bone."""
    folder.mkdir(parents=True)
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    time = np.linspace(0.0, end_s, round(1e3 * end_s) + 1)
    columns = trace_columns(PARTS)
    rows = np.zeros((len(time), len(columns)))
    at = {name: index for index, name in enumerate(columns)}
    depth, force = depth_at(time, end_s, depth_mm), force_at(time, end_s, depth_mm)
    rows[:, at["time_s"]] = time
    rows[:, at["tool_z_mm"]] = np.where(depth > 0.0, -depth, 4.0 * (1.0 - time / (0.2 * end_s)))
    rows[:, at["tool_qw"]] = 1.0
    for kind in ("force", "model_force"):
        rows[:, at[f"{kind}_z_N"]], rows[:, at[f"{kind}_x_N"]] = force, 0.15 * force
    rows[:, at["force_z_N"]] *= 1.0 + 0.2 * np.where(np.arange(len(time)) % 4 < 2, 1.0, -1.0)
    rows[:, at["contact_mm2"]] = 10.0 * depth
    rows[:, at["layer"]] = np.where(depth > 0.0, 1.0, -1.0)
    writer = TraceWriter(folder / "trace.csv", Table(columns, rows, PARTS))
    writer.flush(len(rows), force=True)
    writer.close()
    peak = float(np.linalg.norm([force, 0.15 * force], axis=0).max())
    summary = {"format": 1, "status": status, "scene": "press", "layers": PARTS, "simulated_s": 1e-3 * len(time)}
    summary |= {"force_N": {"peak": peak, "mean_in_contact": 0.5 * peak}}
    summary |= {"torque_Nm": {"peak": 0.0, "mean_in_contact": 0.0}}
    (folder / "summary.json").write_text(json.dumps(summary), "utf-8")
    if frames:
        write_fields(series or pressed_series(frames=frames, end_s=end_s, depth_mm=depth_mm), folder)
    return folder
