"""The force of a loop of which nothing is played: a device whose motion is known ahead, its tool and the tissue."""

import numpy as np

from meshes.base.arrays import Array
from tissue.builders.parts import Parts
from tissue.haptics.hand_motion import HandMotion
from tissue.models.tissue_model import TICK_S, Finishes, Response, StartsBackground, ToolMotion, WaitsForBackground
from tissue.simulation.loop import undisturbed
from tissue.simulation.trace import LEAST_LOAD

__all__ = ["rendered_force_N"]


def rendered_force_N(parts: Parts, ticks: int) -> Array:
    """Force of the renderer in each tick, before prediction, filter and delay [N], shape (ticks, 3).

    It is the columns ``raw_force`` of a run of the same parts, bit for bit, at about half the cost: nothing is
    predicted, filtered, limited, played, booked, timed or recorded, none of which a motion that is known ahead feels.

    Parameters
    ----------
    parts
        A tool on a device that plays no force, and what it meets; its model answers every tick.
    ticks
        How many.
    """
    motion, tissue = parts.motion, parts.tissue
    assert isinstance(motion, HandMotion)
    waits = tissue if isinstance(tissue, WaitsForBackground) else None
    starts = tissue if isinstance(tissue, StartsBackground) else None
    tool, response = ToolMotion(), Response.empty(len(tissue.layer_names))
    forces = np.zeros((ticks, 3))
    motion.begin(tool)
    tissue.place(tool)
    tissue.respond(tool)
    with undisturbed():
        for tick in range(ticks):
            now = tick * TICK_S
            if waits is not None:
                waits.wait_for_background(now)
            motion.advance(now, TICK_S, response, tool)
            tissue.advance(tool)
            response = tissue.respond(tool)
            if motion.correct(response, tool):
                tissue.advance(tool)
                response = tissue.respond(tool)
            forces[tick] = motion.raw_force_N()
            if starts is not None:
                starts.start_background(now, tool)
    if isinstance(tissue, Finishes):
        tissue.finish()
    forces[np.abs(forces) < LEAST_LOAD] = 0.0
    return forces
