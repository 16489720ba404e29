"""Self-test of a device by its own clock.

The tests cover the push that can be felt, and the file that the judge reads.
"""

import math
import tomllib

import numpy as np
import pytest

from tissue.haptics.device.device import device_parameters
from tissue.haptics.real.adapter import HardwareSample
from tissue.haptics.real.self_test import (
    BUMP_N,
    BUMP_S,
    SelfTest,
    Spread,
    bump,
    self_test,
    write_measured,
)
from tissue.materials.scene_constants import Materials


class Clocked:
    """Device and its clock.

    It gives samples at intervals, its calls take time, and it moves under the push.
    """

    limits = device_parameters("network")

    def __init__(
        self, interval_s=2e-3, *, late=(), read_s=1e-5, push_s=3e-5, trip_s=None, lasts_s=1e9
    ):
        self.now, self.read_s, self.push_s, self.lasts_s = 50.0, read_s, push_s, lasts_s
        self.interval, self.late, self.due, self.count = interval_s, late, 50.0, 0
        self.wrenches, self.pushed_at, self.closed, self.height = [], [], 0, 0.0
        if trip_s is not None:
            self.round_trip_s = trip_s

    def clock(self):
        return self.now

    def pause(self, seconds):
        self.now += seconds

    def poll(self):
        self.now += self.read_s
        if self.now < self.due or self.now > 50.0 + self.lasts_s:
            return None
        self.count += 1
        self.due += self.interval * (3.0 if self.count in self.late else 1.0)
        return HardwareSample((0.0, 0.0, self.height))

    def push(self, force_N, torque_Nm):
        self.now += self.push_s
        self.wrenches.append((*force_N, *torque_Nm))
        self.pushed_at.append(self.now)
        self.height += 1e-4 * force_N[2]

    def close(self):
        self.closed += 1


def measured(device, seconds=2.0):
    return self_test(device, seconds=seconds, clock=device.clock, pause=device.pause)


def test_a_steady_device_is_measured_exactly():
    device = Clocked()
    found = measured(device)
    assert found.samples == pytest.approx(1000, abs=1) and found.rate_Hz == pytest.approx(
        500.0, rel=1e-3
    )
    assert found.interval.p99_s == pytest.approx(2e-3, abs=2e-4)
    assert found.longest_s == pytest.approx(2e-3, abs=2e-4)
    assert found.delay == found.call and found.call.median_s == pytest.approx(4e-5, rel=1e-6)
    assert math.isnan(found.round_trip.median_s)
    assert not np.any(device.wrenches)  # nothing but zero is commanded
    assert np.diff(device.pushed_at).mean() == pytest.approx(1e-3, rel=0.1)  # each tick


def test_the_round_trip_of_a_device_that_shows_it_is_its_latency():
    found = measured(Clocked(trip_s=0.004))
    assert found.round_trip == found.delay == (0.004, 0.004)


def test_a_push_rises_and_falls_and_ends_at_zero():
    device = Clocked(1e-3)
    found = bump(device, clock=device.clock, pause=device.pause)
    forces = np.array(device.wrenches)
    assert (
        forces[:, 2].max() == pytest.approx(BUMP_N, rel=1e-3)
        and not forces[:, [0, 1, 3, 4, 5]].any()
    )
    # no step that a hand would feel as a knock
    assert np.abs(np.diff(forces[:, 2])).max() < 0.02 * BUMP_N
    assert forces[0, 2] < 0.01 and not forces[-1].any()
    assert device.pushed_at[-1] - device.pushed_at[0] == pytest.approx(BUMP_S, abs=3e-3)
    assert found.along_m == found.moved_m == pytest.approx(1e-4 * forces[:, 2].sum(), rel=0.01)


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_a_push_that_is_cut_short_ends_at_zero_and_closed(error):
    device = Clocked(1e-3)
    push, device.push = device.push, lambda *wrench: [push(*wrench), device.fail()][0]

    def fail():
        if len(device.wrenches) == 100:
            raise error

    device.fail = fail
    with pytest.raises(error):
        bump(device, clock=device.clock, pause=device.pause)
    assert device.wrenches[99][2] > 0.0 and not any(device.wrenches[-1]) and device.closed == 1


SLOW = SelfTest(
    seconds=2.0,
    samples=400,
    rate_Hz=200.0,
    interval=Spread(5e-3, 8e-3),
    longest_s=0.02,
    call=Spread(5e-5, 1e-4),
    round_trip=Spread(0.006, 0.009),
)


@pytest.mark.parametrize(
    ("changes", "rate", "delay"),
    [
        # our ticks are no faster
        ({"rate_Hz": 4000.0, "interval": Spread(2.5e-4, 3e-4)}, (1000.0, [1000.0, 1000.0]), 0.006),
        # a sample nearly every tick
        ({"rate_Hz": 993.0, "interval": Spread(1e-3, 1.25e-3)}, (1000.0, [800.0, 1000.0]), 0.006),
        ({"rate_Hz": 2.0, "interval": Spread(0.5, 0.6)}, (10.0, [10.0, 10.0]), 0.006),
        ({"round_trip": Spread(0.5, 0.9)}, (200.0, [125.0, 200.0]), 0.2),
        ({"round_trip": Spread(math.nan, math.nan)}, (200.0, [125.0, 200.0]), 5e-5),
    ],
)
def test_what_was_measured_is_brought_within_what_a_device_may_have(tmp_path, changes, rate, delay):
    path = tmp_path / "measured.toml"
    write_measured(path, "network", SelfTest(**(vars(SLOW) | changes)))
    entries = tomllib.loads(path.read_text("utf-8"))["devices"]["network"]
    assert ((entries["rate_Hz"]["value"], entries["rate_Hz"]["range"])) == rate
    assert entries["transport_delay_s"]["value"] == delay
    device_parameters("network", Materials.read(path))
