"""What a click does in the window of `tissue view`: it marks a point, whose values follow, or chooses a name."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from tissue.simulation.saved_fields import field_label
from tissue.viewer.fields import REFERENCE, FieldsShown, interpolated
from tissue.viewer.plotter import Plotter

__all__ = ["NameList", "PointRead"]

MARK = "#56B4E9"
NEGLIGIBLE = 1e-5
"""Share of a vector below which one of its components is rounding."""
LEFT, TOP, ROW, WIDTH, LETTER = 0.012, 0.80, 0.032, 0.2, 0.024
"""Place and size of the list in shares of the window: a row lies upon the line of its letters."""
CHOSEN, OTHER = "#0072B2", (0.45, 0.45, 0.45)


class PointRead:
    """A point of the material that a click has marked, and what the fields are there.

    Parameters
    ----------
    plotter
        Where it is shown.
    fields
        What is read.
    size_mm
        Diameter of the mark [mm].

    Attributes
    ----------
    reference_mm
        Where the point lay before loading [mm], or None.
    text
        Its description.
    """

    def __init__(self, plotter: Plotter, fields: FieldsShown, *, size_mm: float) -> None:
        import pyvista

        self._plotter, self._fields = plotter, fields
        self.reference_mm: NDArray[np.float64] | None = None
        self.text = ""
        self._mark = plotter.add_mesh(
            pyvista.Sphere(radius=0.5 * size_mm), color=MARK, name="mark", reset_camera=False, render=False
        )
        self._mark.SetVisibility(False)
        self._words = plotter.add_text("", position=(0.012, 0.36), viewport=True, font_size=10, color="black")
        fields.drawn.append(self.update)

    def click(self, x: int, y: int) -> bool:
        """Mark what lies under a pixel, counted from the lower left; whether there was anything."""
        from vtkmodules.vtkRenderingCore import vtkCellPicker

        if self._fields.actor is None:
            return False
        picker = vtkCellPicker()
        picker.SetTolerance(1e-4)
        picker.InitializePickList()
        picker.AddPickList(self._fields.actor)
        picker.PickFromListOn()
        if not picker.Pick(float(x), float(y), 0.0, self._plotter.renderer) or picker.GetCellId() < 0:
            return False
        mesh = self._fields.actor.mapper.dataset
        place = np.array(picker.GetPickPosition())
        self.reference_mm = interpolated(mesh, picker.GetCellId(), place, REFERENCE)
        self.update()
        return True

    def update(self) -> None:
        """Bring the mark and the words to the moment."""
        if self.reference_mm is None:
            return
        found = self._fields.read(self.reference_mm) if self._fields.name is not None else None
        self._mark.SetVisibility(found is not None)
        if found is None:
            self.text = "the marked point is gone" if self._fields.name is not None else ""
        else:
            self._mark.SetPosition(*found.place_mm)
            at = ", ".join(f"{value:.2f}" for value in self.reference_mm.round(2) + 0.0)
            lines = [f"{found.layer or 'point'} at ({at}) mm before loading"]
            self.text = "\n".join([*lines, *(_line(name, value) for name, value in found.values.items())])
        self._words.input = self.text


def _line(name: str, value: NDArray[np.float64]) -> str:
    """A field's value in words."""
    words, unit = field_label(name)
    if value.ndim == 0:
        return f"{words}: {value:.3g} {unit}".rstrip()
    size = float(np.linalg.norm(value))
    parts = ", ".join(f"{one if abs(one) > NEGLIGIBLE * size else 0.0:.3g}" for one in value)
    return f"{words}: {size:.3g} {unit} ({parts})"


class NameList:
    """Names below each other, of which one is chosen.

    Parameters
    ----------
    plotter
        The window.
    title
        Title above them.
    names
        What can be chosen, and the words that it is shown by.
    choose
        Called with what a click chose.
    """

    def __init__(
        self,
        plotter: Plotter,
        title: str,
        names: Sequence[tuple[str | None, str]],
        *,
        choose: Callable[[str | None], None],
    ) -> None:
        self._plotter, self._names, self._choose = plotter, list(names), choose
        self._words = [
            plotter.add_text(words, position=(LEFT, TOP - ROW * row), viewport=True, font_size=10, color="black")
            for row, words in enumerate([title, *(words for _, words in self._names)])
        ][1:]

    def mark(self, name: str | None) -> None:
        """Show which one is chosen."""
        from pyvista import Color

        for (each, words), actor in zip(self._names, self._words, strict=True):
            chosen = each == name
            actor.input = f"{'>' if chosen else '  '} {words}"
            actor.prop.color = Color(CHOSEN if chosen else OTHER)

    def click(self, x: int, y: int) -> bool:
        """Choose the name under a pixel, counted from the lower left; whether there was one."""
        wide, tall = self._plotter.window_size
        row = int((TOP + LETTER - y / tall) // ROW) - 1
        if not (LEFT <= x / wide <= LEFT + WIDTH and 0 <= row < len(self._names)):
            return False
        self._choose(self._names[row][0])
        return True
