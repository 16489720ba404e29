"""Cost that publishing a live run for 3D Slicer adds to its ticks.

Run: ``python tests/bench/bench_slicer.py``.

The scripted motion runs against the wall clock in three forms: without the link, with the link and
no client, and with a client. The client is a process of its own that takes everything and asks for
the force. The forms run in turn, so that other work on the machine affects all alike. The work of
each tick for the link, copying a row and a slice of the bone, is timed by itself. The load of the
machine is printed, because lateness is caused as much by other work as by ours.
"""

import os
import subprocess
import sys
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from tissue import load_scene  # noqa: E402
from tissue.simulation.live.publisher import SlicerLink, SlicerProcess  # noqa: E402
from tissue.simulation.live.run import LiveSettings, live  # noqa: E402

SCENES = {"wall": 2.0, "milling": 3.0, "liver-press": 2.0}
TURNS = 3
CLIENT = """
import socket, sys, time
from tissue.links.igtl_messages import packed
host, port = sys.argv[1].split(":")
connection = socket.create_connection((host, int(port)))
for kind in ("STT_SENSOR", "STT_NDARRAY"):
    connection.sendall(packed(kind, "", b"", time_s=0.0))
print("ready", flush=True)
began, size, held, kinds = time.perf_counter(), 0, bytearray(), {}
while piece := connection.recv(1 << 20):
    held += piece
    while len(held) >= 58 and len(held) >= 58 + int.from_bytes(held[42:50], "big"):
        end = 58 + int.from_bytes(held[42:50], "big")
        kind = held[2:14].rstrip(b"\\0").decode()
        kinds[kind] = kinds.get(kind, 0) + 1
        size += end
        del held[:end]
took = time.perf_counter() - began
print(f"{sum(kinds.values()) / took:.0f} messages/s, {1e-6 * size / took:.2f} MB/s: {kinds}")
"""


class Reader:
    """A client in a process of its own."""

    def __init__(self):
        self._child = None

    def __call__(self, address):
        """Connect before the first tick."""
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-c", CLIENT, address]
        self._child = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        self._child.stdout.readline()

    def read(self):
        """Return the counts that the child process printed."""
        return self._child.communicate()[0].strip()


def timed(took_us):
    """Let every tick's part in publishing be timed [us]."""
    show = SlicerProcess.show

    def shown(self, index, row, clock):
        began = perf_counter()
        show(self, index, row, clock)
        took_us.append(1e6 * (perf_counter() - began))

    SlicerProcess.show = shown


def main():
    """Measure and print a table."""
    took_us = []
    timed(took_us)
    names = sys.argv[1:] or SCENES
    os.environ.pop("DISPLAY", None)
    print(
        "scene, link: tick, late (median / 99 % us, of all turns); missed; ratio of the "
        "tick's 99 %; load"
    )
    for name in names:
        duration_s = SCENES[name]
        took_us.clear()
        found = {"none": [], "no client": [], "a client": []}
        counted = ""
        for _ in range(TURNS):
            for kind, timings in found.items():
                reader = Reader() if kind == "a client" else None
                link = None if kind == "none" else SlicerLink(port=0, opened=reader)
                run = live(load_scene(name, {"duration_s": duration_s}), LiveSettings(slicer=link))
                timings.append(np.column_stack([run.timing["tick_us"], run.timing["late_us"]]))
                if reader is not None:
                    counted = reader.read()
        alone = np.percentile(np.vstack(found["none"])[:, 0], 99)
        for kind, timings in found.items():
            tick, late = np.vstack(timings).T
            p99 = np.percentile(tick, 99)
            missed = 100.0 * np.mean(tick + late > 1000.0)
            print(
                f"{name}, {kind}: {np.median(tick):.0f} / {p99:.0f}; {np.median(late):.0f} / "
                f"{np.percentile(late, 99):.0f}; "
                f"{missed:.1f} %; {p99 / alone:.2f}; {os.getloadavg()[0]:.1f}",
                flush=True,
            )
        show = f"{np.median(took_us):.1f} / {np.percentile(took_us, 99):.1f} us"
        print(f"{name}, in each tick: {show}; last client: {counted}", flush=True)


if __name__ == "__main__":
    main()
