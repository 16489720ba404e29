"""Runs of the engine in the published set-ups."""

from dataclasses import dataclass
from functools import cache

import drilling
import numpy as np
from published import DataSet, Row

import tissue
from meshes.base.arrays import Array
from tissue.fitting.bands.sample import normals
from tissue.fitting.bands.sample_loads import LOADS, Reweighed
from tissue.scene.scene import Scene
from tissue.simulation.load_record import record_loads

__all__ = ["SteadyHole", "drill_bands", "drill_run", "molar_figures", "reamed_error_mm"]

POINT_ANGLE_DEG = 118.0
BELOW_MM = 1.0
"""Depth of the steady part of a hole, from full engagement of the point on."""
REAMER_RPM = 5000.0
BAND_SAMPLES = 256


def drill_scene(data: DataSet, row: Row) -> Scene:
    """Return the scene of a row's hole in a block of the set's density."""
    assert data.diameter_mm is not None
    diameter = data.diameter_mm
    depth = _point_mm(data) + BELOW_MM
    feed_mm_s = _feed_mm_min(data, row) / 60.0
    changes = {
        "anatomy.size_mm": [diameter + 2.0, diameter + 2.0, depth + 1.0],
        "anatomy.density_kg_m3": data.unknown["density_kg_m3"].value,
        "voxels.spacing_mm": 0.1,
        "tool.kind": "twist-drill",
        "tool.diameter_mm": diameter,
        "tool.length_mm": 20.0,
        "tool.flutes": 2,
        "tool.spin_rpm": row.rpm,
        "tool.shell_spacing_mm": None,
        "motion.points_mm": [[0.0, 0.0, 0.05], [0.0, 0.0, -depth]],
        "motion.feed_mm_s": feed_mm_s,
        "duration_s": (depth + 0.05) / feed_mm_s,
    }
    return tissue.load_scene("milling", changes)


def _point_mm(data: DataSet) -> float:
    """Return the height of the drill's point [mm], an upper bound."""
    assert data.diameter_mm is not None
    return float(0.5 * data.diameter_mm / np.tan(np.radians(0.5 * POINT_ANGLE_DEG)))


def _feed_mm_min(data: DataSet, row: Row) -> float:
    return data.unknown["feed_mm_min"].value if row.feed_mm_min is None else row.feed_mm_min


def _steady(data: DataSet, height_mm: Array) -> Array:
    """Return which ticks belong to the steady part of a hole."""
    point = _point_mm(data)
    return (height_mm < -point - 0.1) & (height_mm > -point - BELOW_MM + 0.05)


@dataclass(frozen=True)
class SteadyHole:
    """Means over the steady part of a hole, and the thrust's largest relative deviation there."""

    thrust_N: float
    torque_Nmm: float
    spread: float


def drill_run(data: DataSet, row: Row) -> SteadyHole:
    """Simulate a row's hole and return its steady loads."""
    trace = tissue.simulate(drill_scene(data, row), progress=False).trace
    steady = _steady(data, trace["tool_z_mm"])
    thrust = trace["model_force_z_N"][steady]
    torque = 1e3 * np.abs(trace["model_torque_z_Nm"][steady])
    mean = float(thrust.mean())
    return SteadyHole(mean, float(torque.mean()), float(np.abs(thrust / mean - 1.0).max()))


def drill_bands(data: DataSet, row: Row) -> tuple[Array, Array]:
    """Return thrust [N] and torque [N mm] of samples, by the engine and by the closed form.

    Both have shape (samples, 2). The samples are those of ``tissue run --band``. Density and drill
    have their nominal values.
    """
    record = record_loads(drill_scene(data, row), every=20)
    reweighed = Reweighed(record)
    names = reweighed.ranges.names
    values = reweighed.ranges.x(normals(BAND_SAMPLES, len(names), seed=1))
    steady = _steady(data, record.trace["tool_z_mm"])
    engine = []
    for each in values:
        loads = record.loads(reweighed.coefficients(each))[steady].mean(axis=0)
        engine.append([loads[2], 1e3 * abs(loads[5])])
    short = [name.rpartition(".")[2] for name in names]
    law = drilling.Law(dict(zip(short, values.T, strict=True)))
    loads = drilling.drill_loads(
        law,
        drilling.nominal_point(),
        diameter_mm=np.array([data.diameter_mm]),
        feed_per_turn_mm=np.array([_feed_mm_min(data, row) / (row.rpm or 1.0)]),
        density_kg_m3=np.array([data.unknown["density_kg_m3"].value]),
    )
    return np.array(engine), np.column_stack([loads.thrust_N, loads.torque_Nmm])


@cache
def molar_figures() -> dict[str, tuple[float, float, float]]:
    """Return peak and mean force of the scene ``molar`` [N]: cited, 5 and 95 % quantile."""
    scene = tissue.load_scene("molar", {"voxels.spacing_mm": 0.1, "stress": None})
    reweighed = Reweighed(record_loads(scene, every=10))
    free = normals(BAND_SAMPLES, len(reweighed.ranges.names), seed=1)
    sampled = reweighed.figures(reweighed.ranges.x(free))
    cited = reweighed.figures(reweighed.nominal()[None])[0]
    low, high = np.quantile(sampled, [0.05, 0.95], axis=0)
    places = {
        "peak force": LOADS.index(("force_N", "peak")),
        "mean force": LOADS.index(("force_N", "mean_in_contact")),
    }
    return {name: (cited[at], low[at], high[at]) for name, at in places.items()}


@cache
def reamed_error_mm(law: str) -> float:
    """Return the error of the cavity that a hemispherical reamer leaves in voxels [mm].

    ``reamed diameter``: diameter of the cavity minus that of the reamer, 61 mm. ``reamed sphere``:
    median distance of the surface from a sphere of 40 mm radius.
    """
    is_diameter = law == "reamed diameter"
    diameter = 61.0 if is_diameter else 80.0
    depth = 3.0
    cap = 2.0 * np.sqrt(depth * (diameter - depth))
    bone = tissue.Bone.block((cap + 4.0, cap + 4.0, depth + 2.0), spacing_mm=0.5)
    reamer = tissue.cutters.hemispherical_reamer(
        diameter_mm=diameter, flutes=16, spin_rpm=REAMER_RPM
    )
    bone.cut(reamer, *tissue.feed_along([[0, 0, 0.5], [0, 0, -depth]], feed_mm_s=50.0))
    points = np.asarray(bone.surface().points)
    reach = np.hypot(points[:, 0], points[:, 1])
    cavity = points[(reach < 0.5 * cap - 1.5) & (np.abs(points[:, 2] + 0.5 * depth) < depth)]
    cavity = cavity[cavity[:, 2] < -0.2]
    centre = np.array([0.0, 0.0, 0.5 * diameter - depth])
    distance = np.linalg.norm(cavity - centre, axis=1) - 0.5 * diameter
    return float(2.0 * distance.mean() if is_diameter else np.median(np.abs(distance)))
