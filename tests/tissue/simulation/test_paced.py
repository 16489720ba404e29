"""A run that a real device moves follows the wall clock; another observer goes along as before."""

from time import perf_counter

import pytest
from device_doubles import Recording

from tissue import load_scene, simulate
from tissue.haptics.device.safe_device import SafeDevice
from tissue.simulation.observer import Paced

SECONDS = 0.3


class Real(Recording):
    """A device that follows the wall clock."""

    real_time = True

    def __init__(self):
        super().__init__()
        self.read_s = []

    def read(self, time_s):
        self.read_s.append((time_s, perf_counter()))
        return super().read(time_s)


@pytest.mark.parametrize("held", [False, True])
def test_no_tick_of_a_real_device_comes_before_it_is_due(held):
    device, ticks = Real(), []
    scene = load_scene("wall", {"duration_s": SECONDS})
    if held:
        with SafeDevice(device) as safe:
            run = simulate(scene, device=safe, on_tick=lambda tick, row: ticks.append(tick))
    else:
        run = simulate(scene, device=device, on_tick=lambda tick, row: ticks.append(tick))
    assert ticks == list(range(len(run.trace.rows)))
    first = device.read_s[0][1]
    assert all(wall_s - first >= time_s - 2e-3 for time_s, wall_s in device.read_s)
    assert any(
        words in run.summary["notes"]["priority"]
        for words in ("priority", "niceness", "quality of service")
    )


class Skipping:
    """A clock that is late once."""

    skipped_s = 0.0

    def wait(self, index):
        self.skipped_s = 0.25 if index == 3 else 0.0


def test_what_the_clock_skipped_is_reported():
    paced = Paced()
    paced._clock = Skipping()
    for index in range(6):
        paced.before_tick(index)
        assert paced.on_tick(index, None, None)
    assert paced.on_end() == [
        (
            0.0,
            (
                "the ticks were 0.25 s behind the wall clock in all, which skipped it: the "
                "device was played later than that"
            ),
        )
    ]
    assert Paced().on_end() == [] and Paced().timing_columns == ()
