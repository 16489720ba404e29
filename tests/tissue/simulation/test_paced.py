"""A run that a real device moves follows the wall clock; another observer goes along as before."""

from time import perf_counter

import pytest
from device_doubles import Recording

from tissue import load_scene, simulate
from tissue.haptics.device.safe_device import SafeDevice

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
