"""Assessment, stability, simulated people and studies in Python.

They use the command's own code and figures.
"""

from dataclasses import replace

import numpy as np
import pytest

import tissue
from meshes.base.errors import InputError
from tissue.haptics.device.device import device_parameters


@pytest.fixture(scope="module")
def by_hand():
    """A short touch of the wall by a hand."""
    changes = {
        "motion.points_mm": [[0, 0, 5], [0, 0, -5]],
        "duration_s": 0.4,
        "device": "six-dof",
        "seed": 3,
    }
    return tissue.simulate(tissue.load_scene("wall", changes))


def test_a_wall_is_judged_in_a_hand_and_grows_above_its_limit():
    free, held = (
        tissue.stability.wall_loop("six-dof", 2000.0, hand=hand) for hand in (None, "expert")
    )
    assert tissue.stability.judge(held).stable and not tissue.stability.judge(free).stable
    assert tissue.stability.wall_loop(device_parameters("six-dof"), 2000.0) == free
    critical = tissue.stability.critical_stiffness_N_m(held)
    assert tissue.stability.judge(held).critical_N_m == critical
    assert tissue.stability.growth(replace(held, stiffness_N_m=1.05 * critical)) > 1.0
    assert tissue.stability.growth(replace(held, stiffness_N_m=0.95 * critical)) < 1.0
    with pytest.raises(InputError, match="device must be one of"):
        tissue.stability.wall_loop("pen", 100.0)


def test_people_are_measured_and_a_scale_that_is_known_changes_nothing_for_the_reference():
    crowd = tissue.calibration.alike(20, kappa=0.07)
    assert np.median(tissue.calibration.estimated_webers(crowd, trials=40)) == pytest.approx(
        0.07, rel=0.3
    )
    plain, known = (
        tissue.calibration.share_right(crowd, 2.0, 1.6, seed=1, calibrated_by=each)
        for each in (None, 0)
    )
    assert np.array_equal(plain, known) and plain.mean() > 0.9
    assert tissue.calibration.change_percent(plain, known).value == 0.0
    expert, novice = (tissue.calibration.people(group, 50) for group in ("expert", "novice"))
    assert expert.kappa.mean() < novice.kappa.mean()


def test_a_run_is_assessed_fresh_as_it_is_from_its_folder(by_hand, tmp_path):
    other = tissue.simulate(
        by_hand.scene.model_copy(
            update={"device": by_hand.scene.held.model_copy(update={"hand": "novice"})}
        )
    )
    fresh = tissue.assess(other, by_hand)
    folders = [
        run.save(tmp_path / name, pictures=False)
        for run, name in ((other, "novice"), (by_hand, "expert"))
    ]
    read = tissue.assess(folders[0], str(folders[1]))
    assert read.figures["deviation_mm"] == pytest.approx(fresh.figures["deviation_mm"], rel=1e-3)
    assert "force: peak" in str(fresh) and len(fresh.save(tmp_path / "found")) == 2
