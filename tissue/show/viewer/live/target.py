"""Target position of the tool in a live run, moved by mouse and keyboard."""

import numpy as np
from numpy.typing import NDArray

from tissue.show.viewer.plotter import Plotter

__all__ = ["HELP", "KEY_MM", "NOTCH_MM", "Pointer", "Target"]

Array = NDArray[np.float64]
NOTCH_MM, KEY_MM = 0.5, 0.5
"""Travel of a notch of the wheel and of a press of a key [mm]."""
DEEPER = ("Next", "s")
HIGHER = ("Prior", "w")
ARROWS = {"Left": (-1.0, 0.0), "Right": (1.0, 0.0), "Up": (0.0, 1.0), "Down": (0.0, -1.0)}
"""Directions right and up in the view."""


class Target:
    """Wanted position of a tool.

    Parameters
    ----------
    plotter
        Plotter of the view.
    start_mm
        Initial position [mm].
    axis
        The tool's axis from tip to shank, shape (3,).
    low_mm, high_mm
        Corners of the box [mm].

    Attributes
    ----------
    target_mm
        Wanted position of the tool [mm], shape (3,).
    """

    def __init__(
        self, plotter: Plotter, start_mm: Array, axis: Array, *, low_mm: Array, high_mm: Array
    ) -> None:
        self._plotter = plotter
        self._axis = axis
        self._low = low_mm
        self._high = high_mm
        self._start: Array = np.array(start_mm, dtype=float)
        self.target_mm = self._start.copy()

    def reset(self) -> None:
        """Move back to the initial position."""
        self.target_mm = self._start.copy()

    def along(self, travel_mm: float) -> None:
        """Move along the tool's axis [mm], positive out of the tissue."""
        self._go(travel_mm * self._axis)

    def across(self, right_mm: float, up_mm: float) -> None:
        """Move in the plane of the view [mm]."""
        camera = self._plotter.camera
        forward = np.array(camera.GetDirectionOfProjection())
        right = np.cross(forward, camera.GetViewUp())
        right /= np.linalg.norm(right)
        self._go(right_mm * right + up_mm * np.cross(right, forward))

    def press(self, key: str) -> None:
        """Move by a key, given by VTK's name. Keys without a move are ignored."""
        if key in ARROWS:
            right, up = ARROWS[key]
            self.across(KEY_MM * right, KEY_MM * up)
        elif key in DEEPER:
            self.along(-KEY_MM)
        elif key in HIGHER:
            self.along(KEY_MM)

    @property
    def mm_per_pixel(self) -> float:
        """Size of a pixel in the plane of the view through the target [mm]."""
        camera = self._plotter.camera
        away = float(
            (self.target_mm - camera.GetPosition()) @ np.array(camera.GetDirectionOfProjection())
        )
        tall = self._plotter.window_size[1]
        return 2.0 * max(away, 1.0) * float(np.tan(np.radians(0.5 * camera.GetViewAngle()))) / tall

    def _go(self, travel_mm: Array) -> None:
        self.target_mm = np.clip(self.target_mm + travel_mm, self._low, self._high)


HELP = (
    "mouse or arrows: move in the view's plane",
    "wheel, page down/up or s/w: deeper, higher",
    "drag: turn the view, right drag: nearer, farther",
    "q: end",
)
"""Description of the keys and mouse actions."""


class Pointer(Target):
    """Wanted position of a tool, moved by mouse and keys within a box.

    The mouse moves the position in the plane of the view, by the distance that the mouse covers in
    the parallel plane through the position. With a pressed button, the mouse controls the view. The
    wheel and the depth keys move the position along the tool's axis.

    Parameters
    ----------
    plotter
        Plotter of the window.
    start_mm
        Initial position [mm].
    axis
        The tool's axis from tip to shank, shape (3,).
    low_mm, high_mm
        Corners of the box [mm].

    Attributes
    ----------
    target_mm
        Wanted position of the tool [mm], shape (3,).
    ended
        True if the key to end was pressed.
    """

    def __init__(
        self, plotter: Plotter, start_mm: Array, axis: Array, *, low_mm: Array, high_mm: Array
    ) -> None:
        super().__init__(plotter, start_mm, axis, low_mm=low_mm, high_mm=high_mm)
        self.ended = False
        self._at: tuple[int, int] | None = None
        interactor = self._interactor = plotter.iren.interactor
        self._style = style = interactor.GetInteractorStyle()
        interactor.AddObserver("MouseMoveEvent", self._moved)
        interactor.AddObserver("LeaveEvent", self._left)
        interactor.AddObserver("KeyPressEvent", self._pressed)
        # An event that the style is asked for by name is not its own any more: neither zoom nor
        # shortcuts remain.
        style.AddObserver("MouseWheelForwardEvent", lambda *_: self.along(-NOTCH_MM))
        style.AddObserver("MouseWheelBackwardEvent", lambda *_: self.along(NOTCH_MM))
        style.AddObserver("CharEvent", lambda *_: None)

    def _moved(self, *_: object) -> None:
        before = self._at
        self._at = self._interactor.GetEventPosition()
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
