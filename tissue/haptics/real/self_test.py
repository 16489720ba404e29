"""Self-test of a device: sample rate, jitter, latency, and a perceptible push."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from math import isfinite, nan, pi, sin, sqrt
from pathlib import Path
from time import perf_counter, sleep
from typing import NamedTuple

import numpy as np

from meshes.base.errors import InputError, require_range
from meshes.base.whole_file import write_text
from tissue.haptics.device.device import Reach
from tissue.haptics.real.adapter import HardwareAdapter
from tissue.models.tissue_model import TICK_S

BUMP_N = 0.5
BUMP_S = 0.3
"""Duration of the push [s]; `BUMP_N` is the largest force of the push [N].

The largest force is above the friction of a Touch (0.26 N) and below its continuous force (0.88 N).
"""
FEWEST = 20
"""Smallest number of samples for a valid result.

A device at 10 Hz provides 20 samples in the default duration of 2 s.
"""
PAUSE_S = 5e-5
"""Pause between two reads of the device [s].

The pause is much shorter than a tick, but allows other threads to run.
"""
START_S = 5.0
"""Longest time to wait for the first sample [s]."""


class Spread(NamedTuple):
    """Median and 99th percentile of measured times [s]; nan without a measurement."""

    median_s: float
    p99_s: float


@dataclass(frozen=True, kw_only=True)
class SelfTest:
    """Measurements of a device while zero force is commanded in each tick.

    Attributes
    ----------
    seconds
        Duration of the measurement [s].
    samples, rate_Hz
        Number of new samples, and their rate [Hz].
    interval, longest_s
        Time between two samples, and the longest such time [s].
    call
        Total duration of a read and a command.
    round_trip
        Time from a command to the first sample that confirms it, if the device confirms commands.
    """

    seconds: float
    samples: int
    rate_Hz: float
    interval: Spread
    longest_s: float
    call: Spread
    round_trip: Spread

    @property
    def delay(self) -> Spread:
        """Latency of the device in addition to the zero-order hold.

        The latency is the round trip time if it is known, otherwise the duration of a read and a
        command.
        """
        return self.round_trip if isfinite(self.round_trip.median_s) else self.call


@dataclass(frozen=True)
class Bump:
    """Motion of the handle during a push [m]: along the push, and in total."""

    along_m: float
    moved_m: float


def self_test(
    adapter: HardwareAdapter,
    *,
    seconds: float = 2.0,
    clock: Callable[[], float] = perf_counter,
    pause: Callable[[float], None] = sleep,
) -> SelfTest:
    """Measure sample rate and latency of a device, while zero force is commanded.

    Parameters
    ----------
    adapter
        Adapter of the device, which must be open. If it has the attribute ``round_trip_s``, the
        value is stored with each sample.
    seconds
        Duration of the measurement, from the first sample [s].
    clock, pause
        Function that returns the time [s], and function that waits.

    Raises
    ------
    InputError
        If there are too few samples. `DeviceError` is raised if positions leave the device's reach,
        for example because they are in millimetres.
    """
    require_range("seconds", seconds, 0.1, 600.0, "use a value such as 2")
    zero = np.zeros(3)
    times = list[float]()
    calls = list[float]()
    trips = list[float]()
    end = clock() + START_S
    due = clock()
    reach = Reach(adapter.limits)
    while (before := clock()) < end:
        sample = adapter.poll()
        if (now := clock()) >= due:
            adapter.push(zero, zero)
            due = max(due + TICK_S, now)
            calls.append(clock() - before)
        if sample is not None:
            if not times:
                end = now + seconds
                # The measurement starts with the first sample.
                calls.clear()
            reach.require(sample.position_m)
            times.append(now)
            trips.append(getattr(adapter, "round_trip_s", nan))
        pause(PAUSE_S)
    if len(times) < FEWEST:
        raise InputError(
            "a device",
            f"give at least {FEWEST} samples for its test",
            len(times),
            "check that the device is on, and move it",
        )
    gaps = np.diff(times)
    shown = [each for each in trips if isfinite(each)]
    if len(shown) < FEWEST:
        shown = [nan]
    measured = [np.percentile(each, [50.0, 99.0]).tolist() for each in (gaps, calls, shown)]
    interval, call, round_trip = (Spread(*each) for each in measured)
    return SelfTest(
        seconds=seconds,
        samples=len(times),
        rate_Hz=len(gaps) / (times[-1] - times[0]),
        interval=interval,
        longest_s=float(gaps.max()),
        call=call,
        round_trip=round_trip,
    )


def bump(
    adapter: HardwareAdapter,
    *,
    clock: Callable[[], float] = perf_counter,
    pause: Callable[[float], None] = sleep,
) -> Bump:
    """Push the hand along the device's z axis, with a force that follows half a sine.

    The largest force is `BUMP_N`, and the duration is `BUMP_S`. However the push ends, even by an
    error, the last force is zero.

    Raises
    ------
    InputError
        If there is no sample during the push.
    """
    places = []
    start = clock()
    try:
        while (elapsed := clock() - start) < BUMP_S:
            if (sample := adapter.poll()) is not None:
                places.append(sample.position_m)
            adapter.push(np.array([0.0, 0.0, BUMP_N * sin(pi * elapsed / BUMP_S)]), np.zeros(3))
            pause(TICK_S)
    except BaseException:
        with suppress(Exception):
            adapter.close()
        raise
    finally:
        with suppress(Exception):
            adapter.push(np.zeros(3), np.zeros(3))
    if not places:
        raise InputError(
            "a device",
            "give samples for its test",
            "none during the push",
            "check the cable of the device",
        )
    away = np.array(places) - places[0]
    return Bump(
        float(away[np.abs(away[:, 2]).argmax(), 2]), sqrt(float((away**2).sum(axis=1).max()))
    )


EVERY_TICK = 0.95
"""Share of ticks with a new sample above which the device's rate is set to the tick rate.

The limit is below 1, because on a busy computer some samples are missed, even for a device with a
sample in every tick.
"""
SLOWEST_HZ = 10.0
LONGEST_S = 0.2
"""Largest delay that `tissue.haptics.device.device.DeviceParameters` accepts [s].

`SLOWEST_HZ` is the smallest rate that this class accepts [Hz].
"""


def write_measured(path: Path, name: str, test: SelfTest) -> None:
    """Write the rate and the latency of a device as constants with ranges to a file.

    The rate is the mean rate, or the tick rate if nearly every tick has a new sample. The lower end
    of its range corresponds to the 99th percentile of the time between samples. The latency is the
    round trip, or the duration of the calls if the device does not report a round trip.
    """
    most = 1.0 / TICK_S
    rate = min(max(test.rate_Hz, SLOWEST_HZ), most)
    low = min(max(1.0 / test.interval.p99_s, SLOWEST_HZ), most)
    rate = most if rate >= EVERY_TICK * most else rate
    delay = min(test.delay.median_s, LONGEST_S)
    high = min(max(test.delay), LONGEST_S)
    today = date.today().isoformat()
    by = f"measured by tissue devices --test {name} for {test.seconds:g} s on {today}"
    text = '# Constants of a device: use them in a scene by  materials = "FILE"\n'
    for key, value, least, largest, what in (
        ("rate_Hz", rate, min(low, rate), rate, f"{test.samples} samples"),
        ("transport_delay_s", delay, 0.0, high, "median and 99 %"),
    ):
        text += (
            f"[devices.{name}.{key}]\nvalue = {value:.6g}\nrange = [{least:.6g}, {largest:.6g}]\n"
            f'source = "{by}, {what}"\nconfidence = "M"\n'
        )
    write_text(path, text)
