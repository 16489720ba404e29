"""Reference over a run.

The tests cover its error measure, its interpolation over ticks, its cache, and the engine against
it.
"""

import numpy as np
import pytest
from reference_errors import error_of_force

import tissue
from tissue.evaluation.reference import history
from tissue.evaluation.reference.force import wrench_at
from tissue.evaluation.reference.history import (
    path_of_trace,
    reference_force,
    solid_of_scene,
)
from tissue.simulation.builders.cutting import cutter_of

SLOT = {
    "voxels.spacing_mm": 0.4,
    "anatomy.size_mm": [10, 8, 5],
    "motion.points_mm": [[-1, 0, 0.1], [-1, 0, -0.2], [1, 0, -0.4], [1, 0, 0.1]],
    "motion.feed_mm_s": 10.0,
    "duration_s": 0.15,
}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TISSUE_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield tissue.simulate(tissue.load_scene("milling", SLOT), cores=1)


@pytest.fixture(scope="module")
def evaluated():
    """Ticks at which the reference is evaluated."""
    return set()


@pytest.fixture(scope="module")
def reference(run, evaluated):
    def counted_wrench(tick, *given, **named):
        evaluated.add(tick)
        return wrench_at(tick, *given, **named)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history, "wrench_at", counted_wrench)
        return reference_force(run.scene, run.trace)


@pytest.mark.slow
def test_what_is_interpolated_meets_what_would_be_evaluated(run, reference, evaluated):
    cutter, solid = cutter_of(run.scene.tool), solid_of_scene(run.scene)
    path = path_of_trace(run.trace, cutter)
    assert 0 < len(evaluated) < 0.8 * len(run.trace.rows) and 0.0 < reference.uncertainty < 2e-3
    ticks = np.random.default_rng(0).choice(len(run.trace.rows), 15, replace=False)
    exact = np.array([wrench_at(int(k), path, cutter, solid)[:3] for k in ticks])
    off = np.linalg.norm(exact - reference.force_N[ticks], axis=1)
    assert off.max() < 2.0 * history.INTERPOLATION * np.linalg.norm(reference.force_N, axis=1).max()


def test_the_engine_is_near_the_reference(run, reference):
    """The engine is near the reference, within 0.5 % over 50 ms in coarse voxels.

    The rest is the error of the cutter's elements.
    """
    error = error_of_force(run.trace.vectors("model_force", "N"), reference)
    assert 0.0 < error.over_50_ms <= error.over_ticks < 0.01
    assert error.over_50_ms < 0.005 and abs(error.bias) < 0.003


def test_a_guide_hole_is_no_bone():
    solid = solid_of_scene(tissue.load_scene("glenoid"))
    points = np.array([[0.0, 0.0, -5e-3], [5e-3, 0.0, -5e-3]])
    assert (solid.distance(points) > 0.0).tolist() == [True, False]
