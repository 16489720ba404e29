"""The window of `tissue run --live`, run by ``python -m tissue.viewer.live.live_window FOLDER`` in a process."""

import json
import os
import signal
import sys
from pathlib import Path
from time import perf_counter, sleep

import numpy as np

from tissue.figures.style import layer_colours
from tissue.figures.tool_mesh import tool_surface
from tissue.scene.scene import Scene
from tissue.simulation.live.shared import SharedArrays
from tissue.viewer.camera import aim
from tissue.viewer.live.pointer import HELP, Pointer
from tissue.viewer.live.tissue_shown import live_tissue
from tissue.viewer.live.tool_shown import LiveTool
from tissue.viewer.plotter import Plotter
from tissue.viewer.run import faces_of

__all__ = ["LiveWindow"]

SIZE = (1100, 800)
FRAME_S = 1.0 / 30.0
"""Time between two frames [s]."""
TISSUE_S = 0.2
"""Least time between two updates of the tissue [s]; one that took long is followed by a rest as long as itself."""
MARGINS = (0.08, 0.86, 0.1, 0.84)
"""Left, right, lower and upper end of the area for the scene, in shares of the window."""
NICE = 5
"""On a busy machine the ticks come first."""


class LiveWindow:
    """A scene while it runs: tissue, tool, force and words, and the pointer that moves the tool.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.window.WindowProcess` has filled.

    Attributes
    ----------
    plotter
        PyVista's plotter.
    pointer, tool, tissue
        Its parts; ``tissue`` is None for one that does not change.
    """

    def __init__(self, folder: Path) -> None:
        import pyvista

        self.arrays = SharedArrays(folder)
        with np.load(folder / "start.npz", allow_pickle=False) as file:
            start = dict(file)
        scene = Scene.model_validate_json((folder / "scene.json").read_text("utf-8"))
        columns = tuple(json.loads((folder / "columns.json").read_text("utf-8")))
        self.plotter: Plotter = pyvista.Plotter(window_size=list(SIZE), title=f"tissue: {scene.name}, live")
        self.plotter.background_color = pyvista.Color("white")
        self.tissue = live_tissue(self.plotter, start, self.arrays)
        faces = faces_of(scene)
        colours = layer_colours(tuple(faces))
        for name, face in faces.items():
            self.plotter.add_mesh(face, color=colours[name], opacity=0.6, show_edges=name == "wall", edge_color="white")
        low, high = 1e3 * start["low_m"], 1e3 * start["high_m"]
        seen = [1e3 * start["start_m"][None], *(np.asarray(face.points) for face in faces.values())]
        if self.tissue is not None:
            seen.append(self.tissue.points_mm)
        points = np.vstack(seen)
        size = float(np.linalg.norm(np.ptp(points, axis=0)))
        self.tool = LiveTool(self.plotter, tool_surface(scene.tool), columns, size_mm=size)
        for row, line in enumerate(HELP):
            place = (0.012, 0.1 - 0.025 * row)
            self.plotter.add_text(line, position=place, viewport=True, font_size=9, color="black")
        aim(self.plotter, points, margins=MARGINS)
        self._start, self._axis, self._box = 1e3 * start["start_m"], start["axis"], (low, high)
        self._updated, self._took = 0.0, 0.0

    def open(self) -> None:
        """Open the window and take the mouse."""
        self.plotter.show(interactive_update=True, auto_close=False)
        low, high = self._box
        self.plotter.iren.clear_key_event_callbacks()
        self.pointer = Pointer(self.plotter, self._start, self._axis, low_mm=low, high_mm=high)
        self.plotter.iren.interactor.AddObserver("ExitEvent", self._close)
        self._sent_mm = self._start.copy()

    @property
    def over(self) -> bool:
        """Whether the ticks have ended or a person has closed the window."""
        return bool(self.arrays["ended"][0] or self.arrays["closed"][0])

    def frame(self) -> None:
        """Take the events that have come, send the pointer, and draw what is new."""
        self.plotter.iren.interactor.ProcessEvents()
        if self.pointer.ended:
            self._close()
        if self.over:
            return
        if not np.array_equal(self._sent_mm, self.pointer.target_mm):
            self._sent_mm = self.pointer.target_mm
            self.arrays.write("pointer", self._sent_mm)
        message = self.arrays.read("row")
        if message is not None and message[0] > 0:
            self.tool.show(message[1], self.pointer.target_mm)
        now = perf_counter()
        if self.tissue is not None and now - self._updated > max(TISSUE_S, 2.0 * self._took):
            self.tissue.update()
            self._updated, self._took = now, perf_counter() - now
        self.plotter.render()
        self.arrays["frames"][0] += 1

    def run(self) -> None:
        """Frame after frame until it is over."""
        while not self.over:
            began = perf_counter()
            self.frame()
            sleep(max(FRAME_S - (perf_counter() - began), 0.002))
        self.plotter.close()

    def _close(self, *_: object) -> None:
        self.arrays["closed"][0] = 1


def _main(folder: str) -> None:
    """Open the window, report it on the standard output, and run it until the ticks or a person end it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the ticks decide when it ends
    if hasattr(os, "nice"):
        os.nice(NICE)
    os.environ.setdefault("LP_NUM_THREADS", "1")  # OpenGL in software would take every core from the ticks
    standard_output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    window = LiveWindow(Path(folder))
    window.open()
    window.frame()
    print("ready", file=standard_output, flush=True)
    window.run()


if __name__ == "__main__":
    _main(*sys.argv[1:])
