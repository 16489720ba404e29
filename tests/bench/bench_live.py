"""Live runs of one motion with and without a window: ``python tests/bench/bench_live.py``.

The scripted motion, or the hand of the scene, runs against the wall clock twice, so that all that differs is the window,
which is opened on a virtual display (Xvfb) that draws in software. The load of the machine is printed: lateness is as much
its other work's as ours.
"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from tissue import load_scene, simulate  # noqa: E402
from tissue.simulation.live.clock import WallClock  # noqa: E402
from tissue.simulation.live.run import LiveObserver  # noqa: E402
from tissue.simulation.live.window import WindowProcess  # noqa: E402
from tissue.simulation.simulate import TICK_S  # noqa: E402

SCENES = ("wall", "glenoid", "liver-press")
DISPLAY = ":93"


class ShownOnly(LiveObserver):
    """A live run whose window only watches."""

    def on_begin(self, parts, columns):
        super().on_begin(parts, columns)
        corners = parts.motion.sweep_m()
        low, high = corners.min(axis=0), corners.max(axis=0)
        self._window = WindowProcess(self._scene, parts, columns, low_m=low, high_m=high)


def main():
    """Measure and print a table."""
    server = None
    observers = [("none", LiveObserver)]
    if shutil.which("Xvfb") is not None:
        screen = ["-screen", "0", "1300x900x24", "-nolisten", "tcp", "-noreset"]
        server = subprocess.Popen(["Xvfb", DISPLAY, *screen], stderr=subprocess.DEVNULL)
        time.sleep(2.0)
        os.environ["DISPLAY"] = DISPLAY
        observers.append(("open", ShownOnly))
    print("scene, window: tick, late (median / 99 % / max us); missed of ticks; skipped ms; load")
    try:
        for name in SCENES:
            for window, kind in observers:
                scene = load_scene(name)
                cores = None if window == "none" else max((os.cpu_count() or 2) - 1, 1)
                run = simulate(scene, observer=kind(scene, None, WallClock(TICK_S)), cores=cores)
                found = run.summary
                tick, late = (
                    " / ".join(f"{each:.0f}" for each in found[key].values()) for key in ("tick_us", "late_us")
                )
                on_time = 100.0 * float(np.mean(run.timing["late_us"] < 100.0))
                print(
                    f"{name}, {window}: {tick}; {late} ({on_time:.0f} % within 100 us); {found['missed_deadlines']} of "
                    f"{len(run.trace.rows)}; {found['skipped_ms']:.0f}; {os.getloadavg()[0]:.1f}",
                    flush=True,
                )
    finally:
        if server is not None:
            server.terminate()


if __name__ == "__main__":
    main()
