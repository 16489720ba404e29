"""A drilled tooth: what is booked as removed, stress after warm starts, dentin over the pulp."""

import numpy as np
import pytest

import tissue
from meshes.voxels.volume import VoxelVolume
from tissue.cutters.cutter import Cutter
from tissue.cutters.profile import ball_burr
from tissue.materials.constants import cutting_coefficients
from tissue.models.bone.bricks import voxels_of
from tissue.models.bone.model import BoneModel
from tissue.models.tissue_model import ToolMotion
from tissue.models.tooth import stress_process
from tissue.models.tooth.field import TOOTH, StressField
from tissue.models.tooth.grid import FULL_STEPS
from tissue.models.tooth.model import ToothModel

MM = 1e-3
SPACING_M = 0.05 * MM
RADIUS_M = 0.5 * MM
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
        self.force = np.linalg.norm(self.trace.vectors("model_force", "N"), axis=1)

    def inside(self, layer):
        """Return the ticks in which the bur touches one layer only.

        Its half ball is 0.5 mm high, enamel ends near -1.4.
        """
        high, low = {"enamel": (-0.5, -1.2), "dentin": (-2.0, -4.5)}[layer]
        depth = self.trace["tool_z_mm"]
        return (depth < high) & (depth > low)


@pytest.fixture(scope="module")
def drilled():
    with pytest.MonkeyPatch.context() as patch:
        return Drilled(patch)


def test_what_is_booked_is_what_is_missing(drilled):
    """Removed volume per layer equals the missing volume in the voxels, exactly."""
    bone = drilled.model.milling
    np.testing.assert_array_equal(
        bone.start_steps - bone.removed_steps, bone.store.steps_by_layer()
    )
    lost = dict(zip(bone.layer_names, bone.removed_steps, strict=True))
    assert min(lost["enamel"], lost["dentin"], lost["pulp"]) > 0
    assert lost["caries"] == lost["ligament"] == lost["bone"] == 0


def test_particles_lose_what_the_voxels_lose(drilled):
    """Particles lose the volume that the voxels lose, within 1 %.

    A particle at the surface holds less than the finer voxels in its place, or more.
    """
    model = drilled.model
    volume, field = model.milling.store.volume, model.stress.field
    left = model.remaining()
    store = model.milling.store
    rows, now = store.take_touched()
    voxels, steps = voxels_of(store.places, rows, model.stress._before[rows].astype(np.int64) - now)
    field.remove(voxels, steps, origin_m=volume.origin_m, spacing_m=volume.spacing_m)
    body = field.body
    share = 1.0 - body.cells.remaining / FULL_STEPS
    particles = float((body.particles.volume_m3[body.cells.order] * share).sum())
    tooth = np.isin(volume.layer, [volume.layer_names.index(name) for name in TOOTH])
    voxels = (
        float((volume.fraction - left)[tooth].sum(dtype=np.int64)) / 255 * volume.voxel_volume_m3
    )
    assert particles == pytest.approx(voxels, rel=0.01)


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


def dentin_over(pulp_distance):
    """Return a bur over a pulp, in a block of dentin with its top at z = 0.

    The pulp is given by its distance function of points [m].
    """
    shape = (60, 40, 70)
    origin = SPACING_M * np.array([-30.0, -20.0, -70.0])
    centres = origin + SPACING_M * (np.stack(np.indices(shape), axis=-1) + 0.5)
    layer = (pulp_distance(centres) < 0.0).astype(np.uint8)
    volume = VoxelVolume(
        origin,
        SPACING_M,
        np.full(shape, 255, np.uint8),
        layer,
        np.full(shape, 2100, np.uint16),
        ("dentin", "pulp"),
    )
    model = ToothModel(
        BoneModel(
            volume,
            Cutter(ball_burr(diameter_m=2.0 * RADIUS_M), 6, 41888.0),
            (cutting_coefficients("dentin"), cutting_coefficients("soft")),
        )
    )
    motion = ToolMotion(tip_m=np.array([0.0, 0.0, 1.0 * MM]))
    model.place(motion)

    def at(tip_mm):
        motion.tip_m[:] = MM * np.array(tip_mm)
        model.advance(motion)
        return float(model.respond(motion).measures[0])

    return model, at


def test_dentin_over_a_round_pulp():
    """The dentin over a round pulp is the gap between two spheres as the bur comes down next to it.

    The tolerance is half a voxel.
    """
    centre, radius = np.array([0.1, 0.0, -2.2]), 0.8
    _, at = dentin_over(lambda x: np.linalg.norm(x - MM * centre, axis=-1) - radius * MM)
    before = np.inf
    for depth in np.linspace(0.05, 1.3, 26):
        tip = np.array([0.4, -0.2, -depth])
        ball = tip + np.array([0.0, 0.0, 1e3 * RADIUS_M])
        found = at(tip)
        exact = np.linalg.norm(ball - centre) - radius - 1e3 * RADIUS_M
        assert found == pytest.approx(exact, abs=0.5e3 * SPACING_M)
        assert found <= before
        before = found
