"""Points of a tool's whole body, by which it keeps clear of structures."""

import numpy as np
import pytest

import tissue
from tissue.cutters.body import body_points
from tissue.cutters.profile import ball_burr, hemispherical_reamer, twist_drill

DIRECTIONS = np.random.default_rng(0).normal(size=(200, 3))
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]


def test_body_reaches_as_far_as_its_profile():
    """A body reaches as far as its profile.

    Support of the points in every direction is compared with a ball, a cone on a cylinder, and a
    peg.
    """
    ball = body_points(ball_burr(diameter_m=4e-3), spacing_m=2e-4)
    assert np.abs((ball @ DIRECTIONS.T).max(axis=0) - 2e-3 * DIRECTIONS[:, 2] - 2e-3).max() < 1e-5
    drill = body_points(
        twist_drill(diameter_m=3.2e-3, length_m=20e-3, point_angle_rad=2.06), spacing_m=2e-4
    )
    shoulder = 1.6e-3 / np.tan(1.03)
    across = 1.6e-3 * np.hypot(DIRECTIONS[:, 0], DIRECTIONS[:, 1])
    ends = [0.0 * across, across + shoulder * DIRECTIONS[:, 2], across + 20e-3 * DIRECTIONS[:, 2]]
    assert np.abs((drill @ DIRECTIONS.T).max(axis=0) - np.maximum.reduce(ends)).max() < 1e-5
    reamer = hemispherical_reamer(diameter_m=30e-3, peg_diameter_m=6e-3, peg_length_m=8e-3)
    assert body_points(reamer, spacing_m=1e-3)[:, 2].min() == -8e-3


@pytest.mark.slow
def test_pulp_of_a_molar():
    """The dentin left over the pulp is the distance to the pulp while the bur goes deeper."""
    change = {
        "keep_clear.names": ["pulp"],
        "duration_s": 2.4,
        "voxels.spacing_mm": 0.1,
        "stress.cell_mm": 0.4,
    }
    run = tissue.simulate(tissue.load_scene("molar", change).model_copy(update={"stress": None}))
    left = run.trace["dentin_over_pulp_mm"]
    apart = np.abs(run.trace["distance_pulp_mm"] - left)[left < 2.5]
    # one is of voxels of 0.1 mm, half of one off; the other of rounded unions
    assert apart.max() < 0.15


@pytest.mark.slow
def test_a_pedicle_is_drilled_beside_the_canal_and_into_it():
    """A pedicle is drilled next to the canal and into it.

    On its axis the drill stays as far off as the shapes give; moved across, it breaches the canal.
    """
    held = tissue.simulate(tissue.load_scene("pedicle", {"voxels.spacing_mm": 0.2}))
    assert not [what for _, what in held.events if "canal" in what]
    assert held.summary["keep_clear"]["canal"]["least_distance_mm"] == pytest.approx(6.14, abs=0.02)
    astray = {
        "motion.start_mm": [5.0, 0.0, 1.0],
        "motion.axis": [-0.34, 0.0, 0.94],
        "voxels.spacing_mm": 0.2,
    }
    breached = tissue.simulate(tissue.load_scene("pedicle", astray))
    assert any(what.startswith("breached canal") for _, what in breached.events)
    assert breached.summary["keep_clear"]["canal"]["breach_depth_mm"] > 1.0
