"""Cost that a page in a browser adds to the ticks of a live run.

Run: ``python tests/bench/bench_page.py``.

A scripted motion runs against the wall clock with its page open, twice over: in every second second
the client takes pictures as fast as they come, in those between it takes none, so that both are
measured in one run on one machine with one load. The client decodes nothing; a browser on the same
machine takes more. A run without any page is the third row.
"""

import asyncio
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402

from tissue import load_scene, simulate  # noqa: E402
from tissue.simulation.live.run import LiveObserver  # noqa: E402
from tissue.simulation.live.window import Page  # noqa: E402
from tissue.simulation.observer import WallClock  # noqa: E402
from tissue.simulation.simulate import TICK_S  # noqa: E402

SCENES = {"wall": {"device": "none"}, "milling": {"voxels.spacing_mm": 0.2}, "glenoid": {}}
DURATION_S = 20.0
EDGE_S = 0.2
"""Of each second, what is left aside: a picture that was begun in the one before."""
SIZE = {"do": "size", "wide": 840, "tall": 670}


class Timed(LiveObserver):
    """A live run that notes when each tick ended, with a page or without."""

    def __init__(self, scene, page):
        super().__init__(scene, None, WallClock(TICK_S))
        self._page, self.ended_s = page, []

    def on_begin(self, parts, columns):
        super().on_begin(parts, columns)
        if self._page is not None:
            self._window = self._page.show(self._scene, parts, columns)

    def on_tick(self, index, row, times):
        self.ended_s.append(time.time())
        return super().on_tick(index, row, times)


async def take(address):
    """Take pictures in every second second; how many came is printed."""
    import aiohttp

    home, token = address.split("/?token=")
    socket, count = f"{home.replace('http', 'ws')}/socket?token={token}", 0
    async with (
        aiohttp.ClientSession() as client,
        client.ws_connect(socket, headers={"Origin": home}) as page,
    ):
        await page.send_json(SIZE)
        async for message in page:
            if message.type is aiohttp.WSMsgType.BINARY:
                count += 1
                while int(time.time()) % 2:
                    await asyncio.sleep(0.01)
                with suppress(ConnectionError):  # the run has ended
                    await page.send_json({"do": "seen"})
    print(count)


def measured(scene, page):
    """Return tick durations and completion times [us], and masks of ticks with or without pictures.

    Completion is counted from the time at which the tick was due.
    """
    observer = Timed(scene, page)
    run = simulate(scene, observer=observer, cores=max((os.cpu_count() or 2) - 1, 1))
    ended = np.array(observer.ended_s)
    whole = (ended % 1.0 > EDGE_S) & (ended > ended[0] + 1.0)
    drawn = ended.astype(int) % 2 == 0
    took, late = run.timing["tick_us"], run.timing["late_us"]
    return took, took + late, whole & drawn, whole & ~drawn


def line(name, took, done):
    """Median and 99th percentile of a tick and of when it was done after it was due."""
    ends = [f"{np.median(each):.0f} / {np.percentile(each, 99):.0f}" for each in (took, done)]
    return f"{name}: {ends[0]}; {ends[1]}; {100.0 * np.mean(done > 1000.0):.1f} %"


def main():
    """Measure and print a table."""
    print("scene, page: tick; done after it was due (median / 99 % us); missed; load", flush=True)
    for name, changes in SCENES.items():
        scene = load_scene(name, changes | {"duration_s": DURATION_S})
        clients = []

        def opened(address, clients=clients):
            clients.append(
                subprocess.Popen(
                    [sys.executable, __file__, address], stdout=subprocess.PIPE, text=True
                )
            )

        page = Page(opened)
        try:
            took, done, drawn, still = measured(scene, page)
        finally:
            page.close()
        pictures = clients[0].communicate(timeout=60)[0].strip()
        print(line(f"{name}, pictures", took[drawn], done[drawn]))
        print(line(f"{name}, open without pictures", took[still], done[still]))
        ratio = [
            np.percentile(each[drawn], 99) / np.percentile(each[still], 99) for each in (took, done)
        ]
        print(
            f"{name}: 99 % with pictures over without, tick {ratio[0]:.2f}, done "
            f"{ratio[1]:.2f}; {pictures} pictures"
        )
        took, done, *parts = measured(scene, None)
        both = parts[0] | parts[1]
        print(
            f"{line(f'{name}, no page', took[both], done[both])}; load {os.getloadavg()[0]:.1f}",
            flush=True,
        )


if __name__ == "__main__":
    if len(sys.argv) > 1:
        asyncio.run(take(sys.argv[1]))
    else:
        main()
