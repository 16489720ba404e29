"""Keys and clicks in the window of `tissue view` beside those that VTK has of its own."""

from collections.abc import Callable
from typing import Any

import numpy as np

__all__ = ["free_keys", "on_click"]

STILL_PX = 2
"""A mouse that moves less between press and release has clicked."""
KEPT = tuple("eqrsw")
"""Keys of VTK that stay: leave, leave, reset the camera, surfaces, wires."""
ROTATE = 1
"""VTK's number of the state in which the left button turns the camera."""


def on_click(plotter: Any, click: Callable[[int, int], None]) -> None:
    """Call with the pixel, counted from the lower left, when the left button is pressed and released in one place.

    A style that turns the camera grabs the mouse between the two, so that it is the one to ask.
    """
    interactor = plotter.iren.interactor
    style = interactor.GetInteractorStyle()
    pressed: list[tuple[int, int]] = []

    def down(*_: Any) -> None:
        pressed[:] = [interactor.GetEventPosition()] if style.GetState() == ROTATE else []

    def up(*_: Any) -> None:
        place = interactor.GetEventPosition()
        if pressed and np.abs(np.subtract(place, pressed.pop())).max() <= STILL_PX:
            click(*place)
            plotter.render()

    style.AddObserver("StartInteractionEvent", down)
    style.AddObserver("EndInteractionEvent", up)


def free_keys(plotter: Any) -> None:
    """Leave VTK only keys that are not taken: its 3 is a stereo picture, its m an animation that stops the mouse."""
    style = plotter.iren.interactor.GetInteractorStyle()

    def typed(caller: Any, event: str) -> None:
        if plotter.iren.interactor.GetKeyCode() in KEPT:
            style.OnChar()

    style.AddObserver("CharEvent", typed)
