"""Page of `tissue view DIR --web`.

Run as ``python -m tissue.show.viewer.web.view_page DIR CHOICE`` in a subprocess.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from tissue.show.figures.figure import field_words
from tissue.show.figures.tool_mesh import row_at
from tissue.show.viewer.playback import Playback
from tissue.show.viewer.plotter import aim, new_plotter
from tissue.show.viewer.run_scene import Choice, RunScene
from tissue.show.viewer.saved_surfaces import tool_force
from tissue.show.viewer.web.server import Values, serve
from tissue.show.viewer.web.stage import Stage
from tissue.simulation.run_folder import SavedRun

SIZE = (960, 720)
"""Size of the picture until the page reports its own size [pixels]."""
MARGINS = (0.05, 0.82, 0.06, 0.94)
"""Left, right, lower and upper end of the area for the scene, relative to the picture.

Layers and colour scale are at the right.
"""
MOST_ROWS = 2000
"""Largest number of rows of the trace that the page plots: two for each pixel."""
DEPTH = "removed depth"
LAYER = "layer"
"""Name of the colouring of the bone by layer; `DEPTH` is the colouring by removed depth."""


class ViewPage:
    """Finished or stopped run, shown on a browser page.

    The page shows bone or fields, tool and force at the time that the user chooses.

    Parameters
    ----------
    saved
        Saved run.
    choice
        First view of the run.

    Attributes
    ----------
    stage, shown
        Off-screen view, and scene in the view.
    """

    kind = "view"

    def __init__(self, saved: SavedRun, choice: Choice) -> None:
        self._saved = saved
        self.over = False
        self._plotter = new_plotter(SIZE, off_screen=True)
        shown = self.shown = RunScene(saved, choice, self._plotter, annotated=False)
        self._legend = {name: to_hex(colour) for name, colour in shown.colours.items()}
        self._choices = self._all_choices()
        self.hidden: frozenset[str] = frozenset()
        if choice.hide:
            self._hide(frozenset(choice.hide))
        self.chosen = self._choose(choice.field or next(iter(self._choices), ""))
        self._playback = Playback(shown.span_s, shown.start_s)
        self._shown_s = shown.start_s
        shown.at(shown.start_s)
        extent_mm = shown.extent_mm(near_tip=True)
        aim(self._plotter, extent_mm, margins=MARGINS)
        self.stage = Stage(self._plotter, lambda: aim(self._plotter, extent_mm, margins=MARGINS))
        self._dirty = True

    @property
    def time_s(self) -> float:
        """Shown time [s]."""
        return self._playback.time_s

    def hello(self) -> dict[str, Any]:
        """Return the data that a page needs when it is opened.

        The data contain the names and colours of the layers, the fields and colour modes to choose
        from, and the force over time.
        """
        self.stage.changed = self._dirty = True
        return {
            "scene": str(self._saved.summary.get("scene", "run")),
            "legend": self._legend,
            "hidden": sorted(self.hidden),
            "choices": list(self._choices.items()),
            "span_s": self.shown.span_s,
            "rows": self._rows(),
        }

    def attend(self, attended: bool) -> None:
        """Pause the playback while no page is open."""
        self._playback.play(self._playback.playing and attended)

    def leave(self) -> None:
        """End the session."""
        self.over = True

    def take(self, do: str, values: Values) -> None:
        """Carry out a message of the page.

        A message sets the shown time, starts or pauses the playback, selects a field or a
        colouring, rotates the view or ends the session.
        """
        if self.stage.take(do, values):
            pass
        elif do == "time":
            self._playback.time_s = float(np.clip(float(values["time_s"]), *self.shown.span_s))
        elif do == "play":
            self._playback.play(bool(values["on"]))
        elif do == "field" and values["name"] in self._choices:
            self.chosen = self._choose(str(values["name"]))
            self.stage.changed = True
        elif do == "layer" and values["name"] in self._legend:
            self._hide(self.hidden ^ {str(values["name"])})
            # a hidden layer is visible in the colours of layers, not in those of depth
            self.chosen = self._choose(LAYER if self.chosen == DEPTH else self.chosen)
            self.stage.changed = True
        elif do == "end":
            self.leave()
        self._dirty = True

    def frame(self, drawing: bool) -> tuple[dict[str, Any] | None, bytes | None]:
        """Advance the shown time during playback, and draw the run at this time."""
        self._playback.advance()
        # the page has not taken the last picture yet
        if not drawing:
            return None, None
        if self.time_s != self._shown_s or self._dirty:
            if self.time_s != self._shown_s:
                self._shown_s = self.time_s
                self.shown.at(self.time_s)
                self.stage.changed = True
            self._dirty = False
            return self._figures(), self.stage.picture()
        return None, self.stage.picture()

    def _all_choices(self) -> dict[str, str]:
        """Return the names and labels of all fields and colourings."""
        shown = self.shown
        choices = {}
        if shown.bone is not None:
            choices = {DEPTH: DEPTH, LAYER: LAYER} if shown.bone.is_cut else {LAYER: LAYER}
        if shown.series is not None:
            choices |= {name: field_words(name) for name in shown.series.names}
        return choices

    def _choose(self, name: str) -> str:
        """Show a field, or the bone by removed depth or layer, and return its name."""
        of_bone = name in (DEPTH, LAYER) or self.shown.series is None
        bone = self.shown.bone
        if of_bone and bone is not None and bone.by_depth != (name == DEPTH):
            bone.change()
        self.shown.show(None if of_bone else name)
        return name

    def _hide(self, hidden: frozenset[str]) -> None:
        self.hidden = hidden
        self.shown.hide(hidden)

    def _rows(self) -> list[list[float]]:
        """Return time [s], force [N] and its magnitude for the rows that a page can draw."""
        trace = self.shown.trace
        if trace is None:
            return []
        every = slice(None, None, max(len(trace.rows) // MOST_ROWS, 1))
        force = tool_force(trace)[every]
        rows = np.column_stack([trace["time_s"][every], force, np.linalg.norm(force, axis=1)])
        # 0.1 mN and 0.1 ms: finer than a pixel of the plot
        return np.round(rows, 4).tolist()

    def _figures(self) -> dict[str, Any]:
        """Return the values at the shown time that the page displays."""
        figures: dict[str, Any] = {
            "time_s": self.time_s,
            "playing": self._playback.playing,
            "chosen": self.chosen,
        }
        trace = self.shown.trace
        if trace is not None:
            row = row_at(trace, self.time_s)
            kind = "model_torque" if "model_torque_x_Nm" in trace else "torque"
            cuts = "removed_mm3" in trace and trace["removed_mm3"][-1] > 0.0
            figures |= {
                # digits that the page shows
                "force_N": np.round(tool_force(trace)[row], 4).tolist(),
                "torque_Nm": round(float(np.linalg.norm(trace.vectors(kind, "Nm")[row])), 6),
                "removed_mm3": float(trace["removed_mm3"][row]) if cuts else None,
                "layer": str(trace["layer"][row]) if "layer" in trace else None,
            }
        return figures


def _make() -> ViewPage:
    folder, chosen = sys.argv[1:]
    return ViewPage(SavedRun(Path(folder)), Choice.of_json(chosen))


if __name__ == "__main__":
    serve(_make, beside_ticks=False)
