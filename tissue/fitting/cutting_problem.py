"""Problem of fitting a log of a cut, and cuts that would narrow its constants further.

The candidates are steady slots and plunges in each layer, at other feeds, speeds and depths. A
steady cut's chip loads grow with feed over spin. Its edge loads depend on neither. Both scale with
density. One record per depth therefore gives all feeds, speeds and layers. Each candidate is one
second of steady loads after a quarter of a second in air, which determines a sensor's bias. The
entry of the tool is left out.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import names_of_caller
from meshes.base.progress import Progress
from tissue.fitting.cutting import CuttingForward, cutting_forward
from tissue.fitting.log import MeasuredLog
from tissue.fitting.measured import block_averages, block_ticks
from tissue.fitting.posterior import Problem
from tissue.fitting.signs import require_signs
from tissue.models.bone.engagement import DensityNodes
from tissue.models.tissue_model import TICK_S
from tissue.motion.motion import FollowPath
from tissue.scene.anatomy import BlockAnatomy
from tissue.scene.scene import Cutting, Scene, Voxels
from tissue.scene.tool import Tool
from tissue.simulation.load_record import LayerLoads, record_loads

__all__ = ["cutting_candidates", "cutting_problem"]

REFERENCE = "reference_density_kg_m3"
"""Key of the reference density of coefficients."""
FEEDS = (0.25, 1.0, 4.0)
SPINS = (0.5, 1.0, 2.0)
DEPTHS = (0.25, 0.5, 1.0)
"""Times the log's feed, the tool's spin, and its radius."""
UP = (0.0, 0.0, 1.0)
TICKS = 60
STEADY = slice(30, 60)
"""Ticks of a record whose mean is the steady load.

The tool starts in the cavity that it fills and has left it before these ticks. `TICKS` is the
length of a record.
"""
TRAVEL = {"slot": 1.0, "plunge": 0.1}
"""Travel of the tool in a record, in radii. A plunge is short enough to have one depth."""
VOXELS = 20
"""Voxels on a radius."""
AIR = 250
LASTS = 1250
"""Ticks in air, and all ticks of a candidate."""


def cutting_problem(
    scene: Scene, log: MeasuredLog, free: Sequence[str], *, cores: int | None, progress: Progress
) -> Problem:
    """Return the problem of a cut through bone or a tooth, see `tissue.fitting.fit.fit_scene`."""
    progress("recording the geometry of the log", 0.0)
    with names_of_caller({"motion": "measured"}):
        forward = cutting_forward(
            scene,
            log.times_s,
            log.tips_m,
            log.quaternions_of(scene),
            free=free,
            cores=cores,
            progress=progress,
        )
    ticks = block_ticks(float(log.load_times_s[-1] - log.load_times_s[0]), log.load_period_s)
    measured = block_averages(log.load_times_s, log.loads, log.channels, ticks)
    forward, measured = forward.averaged_as(measured)
    require_signs(forward, measured)
    layers = {
        each.name.split(".")[1] for each in forward.parameters if each.name.startswith("cutting.")
    }
    constants = {
        layer: scene.constants.layer_constants(layer, bone=scene.cutting.material)
        for layer in sorted(layers)
    }
    return Problem(
        forward,
        measured,
        ticks * TICK_S,
        lambda _: list(cutting_candidates(forward).items()),
        forward.notes,
        {
            f"cutting.{layer}.{REFERENCE}": known[REFERENCE].value
            for layer, known in constants.items()
        },
    )


def cutting_candidates(like: CuttingForward) -> dict[str, CuttingForward]:
    """Return cuts with the free constants of a log, by a description of each cut.

    Parameters
    ----------
    like
        Cut of the log: its tool, the layers that the tool touched, the feed while cutting, and the
        free constants.
    """
    tool = like.record.scene.tool
    assert isinstance(tool, Tool)
    feed_m_s = _feed_m_s(like)
    radius_m = 0.5e-3 * tool.diameter_mm
    found = {}
    for kind, depth in product(TRAVEL, DEPTHS):
        unit, recorded_m_s = _steady(like.record.scene, tool, kind, depth * radius_m)
        for at, feed, spin in product(like.record.layers, FEEDS, SPINS):
            loads = unit.copy()
            loads[:3] *= feed * feed_m_s / recorded_m_s / spin
            name = (
                f"a {kind} {1e3 * depth * radius_m:.3g} mm deep in "
                f"{like.record.layer_names[at]} at "
                f"{1e3 * feed * feed_m_s:.3g} mm/s and {spin * abs(tool.spin_rpm):.6g} rpm"
            )
            found[name] = _second_of(like, at, loads)
    return found


def _second_of(like: CuttingForward, layer: int, unit: Array) -> CuttingForward:
    """Return a record of air, then one second of steady loads in one layer.

    The loads are given for a unit of each coefficient, shape (6, 6).
    """
    density = round(like.record.layers[layer].nodes.middle_kg_m3)
    ticks = np.repeat(unit[None, :, None], LASTS, axis=2)
    ticks[:, :, :AIR] = 0.0
    loads = LayerLoads(DensityNodes.of(density, density), ticks)
    times_s = TICK_S * np.arange(LASTS, dtype=np.float64)
    return replace(
        like, record=replace(like.record, times_s=times_s, layers={layer: loads}), times_s=times_s
    )


def _feed_m_s(like: CuttingForward) -> float:
    """Return the median speed of the tip during cutting [m/s]."""
    trace = like.record.trace
    speed = (
        1e-3
        * np.linalg.norm(np.diff(trace.vectors("tool", "mm"), axis=0), axis=1)
        / np.diff(trace["time_s"])
    )
    return float(np.median(speed[(trace["contact_mm2"][1:] > 0.0) & (speed > 0.0)]))


def _steady(scene: Scene, tool: Tool, kind: str, depth_m: float) -> tuple[Array, float]:
    """Return the steady loads in a block, shape (6, 6), and their feed [m/s].

    The loads are given for a unit of each coefficient.
    """
    radius_m = 0.5e-3 * tool.diameter_mm
    travel_m = TRAVEL[kind] * radius_m
    deep = np.array([0.0, 0.0, -depth_m])
    along = np.array([travel_m, 0.0, 0.0]) if kind == "slot" else np.array([0.0, 0.0, -travel_m])
    feed_m_s = travel_m / (TICKS * TICK_S)
    motion = FollowPath(
        np.stack([deep - 0.75 * along, deep + 0.25 * along]), feed_m_s=feed_m_s, axis=UP
    )
    wide_mm = 3.0 * tool.diameter_mm
    size_mm = 2.0 * tool.diameter_mm
    block = scene.model_copy(
        update={
            "anatomy": BlockAnatomy(size_mm=(wide_mm, wide_mm, size_mm)),
            "voxels": Voxels(spacing_mm=1e3 * radius_m / VOXELS),
            "tool": tool.without_peg(),
            "cutting": Cutting(),
        }
    )
    record = record_loads(block, motion=motion)
    (layer,) = record.layers.values()
    return layer.unit[0, :, STEADY].mean(axis=1), feed_m_s
