"""Laws of the wall clock that a live run keeps."""

from unittest.mock import patch

import numpy as np
import pytest

from tissue.simulation import observer
from tissue.simulation.observer import WallClock

STEP_S = 1e-3


class FakeTime:
    """Clock that advances by a microsecond per reading, and a sleep that ends late."""

    def __init__(self, oversleeps_s=6e-5):
        self.s, self._over = 100.0, oversleeps_s

    def now(self):
        self.s += 1e-6
        return self.s

    def rest(self, seconds):
        self.s += seconds + self._over


def paced(costs_s, **options):
    """Starts of ticks after the first [s], lateness and skips [s], for ticks that take so long."""
    fake = FakeTime(**{k: v for k, v in options.items() if k == "oversleeps_s"})
    clock = WallClock()
    rows = []
    with patch.multiple(observer, perf_counter=fake.now, sleep=fake.rest):
        for index, cost in enumerate(costs_s):
            clock.wait(index)
            rows.append((fake.s, clock.late_s, clock.skipped_s))
            fake.s += cost
    starts, late, skipped = np.array(rows).T
    return starts - starts[0], late, skipped


def test_a_paced_run_does_not_drift():
    rng = np.random.default_rng(1)
    starts, late, skipped = paced(rng.uniform(1e-4, 8e-4, 3000))
    # The last tick begins when it is due: a schedule that added up sleeps would be 3000 times their
    # 60 us late. looks at the clock take 1 us
    np.testing.assert_allclose(starts, STEP_S * np.arange(3000), atol=3e-6)
    assert late.max() < 3e-6 and not skipped.any()


def test_one_long_tick_makes_the_next_ones_late_and_then_it_is_on_time_again():
    costs = np.full(60, 2e-4)
    costs[10] = 5e-3
    starts, late, skipped = paced(costs)
    assert late[11] == pytest.approx(4e-3, abs=1e-5) and late[12] == pytest.approx(3.2e-3, abs=1e-5)
    assert (late[11:16] > 1e-4).all() and (late[17:] < 5e-6).all()
    assert not skipped.any() and starts[-1] == pytest.approx(59 * STEP_S, abs=5e-6)


@pytest.mark.parametrize("cost_s", [1.3e-3, 2.5e-3, 0.05])
def test_a_run_that_cannot_keep_up_skips_on_the_wall_and_counts_it(cost_s):
    starts, late, skipped = paced(np.full(400, cost_s))
    # No tick is left out and none is stretched: what the wall has more than the schedule is what
    # was skipped.
    assert starts[-1] == pytest.approx(399 * cost_s, rel=1e-3)
    assert starts[-1] - 399 * STEP_S == pytest.approx(
        skipped.sum() + late[-1] * (skipped[-1] == 0.0), abs=1e-4
    )
    assert late.max() < 0.01 + cost_s and (late[skipped > 0.0] > 0.01).all()
