"""A drilled tooth: what is booked as removed, stress after warm starts, dentin over the pulp."""

import numpy as np
import pytest

import tissue
from tissue.models.tooth import stress_process
from tissue.models.tooth.field import StressField

DEEP = {
    "voxels.spacing_mm": 0.1,
    "stress.cell_mm": 0.8,
    "motion.points_mm": [[0, 0, 0.1], [0, 0, -6]],
    "motion.feed_mm_s": 1.5,
    "duration_s": 4.1,
}
"""Straight down through enamel, dentin and roof into the chamber, coarse."""


class Drilled:
    """Molar drilled into its pulp.

    The stress of each frame is stored with a cold solve of the same state.
    """

    def __init__(self, monkeypatch):
        self.lead = []
        warm = StressField.solve

        def solve(field, time_s, force_N, point_m):
            frame = warm(field, time_s, force_N, point_m)
            kept, body = field.body.displacement_m, field.body
            cold = body.solve(field.load(force_N, point_m), cold=True)
            body.displacement_m = kept
            if force_N.any():
                exact = 1e-6 * field.recover(cold.displacement_m)[0]
                there = body.cells.live > 0
                difference = frame.cells["von_mises_MPa"][there] - exact[there]
                self.lead.append(np.linalg.norm(difference) / np.linalg.norm(exact[there]))
            return frame

        monkeypatch.setattr(stress_process, "StressProcess", stress_process.InlineStressSolver)
        monkeypatch.setattr(StressField, "solve", solve)
        self.run = tissue.simulate(tissue.load_scene("molar", DEEP))
        self.trace, self.model = self.run.trace, self.run.parts.tissue


@pytest.fixture(scope="module")
def drilled():
    with pytest.MonkeyPatch.context() as patch:
        return Drilled(patch)


@pytest.mark.slow
def test_what_is_booked_is_what_is_missing(drilled):
    """Removed volume per layer equals the missing volume in the voxels, exactly."""
    bone = drilled.model.milling
    np.testing.assert_array_equal(
        bone.store.start_steps - bone.removed_steps, bone.store.steps_by_layer()
    )
    lost = dict(zip(bone.layer_names, bone.removed_steps, strict=True))
    assert min(lost["enamel"], lost["dentin"], lost["pulp"]) > 0
    assert lost["caries"] == lost["ligament"] == lost["bone"] == 0


def test_stress_after_warm_starts_is_that_of_a_cold_solve(drilled):
    """Stress after warm starts equals that of a cold solve.

    Von Mises stress over the cells, relative L2, is within 0.5 % at every frame of the drilling.
    """
    assert len(drilled.lead) > 20
    assert max(drilled.lead) < 0.005
    assert {record.outcome for record in drilled.model.stress.records} == {"CONVERGED"}


def test_the_pulp_is_reported_before_it_is_hit(drilled):
    """The pulp is reported before the bur reaches it.

    Both limits and the exposure are reported once each, in their order; the exposure within a voxel
    of the pulp's roof.
    """
    # a busy machine also reports late stress
    on_pulp = [event for event in drilled.run.events if "pulp" in event[1]]
    times, message = zip(*on_pulp, strict=True)
    assert message == (
        "less than 1 mm of dentin is left over the pulp",
        "less than 0.5 mm of dentin is left over the pulp",
        "the pulp is exposed",
    )
    assert list(times) == sorted(set(times))
    depth = dict(
        zip(
            message,
            np.interp(times, drilled.trace["time_s"], drilled.trace["tool_z_mm"]),
            strict=True,
        )
    )
    assert depth["the pulp is exposed"] == pytest.approx(-5.0, abs=0.1)
    assert not drilled.trace["removed_pulp_mm3"][drilled.trace["time_s"] < times[1]].any()
    assert drilled.trace["removed_pulp_mm3"][-1] > 0.0
    over = drilled.trace["dentin_over_pulp_mm"]
    assert (np.diff(over) <= 0.0).all() and over[0] > 3.0 and over[-1] == 0.0
