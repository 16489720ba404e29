"""Tool, start and prepared region of a `tissue.Loop`."""

from collections.abc import Mapping

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, by
from tissue.cutters import Cutter, ball_burr
from tissue.objects.bone import Bone
from tissue.objects.cutting import Structures
from tissue.objects.organ import Organ
from tissue.objects.tools import PressingTool, ball
from tissue.simulation.posed import Region

__all__ = ["fitted", "leave_out", "region", "start_above"]

CLEARANCE_MM = 2.0
"""Default height of the tool above the surface at the start [mm]."""


def leave_out(given: Mapping[str, object], when: str) -> None:
    """Refuse arguments that have no effect."""
    for name, value in given.items():
        if value is not None:
            raise InputError(name, f"be left out {when}", repr(value)[:60], "remove it")


def fitted(
    tissue: Bone | Organ, tool: Cutter | PressingTool | None, keep_clear: Structures | None
) -> Cutter | PressingTool:
    """Return a tool for a tissue, by default one for a first try."""
    if isinstance(tissue, Bone):
        burr = tool or ball_burr(diameter_mm=4, flutes=6, spin_rpm=20_000)
        tissue.require_cutter(burr)
        return burr
    if keep_clear:
        raise InputError("keep_clear", "be left out for an organ", "structures", "use it in bone")
    pressing = tool or ball(diameter_mm=10)
    if not isinstance(pressing, PressingTool):
        raise InputError("tool", "press an organ", type(tool).__name__, "make one by tissue.ball")
    return pressing


def region(start_m: Array, turn: Array, reach_m: float) -> Region:
    """Return the region around and below a start within which an organ may be touched."""
    place = start_m @ turn
    far = np.array([reach_m, reach_m, np.inf])
    return Region(turn, place - reach_m, place + far)


def start_above(tissue: Bone | Organ, axis: Array) -> Array:
    """Return a tip above the middle of a bone or an organ, along the tool's axis [mm]."""
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
