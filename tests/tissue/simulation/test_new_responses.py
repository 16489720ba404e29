"""Tissue that returns a new response from each call.

Its trace equals that of a tissue that fills one response anew.
"""

from dataclasses import fields, replace

import numpy as np
import pytest

from meshes.base.progress import silent
from tissue import load_scene
from tissue.evaluation.recorded_runs import _run
from tissue.haptics.device.recorded import RecordedDevice
from tissue.models.tissue_model import Response, WallModel
from tissue.simulation.loop import Loop
from tissue.simulation.reference_force import rendered_force_N
from tissue.simulation.simulate import build

TICKS = 400


class NewResponses(WallModel):
    """A wall whose earlier responses keep their numbers."""

    def respond(self, motion):
        found = super().respond(motion)
        values = {each.name: getattr(found, each.name) for each in fields(Response)}
        return Response(
            **{name: np.array(v) if isinstance(v, np.ndarray) else v for name, v in values.items()}
        )


def parts_with(wall, **changes):
    """Return the parts of the test wall's scene with that wall.

    A device taps it ten times a second, at up to 0.25 m/s.
    """
    changes = {"device": "touch", "prediction": "none", "duration_s": 1e-3 * TICKS} | changes
    scene = load_scene("wall", changes)
    parts = build(scene, compute="cpu", cores=1, report=silent)
    times = 1e-3 * np.arange(TICKS + 1)
    heights = 4e-3 * np.cos(20.0 * np.pi * times)
    parts.motion.device = RecordedDevice(
        times, np.column_stack([0.0 * times, 0.0 * times, heights])
    )
    return scene, replace(parts, tissue=wall(1e4, radius_m=5e-3))


def traced(wall, **changes):
    """Rows of the engine's trace."""
    scene, parts = parts_with(wall, **changes)
    loop = Loop(parts, ticks=TICKS, output=scene.output)
    loop.place()
    for _ in range(TICKS):
        loop.step()
    return loop.trace.rows


def prompt(wall):
    """Forces of the loop of which nothing is played."""
    return rendered_force_N(parts_with(wall)[1], TICKS)


def recorded(wall):
    """Rows of a recording for training."""
    parts = parts_with(wall)[1]
    return _run(parts.motion, parts.tissue, TICKS)[0]


@pytest.mark.parametrize(
    "rows",
    [traced, lambda wall: traced(wall, **{"coupling.model_ms": 5}), prompt, recorded],
    ids=["tick", "slow model", "prompt loop", "training"],
)
def test_a_tissue_may_return_new_responses(rows):
    same, new = rows(WallModel), rows(NewResponses)
    assert np.abs(same).max() > 1e-3
    np.testing.assert_array_equal(new, same)
