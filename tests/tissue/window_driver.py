"""Drives the window of `tissue view` as a hand would, in a process of its own: ``window_driver.py RUN OUT``.

It writes what it found as JSON on the last line, and pictures of the window into OUT.
"""

import json
import sys
import time
from pathlib import Path

from tissue.simulation.run_folder import SavedRun
from tissue.viewer.window import Choice, Window


class Hand:
    """Keys and mouse of a window."""

    def __init__(self, window, out):
        self.window, self.out = window, out
        self.interactor = window.plotter.iren.interactor

    def key(self, name, code=None):
        self.interactor.SetKeyEventInformation(0, 0, code or name[0], 0, name)
        self.interactor.KeyPressEvent()
        self.interactor.CharEvent()
        self.interactor.KeyReleaseEvent()

    def at(self, x, y):
        self.interactor.SetEventInformation(int(x), int(y), 0, 0)

    def drag(self, *places):
        self.at(*places[0])
        self.interactor.MouseMoveEvent()
        self.interactor.LeftButtonPressEvent()
        for place in places[1:]:
            self.at(*place)
            self.interactor.MouseMoveEvent()
        self.interactor.LeftButtonReleaseEvent()

    def pixel(self, place_mm):
        """Where a point of the world is seen."""
        renderer = self.window.plotter.renderer
        renderer.SetWorldPoint(*place_mm, 1.0)
        renderer.WorldToDisplay()
        return renderer.GetDisplayPoint()[:2]

    def bounds(self):
        return list(self.window.fields.actor.mapper.dataset.bounds)

    def picture(self, name):
        self.window.plotter.screenshot(str(self.out / f"{name}.png"))

    def work(self, seconds):
        end = time.perf_counter() + seconds
        while time.perf_counter() < end:
            self.interactor.ProcessEvents()
            time.sleep(0.005)


def drive(window, out):
    """Try everything, and tell what came of it."""
    hand, fields, told = Hand(window, out), window.fields, {}
    hand.work(0.2)
    hand.picture("start")
    camera = list(window.plotter.camera.position)
    hand.drag(hand.pixel((0.0, -8.0, -3.0)))
    told["clicked"] = {"reference_mm": list(window.point.reference_mm), "text": window.point.text}
    told["camera_kept"] = camera == list(window.plotter.camera.position)
    hand.picture("picked")
    hand.drag((5, 950 - 400))
    told["beside"] = list(window.point.reference_mm)
    hand.key("m")
    told["after_m"] = fields.name
    wide, tall = window.plotter.window_size
    told["listed"] = []
    for row in range(1, 6):
        hand.drag((0.05 * wide, (0.80 - 0.032 * row + 0.008) * tall))
        told["listed"].append(fields.name)
    hand.key("x")
    told["clipped"] = hand.bounds()
    for _ in range(3):
        hand.key("period", ".")
    told["pushed"] = hand.bounds()
    hand.key("comma", ",")
    told["back"] = hand.bounds()
    middle = hand.pixel(fields.clip[1])
    arrow = hand.pixel([a + 8.0 * n for a, n in zip(fields.clip[1], fields.clip[0], strict=True)])
    hand.drag(arrow, *((arrow[0] + step, arrow[1]) for step in (20, 40, 60)))
    told["turned"] = fields.clip
    hand.drag(middle, (middle[0], middle[1] - 20), (middle[0], middle[1] - 60))
    told["slid"] = fields.clip
    hand.picture("clipped")
    hand.key("x")
    told["closed"] = hand.bounds()
    whole = fields.actor.mapper.dataset.n_cells
    hand.key("2")
    told["hidden"] = [whole, fields.actor.mapper.dataset.n_cells, sorted(window.layers.hidden)]
    hand.picture("hidden")
    hand.key("2")
    fields.enlarge(2.0)
    told["enlarged_mm"] = list(fields.read(window.point.reference_mm).place_mm)
    fields.enlarge(1.0)
    window.playback.to(0.5)
    told["earlier"] = window.point.text
    hand.key("space", " ")
    told["playing"] = window.playback.playing
    hand.work(0.6)
    hand.key("space", " ")
    told["played_to"] = window.playback.time_s
    hand.work(0.2)
    told["paused_at"] = window.playback.time_s
    button = (28, 296)
    hand.drag(button)
    told["button"] = [window.playback.playing]
    hand.drag(button)
    told["button"].append(window.playback.playing)
    window.playback.to(0.999)
    window.playback.switch()
    hand.work(0.3)
    told["end"] = [window.playback.time_s, window.playback.playing]
    hand.picture("end")
    window.plotter.close()
    return told


if __name__ == "__main__":
    import pyvista

    pyvista.global_theme.multi_samples = 1  # drawn in software, smooth edges take half of the time
    run, out = map(Path, sys.argv[1:])
    shown = Window(SavedRun(run), "press", Choice(), off_screen=False)
    show = shown.plotter.show

    def open_and_drive():
        """Open the window without waiting for a person."""
        show(interactive_update=True, auto_close=False)
        print(json.dumps(drive(shown, out)))

    shown.plotter.show = open_and_drive
    shown.open()
