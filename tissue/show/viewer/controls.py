"""Time and marked point of a view of a run."""

from time import perf_counter

import numpy as np

from meshes.base.arrays import Array
from tissue.show.viewer.fields import FieldsShown
from tissue.show.viewer.plotter import Plotter, add_text, in_words, picked
from tissue.simulation.saved_fields import field_label

__all__ = ["Playback", "PointRead"]

MARK = "#56B4E9"
NEGLIGIBLE = 1e-5
"""Share of a vector below which a component counts as a rounding error."""


class PointRead:
    """Material point marked by a click, and the field values at it.

    Parameters
    ----------
    plotter
        Plotter in which the mark is drawn.
    fields
        Fields that are read.
    size_mm
        Diameter of the mark [mm].

    Attributes
    ----------
    reference_mm
        Position of the point before loading [mm]; None while no point is marked.
    text
        Description of the point.
    """

    def __init__(self, plotter: Plotter, fields: FieldsShown, *, size_mm: float) -> None:
        import pyvista

        self._plotter = plotter
        self._fields = fields
        self.reference_mm: Array | None = None
        self.text = ""
        self._mark = plotter.add_mesh(
            pyvista.Sphere(radius=0.5 * size_mm), color=MARK, reset_camera=False, render=False
        )
        self._mark.SetVisibility(False)
        # at the left, below the help text
        self._words = add_text(plotter, "", (0.012, 0.36), size=10)
        fields.drawn.append(self.update)

    def click(self, x: int, y: int) -> None:
        """Mark the point of the mesh under a pixel, if any.

        `x` and `y` are counted in pixels from the lower left corner of the window.
        """
        found = picked(self._plotter, self._fields.actor, x, y)
        if found is not None:
            self.reference_mm = self._fields.reference_of(found)
            self.update()

    def update(self) -> None:
        """Update the mark and the text for the shown time."""
        if self.reference_mm is None:
            return
        found = self._fields.read(self.reference_mm) if self._fields.name is not None else None
        self._mark.SetVisibility(found is not None)
        if found is None:
            self.text = "the marked point is gone" if self._fields.name is not None else ""
        else:
            self._mark.SetPosition(*found.place_mm)
            lines = [
                f"{found.layer or 'point'} at ({in_words(self.reference_mm)}) mm before loading"
            ]
            lines += [_line(name, value) for name, value in found.values.items()]
            self.text = "\n".join(lines)
        self._words.input = self.text


def _line(name: str, value: Array) -> str:
    """Return the value of a field as text."""
    words, unit = field_label(name)
    if value.ndim == 0:
        return f"{words}: {value:.3g} {unit}".rstrip()
    size = float(np.linalg.norm(value))
    parts = ", ".join(f"{one if abs(one) > NEGLIGIBLE * size else 0.0:.3g}" for one in value)
    return f"{words}: {size:.3g} {unit} ({parts})"


SLOWEST_S = 4.0
"""Shortest duration of a playback [s]; a shorter run is played slower."""


class Playback:
    """Time that is shown, which the user sets or a playback advances.

    Parameters
    ----------
    span_s
        First and last time [s].
    time_s
        Time that is shown at the start [s].

    Attributes
    ----------
    time_s
        Shown time [s].
    playing
        True if the playback changes the time.
    """

    def __init__(self, span_s: tuple[float, float], time_s: float) -> None:
        self.span_s = span_s
        self.time_s = time_s
        self.playing = False
        self._rate = min((span_s[1] - span_s[0]) / SLOWEST_S, 1.0)
        self._before_s = 0.0

    def play(self, playing: bool) -> None:
        """Start or pause the playback; if the last time is shown, start from the first time."""
        self.playing = playing
        self._before_s = perf_counter()
        if playing and self.time_s >= self.span_s[1]:
            self.time_s = self.span_s[0]

    def advance(self) -> bool:
        """Advance the shown time by the elapsed time; return False while the playback is paused."""
        if not self.playing:
            return False
        now_s = perf_counter()
        passed_s = self._rate * (now_s - self._before_s)
        self._before_s = now_s
        self.time_s = min(self.time_s + passed_s, self.span_s[1])
        self.playing = self.time_s < self.span_s[1]
        return True
