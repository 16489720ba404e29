"""Soak test of Haply's adapter against the stand-in service.

It reports memory, lost ticks, samples and exchanges over minutes.

``python tests/bench/bench_haply_soak.py --minutes 30``. The stand-in runs in a process of its own;
this one runs what holds a device in a run, without a trace, which grows by design: wall clock,
samples judged, the force of a wall, mapping, adapter. Each minute a row is printed.
"""

import argparse
import gc
import sys
from pathlib import Path
from time import perf_counter

import numpy as np
import psutil

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "fixtures")]

from haply_service import RemoteService  # noqa: E402

from tissue.haptics.device.safe_device import SafeDevice  # noqa: E402
from tissue.haptics.device.sample_guard import SampleGuard  # noqa: E402
from tissue.haptics.real.haply import HaplyAdapter  # noqa: E402
from tissue.haptics.real.mapped import MappedDevice  # noqa: E402
from tissue.scene.hardware import Hardware  # noqa: E402
from tissue.simulation.observer import WallClock  # noqa: E402
from tissue.system.tick_priority import TickPriority  # noqa: E402

TICK_S = 1e-3
STIFFNESS_N_M = 700.0
DEEP_M = 0.02
"""Depth of the wall's face below the start position [m]."""
WARM_S = 60.0
"""Time after which memory is compared: buffers and lists of bounded length are then full [s]."""


class Soak:
    """The ticks of a device without a tissue, and what is counted of them."""

    def __init__(self, held, limits):
        self.held, self.guard = held, SampleGuard(force_limit_N=limits.force_limit_N)
        self.clock, self.tick = WallClock(TICK_S), 0
        self.late_s = np.ones(60_000)  # written once before memory is compared
        self.skipped_s, self.missing, self.pressed = 0.0, 0, 0

    def minute(self, seconds):
        """Ticks for so long; lateness of each [s]."""
        for step in range(round(seconds / TICK_S)):
            self.clock.wait(self.tick)
            self.late_s[step], self.skipped_s = (
                self.clock.late_s,
                self.skipped_s + self.clock.skipped_s,
            )
            time_s = TICK_S * self.tick
            sample = self.guard.validate_sample(self.held.read(time_s), time_s)
            self.missing += sample is None
            force = (
                None
                if sample is None
                else np.array([0.0, 0.0, -STIFFNESS_N_M * min(sample.position_m[2], 0.0)])
            )
            played, _ = self.held.play(*self.guard.limit_force(force))
            self.pressed += bool(played[2] > 0.0)
            self.tick += 1
        return self.late_s[: round(seconds / TICK_S)]


def main():
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=30.0)
    minutes, process = options.parse_args().minutes, psutil.Process()
    with RemoteService(press_m=0.03) as service:
        device = MappedDevice(
            HaplyAdapter(Hardware(address=service.url)), Hardware(), start_m=(0.0, 0.0, DEEP_M)
        )
        began, sent = perf_counter(), 0
        with SafeDevice(device, limits=device.limits) as held:
            soak, priority = Soak(held, device.limits), TickPriority()
            priority.begin()  # as a run has it
            soak.minute(WARM_S)
            np.percentile(soak.late_s, [50, 99, 100])
            gc.collect()
            first = process.memory_info().rss
            print(
                "minute  memory kB  late ms, median 99 % most  skipped ms  ticks without "
                "sample  pressed %  load"
            )
            for minute in np.arange(1, np.ceil(minutes) + 1):
                soak.skipped_s, soak.missing, soak.pressed = 0.0, 0, 0
                seconds = 60.0 * min(1.0, minutes - minute + 1)
                late = 1e3 * np.percentile(soak.minute(seconds), [50, 99, 100])
                grown = (process.memory_info().rss - first) / 1e3
                share = 100.0 * soak.pressed / (seconds / TICK_S)
                print(
                    f"{minute:6.0f}  {grown:+9.0f}  {late[0]:8.3f} {late[1]:6.2f} {late[2]:6.1f}  "
                    f"{1e3 * soak.skipped_s:10.1f}  {soak.missing:10d}  {share:18.1f}  "
                    f"{psutil.getloadavg()[0]:5.1f}",
                    flush=True,
                )
            priority.end()
            sent = service.get("sent")
        greatest, last = service.get("greatest_N"), service.commands()[-1][2]
    print(
        f"{soak.tick} ticks in {perf_counter() - began:.1f} s, {sent} frames, greatest force "
        f"{greatest:.2f} N"
    )
    print(f"last force {last} N; {[what for _, what in held.happened() + soak.guard.events][-5:]}")


if __name__ == "__main__":
    main()
