"""Conditioning of a tool in a hand: replayed device paths, amplification and force error."""

import numpy as np
import pytest

from tissue import InputError, load_scene
from tissue.evaluation.atlas.held_tool import (
    OBLIQUE,
    Course,
    DevicePath,
    amplification,
    force_error,
    in_a_hand,
    recorded_path,
    replayed,
)
from tissue.haptics.proxy.held_tool import PressingTool

TICKS = 3000
FIRST = 200
"""First tick in contact of the made-up runs."""


@pytest.fixture(scope="module")
def wall():
    """Wall touched by a hand, and the path of the device."""
    scene = in_a_hand(load_scene("wall"), seed=3, seconds=0.5)
    return scene, recorded_path(scene)


@pytest.fixture(scope="module")
def reference(wall):
    """Replay of the path as it is."""
    return replayed(*wall)


def course(tips_m, forces_N):
    """Made-up run in contact from `FIRST` on."""
    return Course(tips_m, forces_N, np.arange(TICKS) >= FIRST)


@pytest.mark.slow
def test_a_path_that_is_replayed_twice_gives_the_same_bits(wall, reference):
    first, second = reference, replayed(*wall)
    assert np.array_equal(first.tips_m, second.tips_m) and first.touches.any()
    assert np.array_equal(first.forces_N, second.forces_N) and first.mass_kg is None


def test_a_free_tool_follows_a_shift_and_a_wall_does_not_amplify_it(wall, reference):
    scene, path = wall
    moved = replayed(scene, path.shifted(1e-6 * OBLIQUE))
    free = slice(0, reference.first)
    shift = moved.tips_m[free] - reference.tips_m[free]
    np.testing.assert_allclose(shift, np.broadcast_to(1e-6 * OBLIQUE, shift.shape), atol=1e-12)
    later, largest = amplification(moved, reference, 1e-6)
    assert later <= largest == pytest.approx(1.0, abs=1e-4)
    # The stiffness of the contact times a shift of 1 um is below 0.01 N.
    assert 0.0 < force_error(moved, reference) < 0.01


def test_the_recorded_path_is_the_true_one(wall):
    _, path = wall
    assert np.linalg.norm(OBLIQUE) == pytest.approx(1.0)
    step_m = 5.5e-5
    on_grid = np.abs(path.positions_m - step_m * np.round(path.positions_m / step_m))
    # Positions read by encoders would lie on the grid.
    assert on_grid.max() > 0.4 * step_m and on_grid.max() <= 0.5 * step_m * (1.0 + 1e-9)


def test_amplification_of_the_first_second_and_of_the_whole_run():
    tips = np.zeros((TICKS, 3))
    moved = tips.copy()
    moved[FIRST + 1000, 1] = 3e-6
    moved[FIRST + 1001, 0] = -5e-6
    forces = np.ones((TICKS, 3))
    found = amplification(course(moved, forces), course(tips, forces), 1e-6)
    assert found == pytest.approx((3.0, 5.0))


def test_force_error_counts_ticks_in_contact_in_either_run():
    tips = np.zeros((TICKS, 3))
    forces = np.tile((0.0, 3.0, 4.0), (TICKS, 1))
    other = 1.1 * forces
    other[:FIRST] = 1e3
    late = Course(tips, other, np.arange(TICKS) >= FIRST + 50)
    assert force_error(late, course(tips, forces)) == pytest.approx(0.1)


def test_a_run_without_contact_is_refused():
    free = Course(np.zeros((5, 3)), np.zeros((5, 3)), np.zeros(5, dtype=bool))
    with pytest.raises(InputError, match="duration_s"):
        amplification(free, free, 1e-9)


def test_the_mass_of_a_tool_is_scaled_before_the_first_tick(wall, monkeypatch):
    scene, path = wall
    seen = []
    follow = PressingTool.follow

    def weighed(self, *given):
        seen.append(self.mass_kg)
        return follow(self, *given)

    monkeypatch.setattr(PressingTool, "mass_kg", 0.2, raising=False)
    monkeypatch.setattr(PressingTool, "follow", weighed)
    assert replayed(scene, path).mass_kg == 0.2
    whole = set(seen)
    seen.clear()
    light = replayed(scene, DevicePath(path.positions_m, path.quaternions), mass_share=1e-4)
    assert whole == {0.2} and set(seen) == {light.mass_kg} == {0.2 * 1e-4}
