"""Page of `tissue run --live --web`.

Run as ``python -m tissue.show.viewer.web.live_page FOLDER`` in a separate process.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np

from tissue.show.viewer.live.live_scene import NOTCH_MM, LiveScene, Readings, Target
from tissue.show.viewer.plotter import aim
from tissue.show.viewer.web.server import Values, serve
from tissue.show.viewer.web.stage import Stage
from tissue.simulation.live.window import LOADS

SIZE = (960, 720)
"""Size of the picture until the page reports its own size [pixels]."""
MARGINS = (0.05, 0.95, 0.06, 0.94)
ABOVE = 0.3
"""Visible height above the tip of the tool, relative to the size of the scene.

The height is larger than the length of the longest arrow.
"""


class LivePage:
    """Live run on a browser page; the mouse moves the tool.

    While no page is open or the run is paused, no ticks are computed and the tool does not move.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.window.PageProcess` has filled.

    Attributes
    ----------
    shown, stage, target
        Scene, off-screen view, and requested position of the tool.
    """

    kind = "live"

    def __init__(self, folder: Path) -> None:
        self.shown = LiveScene(folder, size_px=SIZE, margins=MARGINS, off_screen=True)
        # the tool works inside a tooth, where it cannot be seen otherwise
        self.shown.cut_open("dentin" in self.shown.colours)
        plotter = self.shown.plotter
        start = self.shown.target_options["start_mm"]
        axis = self.shown.target_options["axis"]
        size = float(np.linalg.norm(np.ptp(self.shown.points_mm, axis=0)))
        points = np.vstack([self.shown.points_mm, start + ABOVE * size * axis])
        self.stage = Stage(plotter, lambda: aim(plotter, points, margins=MARGINS))
        self.target = Target(plotter, **self.shown.target_options)
        self._sent_mm = self.target.target_mm
        self.arrays = self.shown.arrays
        self._attended = False
        self._paused = False
        self._hold()
        self._count = 0
        self._run = 0
        self._resets = 0
        self._last: dict[str, Any] | None = None
        self._readings: Readings | None = None

    @property
    def over(self) -> bool:
        """True if the ticks have ended."""
        return bool(self.arrays["ended"][0])

    def hello(self) -> dict[str, Any]:
        """Return the scene's name, the colours of its parts, and whether the bone is cut open."""
        self._last = None
        self.stage.changed = True
        from matplotlib.colors import to_hex

        legend = {name: to_hex(colour) for name, colour in self.shown.colours.items()}
        cut = self.shown.is_cut_open if self.shown.is_bone else None
        return {"scene": self.shown.scene.name, "legend": legend, "cut": cut}

    def attend(self, attended: bool) -> None:
        """Continue the simulation if a page is open; otherwise halt it."""
        self._attended = attended
        self._hold()

    def leave(self) -> None:
        """End the run."""
        self.arrays["closed"][0] = 1

    def take(self, do: str, values: Values) -> None:
        """Handle a message of the page: move the tool, rotate the view, pause, reset or end."""
        if self.stage.take(do, values):
            pass
        elif do == "pause":
            self._paused = bool(values["on"])
            self._hold()
        elif do == "reset" and not self._resetting:
            self._resets += 1
            self._paused = False
            self._hold()
            self.arrays["resets"][0] = self._resets
        elif do == "cut":
            self.shown.cut_open(bool(values["on"]))
            self.stage.changed = True
        elif do == "end":
            self.leave()
        # a paused tool must not jump to another place when the run continues
        elif not (self._paused or self._resetting):
            self._move(do, values)

    def frame(self, drawing: bool) -> tuple[dict[str, Any] | None, bytes | None]:
        """Send the requested tool position to the simulation; return as `Session.frame`."""
        self.arrays["frames"][0] += 1
        if int(self.arrays["runs"][0]) != self._run:
            self._begin_again()
        if not np.array_equal(self._sent_mm, self.target.target_mm):
            self._sent_mm = self.target.target_mm
            self.arrays.write("pointer", self._sent_mm)
            self.stage.changed = True
        # the page has not taken the last picture yet
        if not drawing:
            return None, None
        loads = self._loads()
        if loads or self.stage.changed or self._readings is None:
            self._readings = self.shown.show(self.target.target_mm)
            self.stage.changed = True
        self.stage.changed |= self.shown.update_tissue()
        figures = self._figures(loads)
        return figures, self.stage.picture()

    @property
    def _resetting(self) -> bool:
        """True if a reset was requested but has not happened yet."""
        return self._resets != self._run

    def _move(self, do: str, values: Values) -> None:
        """Move the tool like `tissue.show.viewer.live.live_scene.Pointer`."""
        if do == "move":
            tall_mm = self.stage.tall_px * self.target.mm_per_pixel
            self.target.across(tall_mm * float(values["right"]), tall_mm * float(values["up"]))
        elif do == "depth":
            self.target.along(NOTCH_MM * float(values["notches"]))
        elif do == "key":
            self.target.press(str(values["name"]))

    def _hold(self) -> None:
        self.arrays["paused"][0] = int(self._paused or not self._attended)

    def _begin_again(self) -> None:
        """Show a run from its start."""
        self._run = int(self.arrays["runs"][0])
        self._count = int(self.arrays["loads_count"][0])
        self.target.reset()
        self._sent_mm = self.target.target_mm
        self._readings = None
        self.stage.changed = True

    def _loads(self) -> list[list[float]]:
        """Return the rows of time [s] and force [N] since the last frame."""
        count = int(self.arrays["loads_count"][0])
        # the ticks overwrite the oldest rows while they are read; the newer half of the ring is
        # safe
        first = max(self._count, count - LOADS // 2)
        rows = self.arrays["loads"][np.arange(first, count) % LOADS]
        self._count = count
        # 0.1 mN and 0.1 ms: finer than a pixel of the plot, and shorter messages
        return np.round(rows, 4).tolist()

    def _figures(self, loads: list[list[float]]) -> dict[str, Any] | None:
        """Return the data that the page shows and plots, or None if there are no new data."""
        state = "running"
        if self._resetting:
            state = "resetting"
        elif self._paused:
            state = "paused"
        figures: dict[str, Any] = {"state": state, "run": self._run}
        read = self._readings
        if read is not None:
            figures |= read.numbers
            # 0.1 mN and 1 uN m: finer than the page shows
            figures["force_N"] = np.round(read.force_N, 4).tolist()
            figures["torque_Nm"] = round(float(np.linalg.norm(read.torque_Nm)), 6)
            figures["device_N"] = read.device_N
            figures["layer"] = read.layer
        if not loads and figures == self._last:
            return None
        self._last = figures
        return {"figures": figures, "loads": loads}


if __name__ == "__main__":
    serve(lambda: LivePage(Path(sys.argv[1])), beside_ticks=True)
