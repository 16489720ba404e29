"""Loop that plays nothing.

It gives the raw force of a whole run bit for bit, and cached values change nothing.
"""

import numpy as np
import pytest

from meshes.base.cache import RecentResults
from tissue import load_scene, simulate
from tissue.cutters import cutter
from tissue.evaluation.study.plan import TASKS
from tissue.haptics.device.device import Sample
from tissue.haptics.device.recorded import RecordedDevice
from tissue.haptics.loop import forecast
from tissue.models.organ import soft_organ
from tissue.scene.load import changed
from tissue.simulation import reference_force
from tissue.simulation.builders import organ_scene, voxels
from tissue.simulation.reference_force import ideal_force_N, ideal_scene

KEPT = (
    (cutter, "_tables"),
    (cutter, "_shells"),
    (voxels, "_volumes"),
    (organ_scene, "_meshes"),
    (soft_organ, "_spaces"),
    (soft_organ, "_patches"),
    (forecast, "_forecasts"),
)
"""Caches that the runs of a process share."""
SECONDS = {"T2": 1.0, "T1": 0.6, "T3": 0.6, "needle": 1.0, "drilling": 1.0}


def by_hand(task):
    """A task's scene in a hand, cut short, with a predictor whose force the hand feels."""
    entries = {
        "device": "touch",
        "hand": "expert",
        "prediction": "koopman",
        "coupling.stiffness_N_m": 150.0,
    }
    return changed(
        load_scene(TASKS[task].scene),
        {**TASKS[task].changes, **entries, "duration_s": SECONDS[task]},
    )


class Pausing(RecordedDevice):
    """A record with a gap, in which there is no sample."""

    def read(self, time_s: float) -> Sample | None:
        return None if 0.8 < time_s / self._last < 0.85 else super().read(time_s)


@pytest.mark.parametrize(
    ("task", "device"),
    [
        ("T2", RecordedDevice),
        *(
            pytest.param(task, Pausing, marks=() if task == "T2" else pytest.mark.slow)
            for task in SECONDS
        ),
    ],
)
def test_the_raw_force_is_that_of_a_whole_run(monkeypatch, task, device):
    run = simulate(by_hand(task), cores=1, allow_unstable=True)
    given = []

    def recorded(*parts, **named):
        given.append(device(*parts, **named))
        return given[-1]

    monkeypatch.setattr(reference_force, "RecordedDevice", recorded)
    ideal = ideal_force_N(run, cores=1)
    scene = ideal_scene(run.scene).model_copy(update={"duration_s": 1e-3 * len(run.trace.rows)})
    whole = simulate(scene, cores=1, allow_unstable=True, device=given[0]).trace.vectors(
        "raw_force", "N"
    )
    assert ideal.tobytes() == whole.tobytes()
    assert np.abs(ideal).max() > 1e-3, "it touched nothing"


@pytest.mark.slow
@pytest.mark.parametrize("task", ["T1", "drilling"])
def test_what_runs_share_changes_no_bit(monkeypatch, task):
    """Data shared by runs change no bit.

    The second run of a process, which gets the data of the first, is compared with one that makes
    all anew.
    """
    scene = by_hand(task)
    simulate(scene, cores=1, allow_unstable=True)
    shared = simulate(scene, cores=1, allow_unstable=True).trace.rows
    for module, name in KEPT:
        monkeypatch.setattr(module, name, RecentResults(0))
    assert shared.tobytes() == simulate(scene, cores=1, allow_unstable=True).trace.rows.tobytes()
