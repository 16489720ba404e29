"""Mouse and keyboard of a live window as a device."""

import numpy as np
from numpy.typing import NDArray

from tissue.viewer.live.target import NOTCH_MM, Target
from tissue.viewer.plotter import Plotter

__all__ = ["HELP", "Pointer"]

Array = NDArray[np.float64]
HELP = (
    "mouse or arrows: move in the view's plane",
    "wheel, page down/up or s/w: deeper, higher",
    "drag: turn the view, right drag: nearer, farther",
    "q: end",
)
"""What there is to press."""


class Pointer(Target):
    """The wanted place of a tool, moved by mouse and keys within a box.

    The mouse moves it in the plane of the view by as much as it goes over the plane through it; with a button pressed
    the mouse belongs to the view. The wheel and the keys for depth move it along the tool's axis.

    Parameters
    ----------
    plotter
        The window.
    start_mm
        Where it begins [mm].
    axis
        The tool's axis from tip to shank, shape (3,).
    low_mm, high_mm
        Corners of the box [mm].

    Attributes
    ----------
    target_mm
        Where the tool is wanted [mm], shape (3,).
    ended
        Whether the key to end was pressed.
    """

    def __init__(self, plotter: Plotter, start_mm: Array, axis: Array, *, low_mm: Array, high_mm: Array) -> None:
        super().__init__(plotter, start_mm, axis, low_mm=low_mm, high_mm=high_mm)
        self.ended = False
        self._at: tuple[int, int] | None = None
        interactor = self._interactor = plotter.iren.interactor
        self._style = style = interactor.GetInteractorStyle()
        interactor.AddObserver("MouseMoveEvent", self._moved)
        interactor.AddObserver("LeaveEvent", self._left)
        interactor.AddObserver("KeyPressEvent", self._pressed)
        # An event that the style is asked for by name is not its own any more: neither zoom nor shortcuts remain.
        style.AddObserver("MouseWheelForwardEvent", lambda *_: self.along(-NOTCH_MM))
        style.AddObserver("MouseWheelBackwardEvent", lambda *_: self.along(NOTCH_MM))
        style.AddObserver("CharEvent", lambda *_: None)

    def _moved(self, *_: object) -> None:
        before, self._at = self._at, self._interactor.GetEventPosition()
        if before is None or self._style.GetState() != 0:
            return
        pixel = self.mm_per_pixel
        self.across(pixel * (self._at[0] - before[0]), pixel * (self._at[1] - before[1]))

    def _left(self, *_: object) -> None:
        self._at = None

    def _pressed(self, *_: object) -> None:
        key = self._interactor.GetKeySym()
        if key in ("q", "Escape"):
            self.ended = True
        else:
            self.press(key)
