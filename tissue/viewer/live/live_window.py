"""The window of `tissue run --live`, run by ``python -m tissue.viewer.live.live_window FOLDER`` in a process."""

import json
import os
import signal
import sys
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tissue.figures.style import layer_colours
from tissue.figures.tool_mesh import turning_tool
from tissue.scene.scene import Scene
from tissue.simulation.live.shared import SharedArrays
from tissue.viewer.camera import aim
from tissue.viewer.live.pointer import HELP, Pointer
from tissue.viewer.live.tissue_shown import live_tissue
from tissue.viewer.plotter import Plotter
from tissue.viewer.run import faces_of
from tissue.viewer.tool import ToolShown

if TYPE_CHECKING:
    import pyvista

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
DEVICE = "#D55E00"
LEAST_N = 1.0
"""Force that is drawn as the longest arrow until there is a greater one."""


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
        self.tool = LiveTool(self.plotter, turning_tool(scene.tool), columns, size_mm=size)
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


class LiveTool:
    """Tool, mark of the device, force and words of the newest row.

    Parameters
    ----------
    plotter
        Where they are shown.
    tool
        Surface of the tool in its own frame [mm], or None.
    columns
        Names of the values of a row: those of the trace, then `tissue.simulation.live.window.CLOCK`.
    size_mm
        Size of what is seen [mm].
    """

    def __init__(
        self, plotter: Plotter, tool: "pyvista.PolyData | None", columns: tuple[str, ...], *, size_mm: float
    ) -> None:
        import pyvista

        self._at = {name: index for index, name in enumerate(columns)}
        look = {"reset_camera": False, "render": False}
        mark = pyvista.Sphere(radius=0.008 * size_mm)
        self._mark = plotter.add_mesh(mark, color=DEVICE, **look)
        self._spring_mesh = pyvista.Line((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        self._spring = plotter.add_mesh(self._spring_mesh, color=DEVICE, line_width=3, **look)
        self._tool = ToolShown(plotter, tool, longest_mm=0.25 * size_mm, opacity=0.5)
        self._greatest = LEAST_N
        self._words = plotter.add_text("", position=(0.012, 0.93), viewport=True, font_size=11, color="black")
        self._clock = plotter.add_text("", position=(0.012, 0.895), viewport=True, font_size=9, color="black")

    def show(self, row: NDArray[np.float64], target_mm: NDArray[np.float64]) -> None:
        """Show a row, and where the pointer wants the tool [mm]."""
        of = lambda *names: row[[self._at[name] for name in names]]  # noqa: E731
        tip, turn = of(*(f"tool_{c}_mm" for c in "xyz")), of(*(f"tool_q{c}" for c in "xyzw"))
        if not turn.any():
            return
        self._mark.position = tuple(target_mm)
        self._spring_mesh.points = np.stack([tip, target_mm])
        force = of(*(f"model_force_{c}_N" for c in "xyz"))
        self._greatest = max(self._greatest, float(np.linalg.norm(force)))
        shown = self._tool.show(tip, turn, force, greatest_N=self._greatest)
        words = [f"{of('time_s')[0]:.2f} s: {shown}"]
        if "device_force_x_N" in self._at:
            played = float(np.linalg.norm(of(*(f"device_force_{c}_N" for c in "xyz"))))
            words.append(f"at the device {played:.2f} N")
        removed = float(of("removed_mm3")[0])
        if removed > 0.0:
            words.append(f"removed {removed:.2f} mm³")
        self._words.input = ", ".join(words)
        took, late, missed, skipped = of("tick_us", "late_us", "missed", "skipped_ms")
        clock = f"tick {took:.0f} µs, {late:.0f} µs late; {missed:.0f} deadlines of 1 ms missed"
        self._clock.input = f"{clock}, {skipped:.0f} ms skipped" if skipped > 0.0 else clock


if __name__ == "__main__":
    _main(*sys.argv[1:])
