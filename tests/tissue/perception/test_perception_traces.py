"""Perception in whole runs: effect of the deadband on recorded forces, and columns of the trace."""

import numpy as np
import pytest
from held_back import held_back

import tissue
from tissue.perception.laws import weber_of
from tissue.perception.observer import Observer, population_observer, write_observer


def by_hand(scene, **changes):
    return tissue.simulate(tissue.load_scene(scene, {"device": "touch", "seed": 3} | changes)).trace


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "changes", "least_saved"),
    [
        ("wall", {"duration_s": 1.2}, 0.9),
        ("milling", {"duration_s": 1.5}, 0.9),
        pytest.param(
            "molar",
            {"voxels.spacing_mm": 0.1, "stress": None, "duration_s": 1.2, "hand": "novice"},
            0.85,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_one_sample_in_ten_is_enough(scene, changes, least_saved):
    """One sample in ten is enough.

    The error is below the threshold at every tick, there is no bias, and this share of the samples
    in contact is not needed.
    """
    law, forces = (
        weber_of(population_observer()),
        by_hand(scene, **changes).vectors("filtered_force", "N"),
    )
    played, changed = held_back(forces, law)
    assert (
        np.linalg.norm(played - forces, axis=1)
        <= law.threshold(np.linalg.norm(played, axis=1)) * (1 + 1e-12)
    ).all()
    # the low-pass leaves a tail that nobody feels
    contact = np.linalg.norm(forces, axis=1) > law.kappa * law.offset
    assert contact.sum() > 300
    assert 1.0 - changed[contact].mean() > least_saved
    bias = np.linalg.norm((played - forces)[contact].mean(axis=0))
    assert bias < float(law.threshold(np.linalg.norm(forces[contact], axis=1)).mean())


def test_a_trace_holds_what_was_estimated_perceived_and_changed():
    trace = by_hand("wall", duration_s=1.0, perception="population")
    played, changed = trace.vectors("device_force", "N"), trace["above_threshold"]
    assert set(np.unique(changed)) == {0.0, 1.0} and changed.mean() < 0.1
    moved = (np.diff(played, axis=0) != 0.0).any(axis=1)
    at_rest = ~played[1:].any(axis=1)
    fade = 40  # ticks in which the guard fades the force in
    assert not (moved & (changed[1:] == 0.0) & ~at_rest)[fade:].any()
    pressed = trace["perceived"] > 0.0
    assert (trace["perceived_spread"][pressed] > 0.0).all()
    size = np.linalg.norm(played, axis=1)
    assert np.corrcoef(trace["estimated_force_N"], size)[0, 1] > 0.8  # it lags by 100 ms


def test_an_observer_from_a_file_feels_in_a_run_what_the_reference_would(tmp_path):
    """An observer from a file feels in a run the reference's intensity.

    At ticks with a newly rendered force, the perceived intensity is the reference's intensity of
    the force, by the gain.
    """
    someone = Observer.known(
        "ada", alpha=1.3, beta=1.5, kappa=0.05, offset_N=0.1, lapse=0.02, sigma=0.2
    )
    write_observer(someone, tmp_path / "ada.json")
    trace = by_hand("wall", duration_s=1.0, perception=f"observer:{tmp_path / 'ada.json'}")
    size = np.linalg.norm(trace.vectors("filtered_force", "N"), axis=1)
    rendered = (trace["above_threshold"] == 1.0) & (size > someone.offset_N)
    assert rendered.sum() > 10
    assert np.allclose(trace["perceived"][rendered], size[rendered] ** 1.7, rtol=1e-6, atol=0.0)
