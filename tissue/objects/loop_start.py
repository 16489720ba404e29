"""Tool, start and prepared region of a `tissue.Loop`."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, by, require_range
from tissue.cutters import Cutter, ball_burr
from tissue.models.tissue_model import TICK_S
from tissue.objects.bone import Bone
from tissue.objects.cutting import Structures
from tissue.objects.organ import Organ
from tissue.objects.tools import PressingTool, ball
from tissue.scene.scene import Scene
from tissue.simulation.posed import Region

__all__ = ["LONGEST_S", "Extent", "fitted", "leave_out", "region", "start_above"]

CLEARANCE_MM = 2.0
"""Default height of the tool above the surface at the start [mm]."""
LONGEST_S = 3600.0
"""Longest duration of a loop for which rows are allocated [s].

One hour of a trace with 60 columns takes 1.7 GB.
"""
REACH_MM = 5.0
SCENE_REACH_MM = 2.0
"""Default reach [mm] around a tool, and around the path of a scene.

Tissue along the path of a scene is prepared in any case.
"""
MOST_TICKS = 1000
"""Largest number of ticks in a step, which is a rate of 1 Hz."""


@dataclass(frozen=True)
class Extent:
    """Size of a loop in time and space.

    Attributes
    ----------
    rows
        Number of ticks that the trace keeps.
    ticks
        Number of ticks in a step.
    reach_m
        Distance around the tool, or around the path of a scene, within which tissue is prepared
        [m].
    """

    rows: int
    ticks: int
    reach_m: float

    @classmethod
    def of(
        cls,
        tissue: Bone | Organ | Scene,
        *,
        longest_s: float,
        step_ms: int,
        reach_mm: float | None,
    ) -> "Extent":
        """Return the extent from the arguments of a `Loop`.

        Raises
        ------
        InputError
            If an argument is out of range.
        """
        longest = require_range("longest_s", longest_s, TICK_S, LONGEST_S, "use 600")
        ticks = require_range("step_ms", step_ms, 1, MOST_TICKS, "use 1")
        if ticks != round(ticks):
            raise InputError("step_ms", "be a whole number of ticks of 1 ms", step_ms, "use 1")
        usual_mm = SCENE_REACH_MM if isinstance(tissue, Scene) else REACH_MM
        least_mm = 0.0 if isinstance(tissue, Scene) else 0.5
        reach = usual_mm if reach_mm is None else reach_mm
        checked_mm = require_range("reach_mm", reach, least_mm, 100.0, f"use {usual_mm:g}")
        return cls(round(longest / TICK_S), round(ticks), 1e-3 * checked_mm)


def leave_out(given: Mapping[str, object], when: str) -> None:
    """Refuse arguments that would have no effect."""
    for name, value in given.items():
        if value is not None:
            raise InputError(name, f"be left out {when}", repr(value)[:60], "remove it")


def fitted(
    tissue: Bone | Organ, tool: Cutter | PressingTool | None, keep_clear: Structures | None
) -> Cutter | PressingTool:
    """Return the given tool after checks, or a default tool for the tissue."""
    if isinstance(tissue, Bone):
        burr = tool or ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
        tissue.require_cutter(burr)
        return burr
    if keep_clear:
        raise InputError(
            "keep_clear", "be left out for an organ", "structures", "use keep_clear for bone"
        )
    pressing = tool or ball(diameter_mm=10)
    if not isinstance(pressing, PressingTool):
        raise InputError(
            "tool",
            "be a tool that presses an organ",
            type(tool).__name__,
            "make a tool by tissue.ball",
        )
    return pressing


def region(start_m: Array, turn: Array, reach_m: float) -> Region:
    """Return the region around and below a start within which an organ may be touched."""
    place = start_m @ turn
    far = np.array([reach_m, reach_m, np.inf])
    return Region(turn, place - reach_m, place + far)


def start_above(tissue: Bone | Organ, axis: Array) -> Array:
    """Return the position of a tip above the middle of a bone or an organ, along the tool's axis
    [mm].
    """
    surface = tissue.surface()
    low, high = np.array(surface.bounds).reshape(3, 2).T
    middle = 0.5 * (low + high)
    size = float(np.linalg.norm(high - low))
    found, _ = surface.ray_trace(middle + size * axis, middle - size * axis, first_point=True)
    if np.size(found) == 0:
        raise InputError(
            "start_mm",
            f"be given where nothing lies under the middle {by(middle, '.4g')} mm",
            "none",
            "give a place above the surface",
        )
    return np.asarray(found, dtype=np.float64).reshape(-1, 3)[0] + CLEARANCE_MM * axis
