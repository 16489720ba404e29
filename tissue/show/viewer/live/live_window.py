"""Window of `tissue run --live`.

Run as ``python -m tissue.show.viewer.live.live_window FOLDER`` in a separate process.
"""

import sys
from pathlib import Path
from time import perf_counter, sleep

import numpy as np

from tissue.show.viewer.live.live_scene import HELP, LiveScene, Pointer, Readings
from tissue.show.viewer.plotter import add_names, add_text, in_words
from tissue.system.child import own_process

SIZE = (1100, 800)
FRAME_S = 1.0 / 30.0
"""Time between two frames [s]."""
MARGINS = (0.08, 0.86, 0.1, 0.84)
"""Left, right, lower and upper end of the area for the scene, in shares of the window."""


class LiveWindow:
    """Window of a live run: tissue, tool, force and readings, and the pointer that moves the tool.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.window.WindowProcess` has filled.

    Attributes
    ----------
    shown, pointer
        Scene in the window, and requested position of the tool.
    plotter
        Plotter of PyVista.
    """

    def __init__(self, folder: Path) -> None:
        self.shown = LiveScene(folder, size_px=SIZE, margins=MARGINS)
        self.plotter = self.shown.plotter
        self.arrays = self.shown.arrays
        add_names(self.plotter, self.shown.colours)
        # shares of the window: help in the lower left corner, readings in the upper left one
        for row, line in enumerate(HELP):
            add_text(self.plotter, line, (0.012, 0.1 - 0.025 * row))
        self._words = add_text(self.plotter, "", (0.012, 0.93), size=11)
        self._clock = add_text(self.plotter, "", (0.012, 0.895))

    def open(self) -> None:
        """Open the window, and connect the mouse."""
        self.plotter.show(interactive_update=True, auto_close=False)
        self.plotter.iren.clear_key_event_callbacks()
        self.pointer = Pointer(self.plotter, **self.shown.target_options)
        self.plotter.iren.interactor.AddObserver("ExitEvent", self._close)
        self._sent_mm = self.pointer.target_mm

    @property
    def over(self) -> bool:
        """True if the simulation has ended or the user has closed the window."""
        return bool(self.arrays["ended"][0] or self.arrays["closed"][0])

    def frame(self) -> None:
        """Process pending events, send the position of the pointer, and draw all changes."""
        self.plotter.iren.interactor.ProcessEvents()
        if self.pointer.ended:
            self._close()
        if self.over:
            return
        if not np.array_equal(self._sent_mm, self.pointer.target_mm):
            self._sent_mm = self.pointer.target_mm
            self.arrays.write("pointer", self._sent_mm)
        readings = self.shown.show(self.pointer.target_mm)
        if readings is not None:
            self._write(readings)
        self.shown.update_tissue()
        self.plotter.render()
        self.arrays["frames"][0] += 1

    def run(self) -> None:
        """Update the window frame by frame until `over` is True."""
        while not self.over:
            began = perf_counter()
            self.frame()
            # 2 ms for the ticks on the same cores even where drawing takes all of the time
            sleep(max(FRAME_S - (perf_counter() - began), 0.002))
        self.plotter.close()

    def _write(self, read: Readings) -> None:
        """Show force, removed volume and lateness as text."""
        numbers = read.numbers
        size = float(np.linalg.norm(read.force_N))
        words = [f"{numbers['time_s']:.2f} s: force {size:.2f} N ({in_words(read.force_N)})"]
        if read.device_N is not None:
            words.append(f"at the device {read.device_N:.2f} N")
        if numbers["removed_mm3"] > 0.0:
            words.append(f"removed {numbers['removed_mm3']:.2f} mm³")
        self._words.input = ", ".join(words)
        clock = (
            f"tick {numbers['tick_us']:.0f} µs, {numbers['late_us']:.0f} µs late; "
            f"{numbers['missed']:.0f} deadlines of 1 ms missed"
        )
        if numbers["skipped_ms"] > 0.0:
            clock += f", {numbers['skipped_ms']:.0f} ms skipped"
        self._clock.input = clock

    def _close(self, *_: object) -> None:
        self.arrays["closed"][0] = 1


def _main(folder: str) -> None:
    """Open the window, report this on standard output, and run the window until the end.

    The window ends when the simulation ends or the user closes it.
    """
    standard_output = own_process(beside_ticks=True)
    window = LiveWindow(Path(folder))
    window.open()
    window.frame()
    print("ready", file=standard_output, flush=True)
    window.run()


if __name__ == "__main__":
    _main(*sys.argv[1:])
