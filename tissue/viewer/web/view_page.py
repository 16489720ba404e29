"""The page of `tissue view DIR --web`, run by ``python -m tissue.viewer.web.view_page DIR CHOICE`` in a process."""

import json
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue.figures.faces import faces_of
from tissue.figures.style import layer_colours
from tissue.figures.tool_mesh import turning_tool
from tissue.simulation.run_folder import SavedRun
from tissue.simulation.saved_fields import SavedFields, field_label, field_names
from tissue.viewer.bone import BoneShown
from tissue.viewer.camera import aim
from tissue.viewer.carving import bone_of
from tissue.viewer.fields import FieldsShown
from tissue.viewer.moment import MomentShown
from tissue.viewer.web.colour_scale import taken_scale
from tissue.viewer.web.messages import Values
from tissue.viewer.web.process import serve
from tissue.viewer.web.stage import Stage
from tissue.viewer.window import Choice, cut_plane, some_of, times_of

__all__ = ["ViewPage"]

SIZE = (960, 720)
"""Until the page states its own [pixel]."""
MARGINS = (0.05, 0.82, 0.06, 0.94)
"""Layers and the scale of colours lie at the right."""
REACH = 0.5
"""How much of the tool is in view at first, from its tip, in sizes of what it meets."""
MOST_ROWS = 2000
"""Rows of the trace that the page plots."""
SLOWEST_S = 4.0
"""What takes less time than this is played slower, so that it lasts this long [s]."""
DEPTH, LAYER = "removed depth", "layer"
"""What the bone is coloured by, among the names of fields."""


class ViewPage:
    """A finished or stopped run: bone or fields, tool and force at the moment that the page asks for.

    Parameters
    ----------
    saved
        The run.
    choice
        What is shown at first.

    Attributes
    ----------
    stage, bone, fields, moment
        Its parts; None where the run has none.
    time_s
        The moment that is shown [s].
    """

    kind = "view"

    def __init__(self, saved: SavedRun, choice: Choice) -> None:
        import pyvista

        self._saved, self.over, self._playing = saved, False, False
        self._plotter = plotter = pyvista.Plotter(off_screen=True, window_size=list(SIZE))
        plotter.background_color = pyvista.Color("white")
        scene, series = saved.scene, SavedFields(saved.path) if field_names(saved.path) else None
        bone = bone_of(saved, scene)
        self.bone = None if bone is None else BoneShown(plotter, bone, legend=False)
        self._series, self.fields = series, None
        if series is not None:
            cut = cut_plane(saved, series) if self.bone is not None else None
            self.fields = FieldsShown(plotter, series, scale=choice.scale, clip=cut)
        faces = faces_of(scene)
        self._colours = layer_colours(tuple(faces))
        self._faces = {n: plotter.add_mesh(f, color=self._colours[n], opacity=0.5) for n, f in faces.items()}
        points = [some_of(np.asarray(face.points)) for face in faces.values()]
        if self.bone is not None:
            points.append(some_of(self.bone.points_mm))
        if series is not None and (self.bone is None or choice.field is not None):
            points.append(some_of(np.asarray(series.frames[0].points)))
        size = max([float(np.linalg.norm(np.ptp(each, axis=0))) for each in points], default=0.0)
        self.moment: MomentShown | None = None
        if saved.trace is not None and len(saved.trace.rows):
            tool = turning_tool(scene.tool if scene is not None else None)
            self.moment = MomentShown(plotter, saved.trace, tool, size_mm=size, chart=False)
            points.append(self.moment.extent_mm)
            if tool is not None:
                points.append(self.moment.near_tip_mm(np.asarray(tool.points), reach_mm=REACH * size))
        self._times = times_of(saved, series)
        self.hidden: frozenset[str] = frozenset()
        if choice.hide:
            self._hide(frozenset(choice.hide))
        self.chosen = self._choose(choice.field or self._first_name())
        last = float(self._times[-1]) if len(self._times) else 0.0
        peak_s = self.moment.peak_s if self.moment is not None else last
        self.time_s = self._shown_s = peak_s if choice.time_s is None else choice.time_s
        self._show()
        extent = np.vstack([np.zeros((0, 3)), *points])
        aim(plotter, extent, margins=MARGINS)
        self.stage = Stage(plotter, lambda: aim(plotter, extent, margins=MARGINS))
        self._last_s, self._dirty = perf_counter(), True
        self._changed()

    @property
    def span_s(self) -> tuple[float, float]:
        """First and last moment [s]."""
        return (float(self._times[0]), float(self._times[-1])) if len(self._times) else (0.0, 0.0)

    def hello(self) -> dict[str, Any]:
        """What there is: names, colours, choices, and the force over time."""
        self.stage.changed = self._dirty = True
        return {
            "scene": str(self._saved.summary.get("scene", "run")),
            "legend": self._legend(),
            "hidden": sorted(self.hidden),
            "choices": self._choices(),
            "span_s": self.span_s,
            "rows": self._rows(),
        }

    def attend(self, attended: bool) -> None:
        """Stop to play where nobody looks."""
        self._playing = self._playing and attended

    def leave(self) -> None:
        """End."""
        self.over = True

    def take(self, do: str, values: Values) -> None:
        """Go to a moment, play, choose what is shown, turn the view or end."""
        number = {name: float(value) for name, value in values.items() if isinstance(value, int | float)}
        if do == "size":
            self.stage.resize(number["wide"], number["tall"])
        elif do == "turn":
            self.stage.turn(number["right"], number["up"])
        elif do == "zoom":
            self.stage.zoom(number["by"])
        elif do == "time":
            self.time_s = float(np.clip(number["time_s"], *self.span_s))
        elif do == "play":
            self._playing, self._last_s = bool(values["on"]), perf_counter()
            if self._playing and self.time_s >= self.span_s[1]:
                self.time_s = self.span_s[0]
        elif do == "field" and values["name"] in dict(self._choices()):
            self.chosen = self._choose(str(values["name"]))
            self._changed()
        elif do == "layer" and values["name"] in self._legend():
            self._hide(self.hidden ^ {str(values["name"])})
            self.chosen = self._choose(LAYER if self.chosen == DEPTH else self.chosen)
            self._changed()
        elif do == "end":
            self.leave()
        self._dirty = True

    def frame(self, drawing: bool) -> tuple[dict[str, Any] | None, bytes | None]:
        """Go on in time where it plays, and show the moment."""
        now = perf_counter()
        passed, self._last_s = now - self._last_s, now
        first, last = self.span_s
        if self._playing:
            self.time_s = min(self.time_s + passed * min((last - first) / SLOWEST_S, 1.0), last)
            self._playing = self.time_s < last
        if not drawing:
            return None, None
        if self.time_s != self._shown_s or self._dirty:
            if self.time_s != self._shown_s:
                self._shown_s = self.time_s
                self._show()
                self._changed()
            self._dirty = False
            return self._figures(), self.stage.picture()
        return None, self.stage.picture()

    def _changed(self) -> None:
        """Draw again; the page draws the scale of colours."""
        self._scale = taken_scale(self._plotter)
        self.stage.changed = True

    def _legend(self) -> dict[str, str]:
        """Layers and faces that can be switched, with their colours."""
        from matplotlib.colors import to_hex

        colours = dict(self._colours)
        if self.bone is not None:
            colours |= {name: self.bone.colours[name] for name in self.bone.layers}
        if self._series is not None:
            colours = layer_colours(tuple(self._series.layer_names)) | colours
        return {name: to_hex(colour) for name, colour in colours.items()}

    def _show(self) -> None:
        """Show the moment."""
        if self.moment is not None:
            self.moment.at(self.time_s)
            if self.bone is not None:
                self.bone.at(self.moment.row(self.time_s))
        if self.fields is not None:
            self.fields.at(self.time_s)

    def _first_name(self) -> str:
        return self._choices()[0][0] if self._choices() else ""

    def _choices(self) -> list[tuple[str, str]]:
        """What can be shown, and in words."""
        depth = [(DEPTH, DEPTH)] if self.bone is not None and self.bone.is_cut else []
        of_bone = [*depth, (LAYER, LAYER)] if self.bone is not None else []
        fields = [] if self._series is None else self._series.names
        return of_bone + [(name, " / ".join(part for part in field_label(name) if part)) for name in fields]

    def _choose(self, name: str) -> str:
        """Show a field, or the bone by removed depth or layer; what is shown."""
        of_bone = name in (DEPTH, LAYER) or self._series is None
        if self.fields is not None:
            self.fields.show(None if of_bone else name)
        if self.bone is not None:
            if of_bone and self.bone.by_depth != (name == DEPTH):
                self.bone.change()
            self.bone.show(of_bone)
        return name

    def _hide(self, hidden: frozenset[str]) -> None:
        self.hidden = hidden
        for each in (self.bone, self.fields):
            if each is not None:
                each.hide(hidden)
        for name, actor in self._faces.items():
            actor.SetVisibility(name not in hidden)

    def _rows(self) -> list[list[float]]:
        """Time [s], force [N] and its size, of rows that a page can draw."""
        trace = self._saved.trace
        if trace is None or not len(trace.rows):
            return []
        every = slice(None, None, max(len(trace.rows) // MOST_ROWS, 1))
        force = _force(self._saved)[every]
        rows = np.column_stack([trace["time_s"][every], force, np.linalg.norm(force, axis=1)])
        return np.round(rows, 4).tolist()

    def _figures(self) -> dict[str, Any]:
        """What the page writes of the moment."""
        figures: dict[str, Any] = {"time_s": self.time_s, "playing": self._playing, "chosen": self.chosen}
        figures["scale"] = self._scale
        trace = self._saved.trace
        if self.moment is not None and trace is not None:
            row = self.moment.row(self.time_s)
            removed = trace.get("removed_mm3")
            kind = "model_torque" if "model_torque_x_Nm" in trace else "torque"
            figures |= {
                "force_N": np.round(_force(self._saved)[row], 4).tolist(),
                "torque_Nm": round(float(np.linalg.norm([trace[f"{kind}_{c}_Nm"][row] for c in "xyz"])), 6),
                "removed_mm3": float(removed[row]) if removed is not None and removed[-1] > 0.0 else None,
                "layer": str(trace["layer"][row]) if "layer" in trace else None,
            }
        return figures


def _force(saved: SavedRun) -> NDArray[np.float64]:
    """What the tissue does to the tool [N], shape (rows, 3)."""
    assert saved.trace is not None
    return saved.trace.vectors("model_force" if "model_force_x_N" in saved.trace else "force", "N")


def _make() -> ViewPage:
    folder, chosen = sys.argv[1:]
    choice = json.loads(chosen)
    return ViewPage(SavedRun(Path(folder)), Choice(**choice | {"hide": tuple(choice["hide"])}))


if __name__ == "__main__":
    serve(_make, beside_ticks=False)
